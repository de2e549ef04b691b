# SPDX-License-Identifier: Apache-2.0
"""The bundled body and its class: skinning, joints, keypoints, regions, foreign files."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.model import BodyModel, of_size, shape_and_size, upright_global_orientation
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import BY_COUNT, HAND_POINT_NAMES, JOINT_NAMES, LAYOUTS


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def pose() -> np.ndarray:
    return np.random.default_rng(0).normal(0, 0.4, (3, 72))


@pytest.fixture
def smpl_file(body: BodyModel, tmp_path: Path) -> Path:
    """The bundled body in the arrays of an SMPL file, without anything of ours."""
    regressor = np.linalg.lstsq(body.template_m.T, body.joint_template_m.T, rcond=None)[0].T
    tree = np.array([body.parents, np.arange(24)]).astype(np.uint32)
    arrays = {
        "v_template": body.template_m,
        "shapedirs": body.shape_directions,
        "J_regressor": regressor,
        "weights": body.weights,
    }
    np.savez(tmp_path / "smpl.npz", kintree_table=tree, f=body.faces.astype(np.uint32), **arrays)
    return tmp_path / "smpl.npz"


def test_file_is_the_one_that_was_baked(root: Path) -> None:
    digest, name = (root / "resources/body.npz.sha256").read_text().split()
    assert hashlib.sha256((root / "resources" / name).read_bytes()).hexdigest() == digest


def test_straight_fingers_leave_the_surface_and_bent_ones_move_their_own_hand_only(
    body: BodyModel, pose: np.ndarray
) -> None:
    whole, betas, trans = body.with_fingers, np.full(10, 0.5), np.zeros((3, 3))
    assert whole.names[:24] == JOINT_NAMES
    assert whole.names[24] == "left_index1"
    assert whole.names[53] == "right_thumb3"
    poses = np.concatenate([pose, np.zeros((3, 90))], axis=1)
    straight = whole.vertices(poses, betas, trans)
    assert np.abs(straight - body.vertices(pose, betas, trans)).max() < 1e-6
    bent = poses.copy()
    bent[:, 72 + 2] = -1.0
    moved = np.linalg.norm(whole.vertices(bent, betas, trans) - straight, axis=-1).max(0)
    assert 0.03 < moved.max() < 0.12
    assert (body.weights[moved > 1e-6, JOINT_NAMES.index("left_hand")] > 0).all()
    wrist, *points = np.moveaxis(whole.keypoints(HAND_POINT_NAMES[0], 0 * poses, betas, trans), 1, 0)
    reach = np.linalg.norm(np.array(points) - wrist, axis=-1).reshape(5, 4, 3)
    assert (np.diff(reach, axis=1) > 0.01).all()
    assert (reach.max((0, 1)) < 0.22).all()


def test_body_is_a_plausible_closed_adult(body: BodyModel) -> None:
    assert body.names == JOINT_NAMES
    assert 1.6 < np.ptp(body.template_m[:, 1]) < 1.95
    np.testing.assert_allclose(body.weights.sum(1), 1, atol=1e-6)
    assert ((body.weights > 0).sum(1) <= 4).all()
    # Left is +x, the face looks along +z, the mesh is wound outwards (positive volume of a person).
    assert body.joint_template_m[JOINT_NAMES.index("left_hip"), 0] > 0.05
    assert body.keypoints(["nose"], np.zeros((1, 72)), np.zeros(10), np.zeros((1, 3)))[0, 0, 2] > 0.05
    corners = body.template_m[body.faces]
    volume_m3 = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert 0.045 < volume_m3 < 0.11
    # Left and right mirror each other.
    for name, joint in zip(JOINT_NAMES, body.joint_template_m):
        if name.startswith("left"):
            other = body.joint_template_m[JOINT_NAMES.index("right" + name[4:])]
            np.testing.assert_allclose(other, joint * [-1, 1, 1], atol=2e-3)


def test_skinning_agrees_with_a_plain_loop(body: BodyModel, pose: np.ndarray) -> None:
    betas, trans = np.linspace(-0.5, 0.5, 10), np.array([[1.0, 2, 3]] * 3)
    chosen = np.array([0, 500, 4321, 13000])
    fast = body.vertices(pose, betas, trans, chosen)
    rest, joints = body.rest_vertices(betas), body.rest_joints(betas)
    for t in range(3):
        world, posed = np.zeros((24, 3, 3)), np.zeros((24, 3))
        for j, parent in enumerate(body.parents):
            turn = rotations.exp(pose[t, 3 * j : 3 * j + 3])
            world[j] = turn if parent < 0 else world[parent] @ turn
            posed[j] = trans[t] if parent < 0 else posed[parent] + world[parent] @ (joints[j] - joints[parent])
        for n, v in enumerate(chosen):
            truth = sum(body.weights[v, j] * (world[j] @ (rest[v] - joints[j]) + posed[j]) for j in range(24))
            np.testing.assert_allclose(fast[t, n], truth, atol=5e-6)
        np.testing.assert_allclose(body.joints(pose, betas, trans)[t], posed, atol=1e-12)


def test_keypoint_anchors_equals_the_mesh(body: BodyModel, pose: np.ndarray) -> None:
    betas, trans = np.linspace(-1, 1, 10), np.zeros((3, 3))
    surface = body.vertices(pose, betas, trans).astype(np.float64)
    names = [n for n in body.keypoint_names if not n.endswith("_joint")]
    rows = [body.keypoint_vertices[body.keypoint_names.index(n)] for n in names]
    np.testing.assert_allclose(
        body.keypoints(names, pose, betas, trans), np.einsum("kv,tvx->tkx", rows, surface), atol=3e-6
    )
    joints = body.keypoints([f"{n}_joint" for n in body.names], pose, betas, trans)
    np.testing.assert_allclose(joints, body.joints(pose, betas, trans), atol=1e-12)


def test_a_size_among_the_betas_is_the_scaled_body(body: BodyModel, pose: np.ndarray) -> None:
    betas, trans = np.linspace(-1, 1, 10), np.ones((3, 3))
    bent = replace(body, pose_directions=np.random.default_rng(2).normal(0, 1e-3, (body.vertex_count, 3, 207)))
    large, sized = bent.scaled(1.3), of_size(betas, 1.3)
    np.testing.assert_allclose(bent.vertices(pose, sized, trans), large.vertices(pose, betas, trans), atol=1e-6)
    np.testing.assert_allclose(bent.joints(pose, sized, trans), large.joints(pose, betas, trans), atol=1e-12)
    names = list(body.keypoint_names)[:5]
    np.testing.assert_allclose(
        body.keypoints(names, pose, sized, trans), large.keypoints(names, pose, betas, trans), atol=1e-12
    )
    shape, size = shape_and_size(sized, body.shapes)
    np.testing.assert_allclose([*shape, size], [*betas, 1.3])
    for wrong in (np.append(sized, 0.1), of_size(betas, 0.0)):
        with pytest.raises(ValueError, match="betas for a shape space of 10"):
            body.rest_joints(wrong)


def test_upright_bodies_stand_and_face_their_heading(body: BodyModel) -> None:
    for heading in (0.0, 1.0, np.pi, -2.0):
        poses = np.zeros((1, 72))
        poses[0, :3] = upright_global_orientation(heading)
        head_top, nose, left_ear, right_ear = body.keypoints(
            ["head_top", "nose", "left_ear", "right_ear"], poses, np.zeros(10), np.zeros((1, 3))
        )[0]
        assert head_top[2] > 0.75
        facing = nose - (left_ear + right_ear) / 2
        assert facing[:2] @ [np.cos(heading), np.sin(heading)] > 0.95 * np.linalg.norm(facing[:2])


def test_clothes_are_where_clothes_are(body: BodyModel) -> None:
    height = {name: body.template_m[body.region == i, 1] for i, name in enumerate(body.region_names)}
    assert height["shoes"].max() < height["trousers"].max() < height["shirt"].max() < height["hair"].max()
    assert height["trousers"].min() > height["shoes"].min()
    assert all(len(height[name]) > 50 for name in body.region_names)
    hands = body.weights[:, JOINT_NAMES.index("left_hand")] > 0.5
    assert (body.region[hands] == body.region_names.index("skin")).all()


def test_proxy_follows_the_full_mesh(body: BodyModel, pose: np.ndarray) -> None:
    coarse = body.vertices(pose, np.zeros(10), np.zeros((3, 3)), body.proxy_vertices)
    np.testing.assert_array_equal(coarse, body.vertices(pose, np.zeros(10), np.zeros((3, 3)))[:, body.proxy_vertices])
    assert len(body.proxy_faces) < len(body.faces) / 8
    assert body.proxy_faces.max() < len(body.proxy_vertices)


def test_smpl_file_loads_into_the_same_class(body: BodyModel, smpl_file: Path, pose: np.ndarray) -> None:
    theirs = BodyModel.load(smpl_file)
    assert theirs.identity.startswith("smpl ")
    assert theirs.identity != body.identity
    assert theirs.parents[0] == -1
    np.testing.assert_allclose(theirs.joint_template_m, body.joint_template_m, atol=1e-9)
    np.testing.assert_allclose(
        theirs.joints(pose, [0], np.zeros((3, 3))), body.joints(pose, [0], np.zeros((3, 3))), atol=1e-9
    )
    assert "left_knee_joint" in theirs.keypoint_names


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        ("missing", "is missing"),
        ("text", r"not a readable \.npz .* convert an SMPL \.pkl"),
        ("no weights", "no entry 'weights'"),
        ("nan", "not finite"),
        ("tree", "tree of 24"),
    ],
)
def test_unreadable_bodies_are_refused_with_the_reason(
    smpl_file: Path, tmp_path: Path, damage: str, sentence: str
) -> None:
    path = tmp_path / "broken.npz"
    arrays = dict(np.load(smpl_file))
    if damage == "text":
        path.write_text("hello")
    elif damage != "missing":
        if damage == "no weights":
            del arrays["weights"]
        elif damage == "nan":
            arrays["v_template"][3, 1] = np.nan
        else:
            arrays["kintree_table"] = arrays["kintree_table"][:, :20]
        np.savez(path, **arrays)
    with pytest.raises(UserError, match=sentence) as refusal:
        BodyModel.load(path)
    assert str(path) in str(refusal.value)


def test_betas_of_another_space_are_not_swallowed(body: BodyModel) -> None:
    with pytest.raises(ValueError, match="12 betas"):
        body.rest_joints(np.ones(12))
    with pytest.raises(ValueError, match=r"\(T, 72\)"):
        body.joints(np.zeros((2, 69)), np.zeros(10), np.zeros((2, 3)))


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_are_consistent(body: BodyModel, name: str) -> None:
    layout = LAYOUTS[name]
    assert len(set(layout.keypoints)) == len(layout.keypoints)
    assert name in BY_COUNT[len(layout.keypoints)]
    assert len(layout.among(body.keypoint_names)) >= 14
    for left, right in layout.pairs:
        assert layout.keypoints[left].replace("left", "right") == layout.keypoints[right]
    # Every point the body knows hangs on a limb that is drawn, except lone centres.
    drawn = {k for edge in layout.edges for k in edge}
    lone = {"head_top", "upper_neck", "mid_hip"}
    assert {layout.keypoints[k] for k in layout.among(body.keypoint_names)} - {
        layout.keypoints[k] for k in drawn
    } <= lone


def test_known_orders() -> None:
    assert LAYOUTS["body_25"].keypoints[1:5] == ("neck", "right_shoulder", "right_elbow", "right_wrist")
    assert LAYOUTS["body_25"].keypoints[8] == "mid_hip"
    assert LAYOUTS["body_25b"].keypoints[17:19] == ("upper_neck", "head_top")
    assert LAYOUTS["halpe26"].keypoints[17:22] == ("head_top", "neck", "mid_hip", "left_big_toe", "right_big_toe")
    assert LAYOUTS["wholebody133"].keypoints[17:20] == ("left_big_toe", "left_small_toe", "left_heel")
    assert LAYOUTS["smpl24"].keypoints[15] == "head_joint"
    assert BY_COUNT[25] == ("body_25", "body_25b")
