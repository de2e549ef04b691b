# SPDX-License-Identifier: Apache-2.0
"""``render.layers``: writes a film as layers for compositing: colour, depth, mattes and truth as ``000000.exr`` ….

Channels: R, G, B, A (half; the video's own tone curve, premultiplied, over nothing), Z (float; metres, 0 = nothing
there), NX, NY, NZ (half; world normals), ``truth.measured``, ``truth.inferred``, ``truth.invented`` and ``matte.room``,
``matte.<person>``, ``matte.<object>`` (half; shares of the pixel, each group adds up to A).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.exr import write_channels
from studiorecon.progress import progress, say
from studiorecon.render.composite_renderer import CompositeRenderer, Layers
from studiorecon.render.draw_settings import DrawSettings
from studiorecon.render.shot import read_composite
from studiorecon.scene.path import read_path
from studiorecon.signature import Written
from studiorecon.splatting.device import resolve
from studiorecon.splatting.scene_files import SceneFiles

if TYPE_CHECKING:
    from jaxtyping import Float

_CLASSES = ("measured", "inferred", "invented")


@dataclass(frozen=True)
class Settings(DrawSettings):
    """Settings of drawing."""


def layer_channels(layers: Layers, people: Sequence[str]) -> dict[str, Float[np.ndarray, "H W"]]:
    """Channels by name: float16, depth float32."""
    rendering = layers.rendering
    if rendering.normals is None:
        raise ValueError("layers were drawn without normals")
    found = {name: rendering.rgb[..., i] for i, name in enumerate("RGB")} | {"A": rendering.alpha}
    found |= {name: rendering.normals[..., i] for i, name in enumerate(("NX", "NY", "NZ"))}
    found |= {f"truth.{name}": layers.shares[..., i] for i, name in enumerate(_CLASSES)}
    found |= {f"matte.{name}": layers.mattes[..., i] for i, name in enumerate(("room", *people))}
    return {name: channel.astype(np.float16) for name, channel in found.items()} | {
        "Z": rendering.depth_m.astype(np.float32)
    }


def run(
    settings: Settings,
    shot: str,
    path: Path,
    files: SceneFiles,
    folder: Written,
    light: list[Path] | None = None,
    stand_ins: list[Path] | None = None,
    device: str = "cpu",
) -> None:
    """Write one file per step of the shot's ``path`` into ``folder``; files of an earlier, longer film are removed."""
    steps, _ = read_path(path)
    scene = read_composite(files, shot, settings.shots, light or (), stand_ins or ())
    people = [moving.person for moving in scene.moving]
    canvas = CompositeRenderer(scene, settings.near_m, resolve(device))
    for old in folder.glob("*.exr"):
        old.unlink()
    for index, step in enumerate(progress(steps, f"layers of {shot}")):
        write_channels(folder / f"{index:06d}.exr", layer_channels(canvas.layers(step.camera, step.frame), people))
    say(
        f"{len(steps)} pictures of {shot} are split into layers in {folder}, with mattes of "
        f"{', '.join(['the room', *people])}"
    )
