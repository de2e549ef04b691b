# SPDX-License-Identifier: Apache-2.0
"""Hands of a seated man in four real webcams at a metre: found, how well views agree, how constant bones are, the cost.

    STUDIORECON_REAL_DATA=... python -m benchmarks.hands_webcams

Reads ``caliscope_webcams`` (57 pictures of 1280×720 at 6 per second, calibrated by a board). Two minutes on one core.
"""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path

import numpy as np
from studiorecon.calibration import files as calibration
from studiorecon.detector.blazepose import LAYOUT, BlazePose
from studiorecon.detector.frame_detection import Detector, detect_in_region
from studiorecon.detector.hand_landmarks import HandLandmarks
from studiorecon.detector.movenet import MoveNet
from studiorecon.footage.video import read_frames
from studiorecon.people.fitting.hands import by_side
from studiorecon.people.hand_search import Arm, arm_end, find_hands, hands_of_rows
from studiorecon.scene.camera import Camera, Lens

from benchmarks.cameras import straight
from benchmarks.hands import agreement
from tests.defaults import loaded

NETWORKS = Path("resources/detector")
FPS = 6.0
# Length of the man's hand, and his distance from the webcams.
HAND_M, AWAY_M = 0.18, 1.0


def arms_of(pictures: list[np.ndarray], focal_px: float) -> list[Arm]:
    """The ends of the man's arms in one webcam's pictures."""
    detector = Detector(MoveNet(NETWORKS / "movenet_multipose.onnx"), BlazePose(NETWORKS / "pose_landmark_heavy.onnx"))
    arms, last = [], None
    for frame, picture in enumerate(pictures):
        seen = detect_in_region(detector.placer, picture, last.next_region) if last else None
        found = [seen] if seen else detector.detect_new_people(picture)
        last = max(found, key=lambda one: np.ptp(one.keypoints[:, 0]), default=None)
        for side in (0, 1):
            end = arm_end(LAYOUT, last.keypoints, side) if last else None
            if end is not None and (end[0] >= 0).all() and (end[0] < picture.shape[1::-1]).all():
                arms.append(Arm(frame, frame, side, 0, *end, HAND_M / AWAY_M * focal_px))
    return arms


def _straight(pixels: np.ndarray, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Pixels without the lens's distortion, and where they exist."""
    there = straight(pixels, lens)
    return there, np.isfinite(there).all(-1)


def main() -> None:
    folder = Path(os.environ.get("STUDIORECON_REAL_DATA", "../shared/data")) / "caliscope_webcams"
    names = [f"cam_{k}" for k in range(4)]
    reading = calibration.read_calibration([folder / "camera_array.toml"])
    lenses = calibration.paired_lenses(reading, "camera_array.toml", names, {}, loaded(calibration.Settings))[0]
    network, found, right, spent_s = HandLandmarks(NETWORKS / "hand_landmark_full.onnx"), [], [], np.zeros(2)
    for lens in lenses:
        pictures = list(read_frames(folder / f"calibration_session/{lens.name}.mp4", 0, None))
        began_s = time.process_time()
        arms = arms_of(pictures, lens.intrinsics[0, 0])
        between_s = time.process_time()
        hands = find_hands(network, [pictures[t] for t in sorted({arm.frame for arm in arms})], arms)
        spent_s += between_s - began_s, time.process_time() - between_s
        at, sides = hands_of_rows(hands, len(pictures), partial(_straight, lens=lens))
        found.append(at.astype(np.float64))
        right.append(sides)
        print(f"{lens.name}: {len(hands)} hands at {len(arms)} ends of arms in {len(pictures)} pictures", flush=True)
    cameras = [Camera(lens.name, lens.wh, lens.intrinsics, lens.camera_from_world) for lens in lenses]
    said = np.array(right)
    hands_by_side, exchanged = by_side(np.array(found), said, cameras, FPS)
    print(*agreement("the man's", hands_by_side, cameras, [1.0] * 4), sep="\n")
    agree = ((said > 0.5) == [0, 1])[np.isfinite(said)].mean()
    print(f"exchanged in {exchanged} pictures; the network says the arm's side of {agree:.0%}")
    print(f"body {spent_s[0]:.1f} s, hands {spent_s[1]:.1f} s of processor time")


if __name__ == "__main__":
    main()
