# SPDX-License-Identifier: Apache-2.0
"""``enhance.sheet``: shows how one picture of a film was made: render, injected parts and their sources, output.

It is recomputed from the stored films, which are also the feedback of the recursion, so the sheet is exact.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.enhance.injection_settings import Injecting
from studiorecon.errors import UserError
from studiorecon.footage.video import read_frames_from, to_bytes
from studiorecon.images.encoded import write_png
from studiorecon.images.flow import one_thread
from studiorecon.progress import say
from studiorecon.recursive.clip import Blend, adapt_injection, blend, clip_history
from studiorecon.recursive.flows import load_flow
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.effects import INJECTION
from studiorecon.scene.path import read_path
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_BAR_PX = 22
_INK, _PAPER = (30, 30, 30), (255, 255, 255)
# Amplification of the differences between output and render, about mid grey.
_GAIN = 8


@dataclass(frozen=True)
class Settings(Injecting):
    """Settings of this step."""


def flow_picture(
    flow: Float[np.ndarray, "H W 2"], valid: Bool[np.ndarray, "H W"]
) -> tuple[Integer[np.ndarray, "H W 3"], float]:
    """(H, W, 3) uint8: direction as hue, length as strength, white = no motion, grey = invalid; and the longest flow,
    pixels.
    """
    length = np.hypot(flow[..., 0], flow[..., 1])
    longest = float(np.percentile(length[valid], 99)) if valid.any() else 0.0
    hue = (np.degrees(np.arctan2(flow[..., 1], flow[..., 0])) % 360 / 2).astype(np.uint8)
    strength = (255 * np.clip(length / max(longest, 0.5), 0, 1)).astype(np.uint8)
    colours = cv2.cvtColor(np.stack([hue, strength, np.full_like(hue, 255)], axis=-1), cv2.COLOR_HSV2RGB)
    return np.where(valid[..., None], colours, 128).astype(np.uint8), longest


def sheet(
    render: Integer[np.ndarray, "H W 3"], mixed: Blend, output: Integer[np.ndarray, "H W 3"]
) -> Integer[np.ndarray, "h w 3"]:
    """(H', W', 3) uint8 contact sheet: render, input, output and change; below, flow and confidence of each earlier
    output.
    """
    change = np.clip(128 + _GAIN * (output.astype(np.int16) - render), 0, 255).astype(np.uint8)
    share = to_bytes(mixed.injected)
    top = [
        ("render", render),
        (
            f"injected share, up to {100 * float(mixed.injected.max(initial=0)):.0f} %",
            cv2.applyColorMap(share, cv2.COLORMAP_VIRIDIS)[..., ::-1],
        ),
        ("input of the enhancer", to_bytes(mixed.blended)),
        ("output", output),
        (f"output - render, x {_GAIN}", change),
    ]
    below = []
    for back, (flow, valid, trust) in enumerate(zip(mixed.flows, mixed.valid, mixed.confidences), 1):
        colours, longest = flow_picture(flow, valid)
        below.append((f"flow to {back} before, up to {longest:.1f} px", colours))
        below.append((f"confidence, mean {float(trust.mean()):.2f}", np.repeat(to_bytes(trust)[..., None], 3, axis=-1)))
    columns = max(len(top), len(below))
    return np.concatenate([_row(top, columns), _row(below, columns)] if below else [_row(top, columns)], axis=0)


def _row(tiles: list[tuple[str, np.ndarray]], columns: int) -> np.ndarray:
    height, width = tiles[0][1].shape[:2]
    row = np.full((height + _BAR_PX, width * columns, 3), 255, np.uint8)
    for column, (words, picture) in enumerate(tiles):
        part = np.full((height + _BAR_PX, width, 3), _PAPER, np.uint8)
        part[_BAR_PX:] = picture
        cv2.putText(part, words, (4, _BAR_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
        row[:, column * width : (column + 1) * width] = part
    return row


def run(
    settings: Settings,
    shot: str,
    picture: int,
    render: Path,
    render_path: Path,
    video: Path,
    decisions: Path,
    image: Written,
    weights: Place = Path("resources/weights"),
    device: str = "cpu",
) -> None:
    """Write the sheet of one picture; raises UserError when the shot has no such picture."""
    steps, _ = read_path(render_path)
    if not 0 <= picture < len(steps):
        raise UserError(f"shot {shot} has pictures 0 to {len(steps) - 1}, not {picture}")
    segment = steps[picture].segment
    first = next(i for i in range(picture, -1, -1) if i == 0 or steps[i - 1].segment != segment)
    called = read_decisions(decisions).get(INJECTION.name)
    steadied = replace(settings.injection, history=settings.injection.history if called and called.called_for else 0)
    start = max(first, picture - steadied.history)
    raw = list(read_frames_from(render, start, picture + 1))
    made = list(read_frames_from(video, start, picture + 1))
    with one_thread(), ThreadPoolExecutor(max_workers=1) as pool:
        search = load_flow(settings.flow, settings.flow_preset, weights, device)
        injection = adapt_injection(steadied, steps)
        history = clip_history(list(zip(raw[:-1], made[:-1])), injection, search)
        mixed = blend(raw[-1], history, injection, search, pool)
    write_png(image, sheet(raw[-1], mixed, made[-1]))
    say(f"{image} shows how picture {picture} of {shot} was made, with {len(mixed.flows)} earlier outputs injected")
