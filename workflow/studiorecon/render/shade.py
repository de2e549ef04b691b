# SPDX-License-Identifier: Apache-2.0
"""``render.shade``: writes the room's shadows over time to a file, for other renderers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.progress import progress, say
from studiorecon.render.room_light import read_light
from studiorecon.render.shading import build_shading
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.files import write_npz
from studiorecon.signature import Written
from studiorecon.splatting.scene_files import SceneFiles

# Players interpolate between these moments; shadows have soft edges and move as slowly as people do.
MOMENTS = 120


def run(manifest: Path, files: SceneFiles, light: Path, shade: Written) -> None:
    """Write indices ``at`` of the room's shadeable Gaussians, frames ``times``, and ``factors`` on their colours.

    All are empty if the ``light`` was not accepted.
    """
    (room, _), people = files.room(), files.people()
    found = build_shading(read_light(light), room, people, people, files.things())
    times = spread_indices(read_manifest(manifest).frames, MOMENTS)
    if found is None:
        say("shade: no light explains the shadows, so people cast none")
        write_npz(shade, {"at": np.zeros(0, np.int64), "times": times, "factors": np.zeros((len(times), 0))})
        return
    factors = np.stack([found.factor(float(time)) for time in progress(times, "moments with shadows")])
    write_npz(shade, {"at": found.at, "times": times, "factors": np.round(factors, 3)})
    say(
        f"shade: {len(found.at)} Gaussians of the room darken at {len(times)} moments, down to {factors.min():.0%} of "
        "their brightness"
    )
