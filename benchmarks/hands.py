# SPDX-License-Identifier: Apache-2.0
"""Hands of finished runs: in how many views, how well views agree, how constant bones are.

python -m benchmarks.hands results/SCENE [results/SCENE …]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from studiorecon.camera_files.colmap import read_model
from studiorecon.people.fitting.hands import person_hands
from studiorecon.people.fitting.points import Triangulation, triangulate_hands
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import read_detections, read_identities, read_people

# Every point of a hand and the one before it on its finger.
BONES = np.array([(0 if k % 4 == 1 else k - 1, k) for k in range(1, 21)])


def rows(results: Path) -> list[str]:
    """A line for every person and hand."""
    manifest, cameras = read_manifest(results / "capture/manifest.json"), read_model(results / "cameras")
    seen = [read_detections(results / f"people/detections/{c.name}.npz") for c in cameras]
    whose, film_px = read_identities(results / "people/identities.tsv"), [manifest.of(c.name).film_px for c in cameras]
    lines = []
    for person in read_people(results / "people/people.tsv"):
        hands = person_hands(person, seen, whose, cameras, film_px, manifest.frames, "auto")
        for side, found in enumerate([] if hands is None else triangulate_hands(hands, cameras, Triangulation())):
            whole = np.isfinite(found.points_m).all((1, 2))
            points, views = found.points_m[whole], np.bincount((hands[:, :, side, 0, 2] > 0).sum(0)).tolist()
            off = [s * (c.project(points)[0] - h[whole, side, :, :2]) for c, h, s in zip(cameras, hands, film_px)]
            bones_mm = 1000 * np.linalg.norm(np.diff(points[:, BONES], axis=2)[:, :, 0], axis=-1)
            spread_mm = np.median(np.abs(bones_mm - np.median(bones_mm, 0)), 0) if len(points) else [np.nan]
            off_px = np.nanmedian(np.linalg.norm(off, axis=-1)) if len(points) else np.nan
            lines.append(
                f"{results.name} {person} {('left', 'right')[side]}: frames by views {views}, whole {len(points)}, "
                f"off {off_px:.1f} px, bones ± {np.median(spread_mm):.1f} mm, at worst {np.max(spread_mm):.1f} mm"
            )
    return lines


if __name__ == "__main__":
    print("\n".join(line for folder in sys.argv[1:] for line in rows(Path(folder))))
