# SPDX-License-Identifier: Apache-2.0
"""How much likelier a window's score is on the right surface than on a wrong one: ``python -m
benchmarks.depth_likelihood TRUTH …``.

TRUTH is the ``truth`` folder of a studio capture (one frame, no people). Every pixel of its training cameras is judged
at its true depth, and at 0.7 to 1.4 times that. Prints the log of the ratio beside the nats that
``depth.stereo.likelihood`` states, for textured and for flat windows, and the line that fits best.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume
from studiorecon.depth.stereo.plates import Picture
from studiorecon.footage.stills import shrink_plate
from studiorecon.scene.room import RoomBox
from studiorecon.studio.room import HALF_X_M, HALF_Y_M

from benchmarks.depth import Room, made_room

WIDTH, WINDOW, MEAN_WEIGHT, FLAT = 160, 5, 1.5, 1e-3
WRONG = (0.7, 0.85, 0.93, 1.07, 1.15, 1.4)
BINS = np.linspace(-4.8, 3.7, 18)
FAR_M = 9.0


def counts(room: Room) -> np.ndarray:
    """(textured or flat, right or wrong, bins) numbers of pixels by their nats."""
    pictures, truth = [], []
    for camera, plate, depth_m in zip(room.cameras, room.plates, room.truth):
        wh = (WIDTH, round(camera.wh[1] * WIDTH / camera.wh[0]))
        rgb, known = shrink_plate(plate, np.ones(camera.hw, bool), wh)
        pictures.append(Picture(camera.resized(wh), rgb.astype(np.float32), known))
        truth.append(cv2.resize(depth_m, wh, interpolation=cv2.INTER_NEAREST))
    low_m, high_m = np.array([-HALF_X_M, -HALF_Y_M, 0.0]), np.array([HALF_X_M, HALF_Y_M, FAR_M])
    box = RoomBox(0.0, low_m, high_m, np.ones(6, bool), np.full(6, np.nan))
    volume = PhotoCostVolume(pictures, box, WINDOW, MEAN_WEIGHT, looks=False)
    # Surfaces hide each other as they truly do.
    volume.depth[:] = np.stack(truth)
    found = np.zeros((2, 2, len(BINS) - 1))
    for view, (picture, depth_m) in enumerate(zip(pictures, truth)):
        mean, square = (cv2.blur(image, (WINDOW, WINDOW)) for image in (picture.rgb, picture.rgb**2))
        flat = (square - mean * mean).sum(axis=-1) < FLAT
        for factor in (1.0, *WRONG):
            seen = volume.of_depth(view, (depth_m * factor).astype(np.float32))
            for kind, where in enumerate((~flat, flat)):
                found[kind, int(factor != 1)] += np.histogram(seen.nats[seen.compared & where], BINS)[0]
    return found


def main(folders: list[Path]) -> None:
    found = sum(counts(made_room(folder)) for folder in folders)
    middle = (BINS[1:] + BINS[:-1]) / 2
    for kind, (right, wrong) in zip(("textured", "flat"), found):
        ratio = np.log((wrong + 0.5) / wrong.sum()) - np.log((right + 0.5) / right.sum())
        slope, even = np.polyfit(middle, ratio, 1, w=np.sqrt(right + wrong))
        print(f"{kind}: measured {slope:.2f} × stated {even:+.2f}, of {right.sum():.0f} and {wrong.sum():.0f} pixels")
        print("  " + ", ".join(f"{m:+.1f}: {r:+.1f}" for m, r in zip(middle, ratio)))


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
