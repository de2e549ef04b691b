# SPDX-License-Identifier: Apache-2.0
"""Walls that photos matched, hidden and placed again: ``python -m benchmarks.unseen_walls results/SCENE …``.

Prints every such wall, its median and its 80 % interval without it, in metres; and the shares of upright edges that end
on a wall's foot, before it and beyond it, which ``depth.layout.unseen_walls`` states.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from studiorecon.camera_files.colmap import read_model
from studiorecon.depth.layout.ground_contacts import find_ground_contacts
from studiorecon.depth.layout.unseen_walls import find_floor_ends, place_unseen_walls
from studiorecon.depth.layout.votes import read_sweeps
from studiorecon.depth.stereo.plates import read_pictures
from studiorecon.rig.room_picture import make_room_picture
from studiorecon.scene.room import FACES, read_room

FOOT_SIGMA_M, FAR_M, FACED = 0.16, 14.0, 0.35


def main(scenes: list[Path]) -> None:
    sides = np.zeros(3, int)
    for scene in scenes:
        cameras, box = read_model(scene / "cameras"), read_room(scene / "depth/box.json")
        plates = [scene / f"plates/{camera.name}.png" for camera in cameras]
        swept = read_sweeps([scene / f"depth/{camera.name}.sweep.npz" for camera in cameras], len(cameras))
        pictures = read_pictures(cameras, plates, swept.votes.chosen[0].shape[1])
        feet = find_ground_contacts(cameras, [make_room_picture(plate) for plate in plates], float(box.low_m[2]))
        ends = find_floor_ends(pictures, swept.votes, swept.floor_m)
        hidden = replace(box, fitted=np.zeros(6, bool))
        placed, interval_m = place_unseen_walls(hidden, feet, ends, cameras, np.zeros((0, 2)), FAR_M)
        for face in np.flatnonzero(box.fitted[:4]):
            normal = (2 * (face % 2) - 1) * box.faces[face, :2]
            wall_m = (2 * (face % 2) - 1) * box.faces[face, 3]
            faced = feet.towards @ normal > FACED
            sigma_m = np.hypot(feet.sigma_m * (feet.towards @ normal), FOOT_SIGMA_M)[faced]
            off = ((feet.place_m @ normal)[faced] - wall_m) / sigma_m
            sides += [int((np.abs(off) < 2).sum()), int((off <= -2).sum()), int((off >= 2).sum())]
            low_m, high_m = interval_m[face]
            print(
                f"{scene.name} {FACES[face]}: {box.faces[face, 3]:.2f}, placed at {placed.faces[face, 3]:.2f} "
                f"({low_m:.2f} to {high_m:.2f})"
            )
    shares = sides / max(sides.sum(), 1)
    print(f"{sides.sum()} ends: {shares[0]:.2f} on the foot, {shares[1]:.2f} before it, {shares[2]:.2f} beyond it")


if __name__ == "__main__":
    main([Path(scene) for scene in sys.argv[1:]])
