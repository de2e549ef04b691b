# SPDX-License-Identifier: Apache-2.0
"""The detector's masks as evidence: in the right place, of the right person, and silent where nobody looked."""

from __future__ import annotations

import numpy as np
from studiorecon.masks.detector_masks import DetectorMasks, masks_by_frame
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections

WH = (120, 80)
K = np.array([[100.0, 0, 60], [0, 100.0, 40], [0, 0, 1]])
# The footage is twice the working size.
LENS = Lens(
    "left",
    (240, 160),
    np.array([[200.0, 0, 120], [0, 200.0, 80], [0, 0, 1]]),
    "opencv",
    np.zeros(8),
    np.eye(4),
    np.eye(2, 3),
)
FOOTAGE = Footage("left", False, WH, K.tolist(), 30.0, 3, 5, "v.mp4", "", (240, 160), 0, 0.0, [])


def scene() -> DetectorMasks:
    """p0's mask in frame 1: the left half of a crop of 64 footage pixels at (80, 40); p1's beside it."""
    half = np.zeros((32, 32), np.uint8)
    half[:, :16] = 255
    affine = np.array([[0.5, 0, -40.0], [0, 0.5, -20.0]])
    rows = [
        (6, np.ones((33, 3)), 0.9, np.zeros((33, 3)), m, a)
        for m, a in ((half, affine), (255 - half, affine - [[0, 0, 32.0], [0, 0, 0]]))
    ]
    found = RawDetections.of("left", "blazepose33", 33, rows, [(5, 3)], "made")
    keypoints = np.full((3, 33, 3), 0.5)
    keypoints[2, :, 2] = 0.1  # a second, less sure track of p0 must not speak for it
    detections = Detections(
        "left", "blazepose33", np.array([1, 1, 1]), np.array([0, 1, 2]), keypoints, row=np.array([0, 1, 1])
    )
    return masks_by_frame(found, detections, {("left", 0): "p0", ("left", 1): "p1", ("left", 2): "p0"}, LENS, FOOTAGE)


def test_a_mask_speaks_where_it_was_looked_and_nowhere_else() -> None:
    messages = scene().evidence(1, ["p0"])
    # Footage 80..112 is p0, 112..144 is not; half of that on the working picture.
    assert (messages[25:45, 42:54] == 1.5).all()
    assert (messages[25:45, 58:70] == -1.5).all()
    assert (messages[25:45, 75:] == 0).all()
    assert (messages[:15] == 0).all()


def test_a_person_beside_another_is_not_denied_by_the_others_mask() -> None:
    both = scene().evidence(1, ["p0", "p1"])
    assert (both[25:45, 42:54] == 1.5).all()
    assert (both[25:45, 92:102] == 1.5).all()


def test_nobody_seen_says_nothing() -> None:
    assert not scene().evidence(0, ["p0", "p1"]).any()
    assert not scene().evidence(1, ["p7"]).any()
