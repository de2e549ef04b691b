# SPDX-License-Identifier: Apache-2.0
"""``people.shutter``: whose rows look one after the other, as everybody who moves tells. Bodies are fitted to keypoints
that are moved by it; the pictures stay as they were taken."""

from __future__ import annotations

from pathlib import Path

from studiorecon.camera_files.colmap import read_model
from studiorecon.progress import say
from studiorecon.rig.body_points import tracks
from studiorecon.rig.readout import readouts
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import read_detections, read_identities
from studiorecon.scene.readouts import write_readouts
from studiorecon.signature import Written

# Keypoints that are less sure only cost time.
_LEAST = 0.3


def run(model: Path, manifest: Path, detections: list[Path], identities: Path, shutter: Written) -> None:
    """Estimate every camera's readout from the keypoints of everybody who is known by name."""
    footage, by_name = read_manifest(manifest), {c.name: c for c in read_model(model.parent)}
    found, whose = [read_detections(path) for path in detections], read_identities(identities)
    cameras = [by_name[d.camera] for d in found]
    people = sorted(set(whose.values()))
    seen = tracks(found, whose, people, footage.frames, _LEAST)
    told = readouts(seen.pixels, cameras, footage.fps)
    for one in told:
        if one.used_s:
            say(
                f"{one.camera} reads its rows in {1000 * one.used_s:.1f} ± {1000 * (one.sigma_s or 0):.1f} ms: its "
                "keypoints are moved by as much"
            )
    if not any(one.used_s for one in told):
        reasons = sorted({one.reason for one in told})
        say(f"no camera's rows are moved: {'; '.join(reasons)}")
    write_readouts(shutter, told)
