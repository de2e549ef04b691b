# SPDX-License-Identifier: Apache-2.0
"""Keypoint layouts of the detectors whose files are read: names and orders, left and right, limbs to draw.

Names are the body's (``BodyModel.keypoint_names``) where it has a regressor. Points without one (hands, face details)
are named after their part and number; they are carried along but not fitted. A detector's hip is not SMPL's hip joint:
SMPL's joints are called ``<name>_joint`` and never equated with detector points (M07).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

# SMPL's 24 joints.
JOINT_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
# The joints of the fingers that SMPL-H has after the body's, and the points of each hand in MediaPipe's order under
# Pose2Sim's names: the wrist, then from the thumb on three joints and the tip (4) of each finger.
FINGER_NAMES = tuple(
    f"{side}_{finger}{k}"
    for side in ("left", "right")
    for finger in ("index", "middle", "pinky", "ring", "thumb")
    for k in (1, 2, 3)
)
HAND_POINT_NAMES = tuple(
    (
        f"{side}_wrist_joint",
        *(f"{side}_{f}{k}" for f in ("thumb", "index", "middle", "ring", "pinky") for k in range(1, 5)),
    )
    for side in ("left", "right")
)
_COCO17 = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle",
)  # fmt: skip
_FEET = ("left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel")
_RIGHT_ARM_LEFT_ARM = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
)  # fmt: skip
_LEGS = ("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle")
_EYES_EARS = ("right_eye", "left_eye", "right_ear", "left_ear")


def _numbered(part: str, count: int) -> tuple[str, ...]:
    return tuple(f"{part}_{i}" for i in range(count))


_COCO18 = (*_RIGHT_ARM_LEFT_ARM, *_LEGS, *_EYES_EARS)
_BODY_25 = (*_RIGHT_ARM_LEFT_ARM, "mid_hip", *_LEGS, *_EYES_EARS, *_FEET)
_BODY_25B = (*_COCO17, "upper_neck", "head_top", *_FEET)
_HALPE26 = (
    *_COCO17, "head_top", "neck", "mid_hip", "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe",
    "left_heel", "right_heel",
)  # fmt: skip
_HANDS = (*_numbered("left_hand", 21), *_numbered("right_hand", 21))
WITH_HANDS = "_hands"
"""Ending of the name of a layout that continues another with the points of both hands."""
# Human3.6M's 17, as networks that lift poses to 3D write them.
_HUMAN36M17 = (
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "middle_spine",
    "thorax", "middle_face", "head_top", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow",
    "right_wrist",
)  # fmt: skip
_MPII16 = (
    "right_ankle", "right_knee", "right_hip", "left_hip", "left_knee", "left_ankle", "mid_hip", "thorax", "upper_neck",
    "head_top", "right_wrist", "right_elbow", "right_shoulder", "left_shoulder", "left_elbow", "left_wrist",
)  # fmt: skip
# MediaPipe's 33. Its eyes have corners, its feet one tip, which is the big toe's.
_BLAZEPOSE33 = (
    "nose", "left_inner_eye", "left_eye", "left_outer_eye", "right_inner_eye", "right_eye", "right_outer_eye",
    "left_ear", "right_ear", "left_mouth", "right_mouth", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_little_finger", "right_little_finger", "left_index_finger",
    "right_index_finger", "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee",
    "left_ankle", "right_ankle", "left_heel", "right_heel", "left_big_toe", "right_big_toe",
)  # fmt: skip
# Layout → its keypoints, and the names that programs use for it.
_LISTED: dict[str, tuple[tuple[str, ...], str]] = {
    "blazepose33": (_BLAZEPOSE33, "MediaPipe Pose, BlazePose"),
    "coco17": (_COCO17, "COCO, RTMPose, ViTPose, AlphaPose"),
    "human36m17": (_HUMAN36M17, "Human3.6M, VideoPose3D, MotionBERT"),
    "mpii16": (_MPII16, "MPII, Stacked Hourglass"),
    "openpose_coco18": (_COCO18, "OpenPose COCO"),
    "body_25": (_BODY_25, "OpenPose BODY_25"),
    "body_25b": (_BODY_25B, "OpenPose BODY_25B"),
    "halpe26": (_HALPE26, "Halpe, RTMPose with feet"),
    f"blazepose33{WITH_HANDS}": ((*_BLAZEPOSE33, *_HANDS), "this project, with fingers"),
    f"coco17{WITH_HANDS}": ((*_COCO17, *_HANDS), "COCO with both hands"),
    f"openpose_coco18{WITH_HANDS}": ((*_COCO18, *_HANDS), "OpenPose COCO with `--hand`"),
    f"body_25{WITH_HANDS}": ((*_BODY_25, *_HANDS), "OpenPose BODY_25 with `--hand`"),
    f"body_25b{WITH_HANDS}": ((*_BODY_25B, *_HANDS), "OpenPose BODY_25B with `--hand`"),
    "wholebody133": ((*_COCO17, *_FEET, *_numbered("face", 68), *_HANDS), "COCO-WholeBody, RTMW"),
    "body_135": (
        (*_BODY_25B, *_numbered("left_hand", 20), *_numbered("right_hand", 20), *_numbered("face", 70)),
        "OpenPose BODY_135",
    ),
    "halpe136": ((*_HALPE26, *_numbered("face", 68), *_HANDS), "Halpe with face and hands"),
    "smpl24": (tuple(f"{n}_joint" for n in JOINT_NAMES), "SMPL's joints"),
    # CoMotion's 2D points: projections of its own 3D body, hence the monocular prior and not image evidence (U33).
    "comotion27": (
        (*(f"{n}_joint" for n in JOINT_NAMES[:22]), "nose", "right_eye", "left_eye", "right_ear", "left_ear"),
        "CoMotion",
    ),
}
_LIMBS = (
    ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("shoulder", "hip"), ("eye", "ear"),
    ("ankle", "heel"), ("ankle", "big_toe"), ("big_toe", "small_toe"),
)  # fmt: skip
_ACROSS = (
    ("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"), ("nose", "left_eye"), ("nose", "right_eye"),
    ("nose", "neck"),
)  # fmt: skip
# How far a detector's points are from the body's of the same name, in every direction and in all frames, metres (sigma;
# "" = all others), where that matters. Measured with BlazePose on a real man and on the synthetic studio (``python -m
# benchmarks.detector --parts landmarks``): its ear is in front of the ear, its toe the tip of the shoe.
_OFF_M = {"blazepose33": {"": 0.02, "ear": 0.05, "toe": 0.05}}
_SMPL_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)


@dataclass(frozen=True)
class Layout:
    """One order of keypoints: (left, right) ``pairs``, and ``edges`` to draw as limbs and to measure as bones."""

    name: str
    keypoints: tuple[str, ...]
    pairs: tuple[tuple[int, int], ...]
    edges: tuple[tuple[int, int], ...]

    def index(self, name: str) -> int:
        """Position of a keypoint; ValueError when the layout lacks it."""
        return self.keypoints.index(name)

    def off_m(self, name: str) -> float:
        """Distance between this detector's keypoint and the body's of the same name, metres, one sigma."""
        known = _OFF_M.get(self.name, {})
        return max((known[part] for part in known if part and part in name), default=known.get("", 0.0))

    def among(self, names: Collection[str]) -> list[int]:
        """Indices of the keypoints that are among ``names``, such as those that a body can regress."""
        return [k for k, name in enumerate(self.keypoints) if name in names]


def _layout(name: str, keypoints: tuple[str, ...]) -> Layout:
    at = {n: i for i, n in enumerate(keypoints)}
    pairs = tuple((at[n], at["right" + n[4:]]) for n in keypoints if n.startswith("left") and "right" + n[4:] in at)
    named = [(f"{s}_{a}", f"{s}_{b}") for s in ("left", "right") for a, b in _LIMBS] + list(_ACROSS)
    named += [(f"{JOINT_NAMES[p]}_joint", f"{JOINT_NAMES[j]}_joint") for j, p in enumerate(_SMPL_PARENTS) if p >= 0]
    return Layout(name, keypoints, pairs, tuple((at[a], at[b]) for a, b in named if a in at and b in at))


LAYOUTS = {name: _layout(name, keypoints) for name, (keypoints, _) in _LISTED.items()}

# Number of keypoints → layouts with that many. 25 is ambiguous: OpenPose's default puts the right side first, BODY_25B
# starts as COCO.
BY_COUNT = {
    count: tuple(n for n, one in LAYOUTS.items() if len(one.keypoints) == count)
    for count in sorted({len(one.keypoints) for one in LAYOUTS.values()})
}

USUAL = {17: "coco17"}
"""Number of keypoints → the layout that is meant unless whole people show another one."""


def layouts_table() -> str:
    """The layouts as a table in Markdown."""
    rows = [f"| `{name}` | {len(one.keypoints)} | {_LISTED[name][1]} |" for name, one in LAYOUTS.items()]
    return "\n".join(["| `keypoint_layout` | points | of |", "|---|---|---|", *rows])
