# SPDX-License-Identifier: Apache-2.0
"""The points of hands: their order, and those that recorded keypoints bring.

The order is MediaPipe's, OpenPose's and COCO-WholeBody's: wrist, then four points of each finger from its root to its
tip: thumb, index, middle, ring and little finger. The left hand comes first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.people import Detections

HAND_POINTS = 21
SIDES = ("left", "right")


def with_recorded_hands(found: Detections) -> Detections:
    """``found`` with the hands that are among its keypoints; unchanged where its layout has no hands, or none is seen.

    Layouts of hands without a wrist have the arm's.
    """
    names, columns = LAYOUTS[found.layout].keypoints, []
    for side in SIDES:
        points = [k for k, name in enumerate(names) if name.startswith(f"{side}_hand_")]
        columns.append(points if len(points) != HAND_POINTS - 1 else [names.index(f"{side}_wrist"), *points])
    if {len(points) for points in columns} != {HAND_POINTS}:
        return found
    hands = found.keypoints[:, np.array(columns)].astype(np.float32)
    return replace(found, hands=hands) if (hands[:, :, 1:, 2] > 0).any() else found
