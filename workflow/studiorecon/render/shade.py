# SPDX-License-Identifier: Apache-2.0
"""``render.shade``: whom the room is shaded by when, as a file: for pictures that others draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.progress import progress, say
from studiorecon.render.room_light import read_light
from studiorecon.render.shading import shading
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.signature import Written
from studiorecon.splatting.rigid_object import read_objects

# Who plays the shades continues them in between; shadows have soft edges and move as slowly as people do.
MOMENTS = 120


def run(
    manifest: Path,
    background: Path,
    gaussians: list[Path],
    avatars: list[Path],
    body: Path | None,
    objects: list[Path],
    light: Path,
    shade: Written,
) -> None:
    """Write ``at`` (M,) indices of the room's Gaussians that can be shaded, ``times`` (K,) frames, and ``factors``
    (K, M) by which their colours are multiplied; all empty where the ``light`` was not kept."""
    model = BodyModel.load(body) if body is not None else None
    people = [read_avatar(ply, npz, model) for ply, npz in zip(gaussians, avatars, strict=True) if model is not None]
    things = [thing for path in objects for thing in read_objects(path)]
    found = shading(read_light(light), read_ply(background), people, people, things)
    times = evenly_spread(read_manifest(manifest).frames, MOMENTS)
    if found is None:
        say("shade: no light explains the shadows, so nobody throws any")
        write_npz(shade, {"at": np.zeros(0, np.int64), "times": times, "factors": np.zeros((len(times), 0))})
        return
    factors = np.stack([found.factor(float(time)) for time in progress(times, "moments with shadows")])
    write_npz(shade, {"at": found.at, "times": times, "factors": np.round(factors, 3)})
    say(f"shade: {len(found.at)} Gaussians of the room at {len(times)} moments, down to {factors.min():.0%}")
