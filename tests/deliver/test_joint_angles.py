# SPDX-License-Identifier: Apache-2.0
"""deliver: joint angles of postures whose angles are known, and both files read back by their own headers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.body.hands import finger_axes
from studiorecon.body.model import BodyModel
from studiorecon.deliver import joint_angles
from studiorecon.keypoints.layouts import FINGER_NAMES, JOINT_NAMES
from studiorecon.scene.files import read_table
from studiorecon.scene.people import Person

FPS = 25.0
# Body axes are x left, y up, z forward; the first turn makes the body stand in a z-up world, facing y.
UPRIGHT = Rotation.from_matrix([[-1, 0, 0], [0, 0, 1], [0, 1, 0]])


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


def posed(body: BodyModel, **turns_deg: tuple[float, float, float]) -> Person:
    """A person with these axis-angles, in degrees about the body's axes, and other joints as at rest."""
    poses = np.zeros((1, 24, 3))
    poses[:, 0] = UPRIGHT.as_rotvec()
    for name, turn in turns_deg.items():
        poses[:, JOINT_NAMES.index(name)] = np.radians(turn)
    betas = np.zeros(body.shapes)
    return moving(body, poses.reshape(1, 72), betas)


def moving(body: BodyModel, poses: np.ndarray, betas: np.ndarray) -> Person:
    trans = np.stack([np.arange(len(poses)), np.zeros(len(poses)), np.full(len(poses), 0.95)], axis=1)
    joints, measured = body.joints(poses, betas, trans), np.ones(len(poses), bool)
    return Person("p0", body.identity, FPS, poses, trans, betas, joints, measured, np.zeros((len(poses), 24)), True)


def angles(person: Person, body: BodyModel) -> dict[str, np.ndarray]:
    return dict(zip((joint.name for joint in joint_angles.JOINTS), joint_angles.angles_deg(person, body)[0]))


HANGING = {"left_shoulder": (0.0, 0.0, -90.0), "right_shoulder": (0.0, 0.0, 90.0)}


def test_fingers_flex_to_the_palm_by_the_angle_they_are_bent(body: BodyModel) -> None:
    turns = np.zeros((2, 5, 3, 3))
    turns[:, 1, 0] = np.radians(40) * finger_axes(body)[:, 1, :, 2]
    turns[:, 0, 0] = np.radians(-10) * finger_axes(body)[:, 0, :, 1]
    person = replace(posed(body), hand_poses=turns.reshape(1, 90), hand_scale=np.ones(2))
    found = dict(zip(FINGER_NAMES, joint_angles.finger_angles_deg(person, body)[0]))
    for side in ("left", "right"):
        assert found[f"{side}_middle1"] == pytest.approx([40, 0, 0], abs=1e-6)
        assert found[f"{side}_index1"] == pytest.approx([0, 10, 0], abs=1e-6), "away from the thumb"
        assert found[f"{side}_middle2"] == pytest.approx([0, 0, 0], abs=1e-6)


def test_standing_with_hanging_arms_is_nearly_zero_but_for_the_palms(body: BodyModel) -> None:
    found = angles(posed(body, **HANGING), body)
    for side in "rl":
        assert found[f"elbow_{side}"][2] == pytest.approx(90, abs=2), "palms face the thighs"
        for name in ("hip", "knee", "arm", "wrist"):
            # The body at rest has its legs apart by 6 degrees, and knees of 8 degrees valgus.
            assert np.abs(found[f"{name}_{side}"]).max() < 9, name
    assert found["pelvis"] == pytest.approx([0, 0, 90], abs=1e-6), (
        "it faces -z of the ground, which is to the left of x"
    )


@pytest.mark.parametrize(
    ("turns", "joint", "axis", "expected"),
    [
        ({"right_hip": (-40.0, 0, 0)}, "hip_r", 0, 40),
        ({"left_hip": (-40.0, 0, 0)}, "hip_l", 0, 40),
        ({"right_knee": (70.0, 0, 0)}, "knee_r", 0, 70),
        ({"left_ankle": (-15.0, 0, 0)}, "ankle_l", 0, 15),
        ({"left_hip": (0, 0, 30.0)}, "hip_l", 1, -30),
        ({"right_hip": (0, 0, -30.0)}, "hip_r", 1, -30),
        ({"right_hip": (0, 20.0, 0)}, "hip_r", 2, 20),
        ({"left_hip": (0, -20.0, 0)}, "hip_l", 2, 20),
        ({**HANGING, "left_elbow": (0, -60.0, 0)}, "elbow_l", 0, 60),
        ({**HANGING, "right_elbow": (0, 60.0, 0)}, "elbow_r", 0, 60),
        ({"right_shoulder": (0, 0, 60.0)}, "arm_r", 1, -30),
        ({**HANGING, "right_wrist": (0, 0, 25.0)}, "wrist_r", 0, 25),
        ({**HANGING, "left_wrist": (0, 0, -25.0)}, "wrist_l", 0, 25),
        ({"spine1": (10.0, 0, 0), "spine3": (15.0, 0, 0)}, "lumbar", 0, -25),
        ({"spine2": (0, 0, 10.0)}, "lumbar", 1, 10),
        ({"neck": (0, 20.0, 0), "head": (0, 15.0, 0)}, "neck", 2, 35),
    ],
)
def test_an_angle_has_its_clinical_sign(body: BodyModel, turns: dict, joint: str, axis: int, expected: float) -> None:
    straight = angles(posed(body, **{name: HANGING.get(name, (0, 0, 0)) for name in turns if name in HANGING}), body)
    moved = angles(posed(body, **turns), body)[joint][axis]
    # The rest posture is straight but for a few degrees.
    still = 0.0 if joint.startswith("arm") else straight[joint][axis]
    assert moved - still == pytest.approx(expected, abs=2.5)


def test_an_arm_that_is_lifted_sideways_over_the_head_turns_steadily(body: BodyModel) -> None:
    lifted = np.linspace(90.0, -85.0, 80)
    poses = np.zeros((80, 24, 3))
    poses[:, 0] = UPRIGHT.as_rotvec()
    poses[:, JOINT_NAMES.index("right_shoulder"), 2] = np.radians(lifted)
    poses[:, JOINT_NAMES.index("right_shoulder"), 0] = 0.02
    person = moving(body, poses.reshape(80, 72), np.zeros(body.shapes))
    arm = joint_angles.angles_deg(person, body)[:, [j.name for j in joint_angles.JOINTS].index("arm_r")]
    whole = Rotation.from_euler("ZXY", arm, degrees=True)
    apart_deg = np.degrees((whole[:-1].inv() * whole[1:]).magnitude())
    assert apart_deg == pytest.approx(apart_deg[0], abs=0.3), "the same rotations"
    assert np.abs(np.diff(arm[:, 1])).max() < 4, "no jump where it passes the pole"
    assert arm[-1, 1] < -150


def test_mot_and_table_are_read_back(body: BodyModel, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    poses = 0.2 * rng.normal(size=(6, 72))
    poses[:, :3] = UPRIGHT.as_rotvec()
    person = replace(
        moving(body, poses, np.zeros(body.shapes)), present=np.arange(6) < 5, valid=np.array([1, 1, 0, 1, 1, 0], bool)
    )
    expected = joint_angles.angles_deg(person, body)
    joint_angles.mot(tmp_path / "p0.mot", person, body)
    header, rows = (tmp_path / "p0.mot").read_text().split("endheader\n")
    described = dict(line.split("=") for line in header.splitlines() if "=" in line)
    assert described["inDegrees"] == "yes"
    columns, *values = (line.split("\t") for line in rows.splitlines())
    assert len(values) == int(described["nRows"]) == 5, "the frame without the person has no row"
    assert {len(row) for row in values} == {len(columns)} == {int(described["nColumns"])}
    assert len(set(columns)) == len(columns)
    numbers = dict(zip(columns, np.array(values, float).T))
    assert numbers["time"] == pytest.approx(np.arange(5) / FPS)
    assert numbers["pelvis_ty"] == pytest.approx(0.95)
    assert numbers["pelvis_tx"] == pytest.approx(np.arange(5))
    names = [joint.name for joint in joint_angles.JOINTS]
    assert numbers["knee_angle_l"] == pytest.approx(expected[:5, names.index("knee_l"), 0], abs=1e-5)

    joint_angles.table(tmp_path / "p0.angles.tsv", person, body)
    listed = read_table(tmp_path / "p0.angles.tsv", ("frame", "time_s", "joint", "flexion_deg", "measured"))
    assert len(listed) == 5 * len(names)
    knees = [row for row in listed if row["joint"] == "knee_l"]
    assert [float(row["flexion_deg"]) for row in knees] == pytest.approx(numbers["knee_angle_l"], abs=1e-3)
    assert [row["measured"] for row in knees] == ["1", "1", "0", "1", "1"]
