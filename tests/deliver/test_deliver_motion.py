# SPDX-License-Identifier: Apache-2.0
"""deliver: a person's motion in other programs' files, read back by the rules of those formats and not by our
own code.
"""

from __future__ import annotations

import json
import struct
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel, of_size
from studiorecon.deliver import gltf, motion_files
from studiorecon.deliver.export import write_motion
from studiorecon.deliver.gltf import write_glb
from studiorecon.errors import UserError
from studiorecon.scene.people import Person

FRAMES, FPS = 7, 24.0


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture(scope="module")
def person(body: BodyModel) -> Person:
    """Seven frames of a body that turns through a half circle and bends every joint slightly; one frame was
    interpolated.
    """
    rng = np.random.default_rng(4)
    poses = 0.5 * rng.normal(size=(1, 72)) + 0.05 * rng.normal(size=(FRAMES, 72))
    upright = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    turn = Rotation.from_euler("z", np.linspace(150, 330, FRAMES)[:, None], degrees=True)
    poses[:, :3] = (turn * upright).as_rotvec()
    trans = np.stack([np.linspace(-1, 1, FRAMES), np.linspace(0, 0.5, FRAMES), np.full(FRAMES, 0.95)], axis=1)
    betas = rng.normal(size=10)
    valid = np.ones(FRAMES, bool)
    valid[3] = False
    joints = body.joints(poses, betas, trans)
    return Person("p2", body.identity, FPS, poses, trans, betas, joints, valid, np.zeros((FRAMES, 24)), True)


def y_up(points: np.ndarray) -> np.ndarray:
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def fingered(person: Person) -> Person:
    """The person with bent fingers and hands of another size."""
    turns = np.random.default_rng(5).normal(0, 0.3, (FRAMES, 90))
    return replace(person, hand_poses=turns, hand_scale=np.array([1.1, 0.9]))


@pytest.mark.parametrize("fingers", [False, True])
def test_bvh_replays_the_joints(tmp_path: Path, person: Person, body: BodyModel, fingers: bool) -> None:
    """Forward kinematics straight from the file: offsets, channel order and degrees as written there."""
    person = fingered(person) if fingers else person
    skeleton, poses = posed_skeleton(person, body)
    count = 54 if fingers else 24
    motion_files.bvh(tmp_path / "p2.bvh", person, body)
    words = (tmp_path / "p2.bvh").read_text().split()
    names, parents, offsets, stack, at = [], [], [], [], 1
    while words[at] != "MOTION":
        if words[at] in ("ROOT", "JOINT"):
            names.append(words[at + 1])
            parents.append(stack[-1] if stack else -1)
            stack.append(len(names) - 1)
        elif words[at] == "End":
            stack.append(-2)
        elif words[at] == "OFFSET" and stack[-1] >= 0:
            offsets.append([float(v) for v in words[at + 1 : at + 4]])
        elif words[at] == "}":
            stack.pop()
        at += 1
    assert words[at + 1 : at + 3] == ["Frames:", str(FRAMES)]
    assert float(words[at + 5]) == pytest.approx(1 / FPS)
    channels = np.array([float(v) for v in words[at + 6 :]]).reshape(FRAMES, -1)
    assert channels.shape[1] == 6 + (count - 1) * 3
    places, angles = channels[:, :3], channels[:, 3:].reshape(FRAMES, count, 3)
    local = Rotation.from_euler("ZXY", angles.reshape(-1, 3), degrees=True).as_matrix().reshape(FRAMES, count, 3, 3)
    world, joints = [None] * count, np.zeros((FRAMES, count, 3))
    for j, parent in enumerate(parents):
        world[j] = local[:, j] if parent < 0 else world[parent] @ local[:, j]
        joints[:, j] = places if parent < 0 else joints[:, parent] + (world[parent] @ np.array(offsets[j]))
    order = [skeleton.names.index(n) for n in names]
    assert np.abs(joints - y_up(skeleton.joints(poses, person.betas, person.trans)[:, order])).max() < 2e-5, (
        "metres, to six digits"
    )


def test_fingers_are_markers_smplh_poses_and_bones(tmp_path: Path, person: Person, body: BodyModel) -> None:
    """Only for a person who has them; the skin of the glb bends with the bones."""
    hands = fingered(person)
    skeleton, poses = posed_skeleton(hands, body)
    write_motion(tmp_path, hands, body)
    labels = ezc3d.c3d(str(tmp_path / "p2.c3d"))["parameters"]["POINT"]["LABELS"]["value"]
    names = [name for name in (tmp_path / "p2.trc").read_text().splitlines()[3].split("\t")[2:] if name]
    assert labels == names
    assert names[25:27] == ["LThumb1", "LThumb2"]
    assert names[-1] == "RPinky4"
    tip = skeleton.keypoints(["right_pinky4"], poses, hands.betas, hands.trans)
    points = ezc3d.c3d(str(tmp_path / "p2.c3d"))["data"]["points"]
    assert np.abs(points[:3, -1, 0] - 1000 * tip[0, 0]).max() < 1e-2
    spoken = json.loads((tmp_path / "p2.openpose3d.json").read_text())[0]["people"][0]
    assert len(spoken["hand_left_keypoints_3d"]) == 21 * 4
    assert spoken["hand_right_keypoints_3d"][-4:-1] == pytest.approx(tip[0, 0], abs=1e-5)
    with np.load(tmp_path / "p2.amass.npz") as smplh:
        np.testing.assert_array_equal(smplh["poses"], np.concatenate([person.poses[:, :66], hands.hand_poses], axis=1))
    whole = (tmp_path / "p2.glb").read_bytes()
    document = json.loads(whole[20 : 20 + struct.unpack("<I", whole[12:16])[0]])
    assert [node["name"] for node in document["nodes"]][:54] == list(skeleton.names)
    assert len(document["animations"][0]["channels"]) == 55


def test_bvh_in_centimetres_is_the_same_motion(tmp_path: Path, person: Person, body: BodyModel) -> None:
    def lengths(unit: str) -> tuple[np.ndarray, np.ndarray]:
        write_motion(tmp_path / unit, person, body, bvh_unit=unit)
        lines = (tmp_path / unit / "p2.bvh").read_text().split("\n")
        at = next(k for k, line in enumerate(lines) if line.startswith("Frame Time"))
        offsets = [float(v) for line in lines[:at] if "OFFSET" in line for v in line.split()[1:]]
        places = [float(v) for line in lines[at + 1 :] if line for v in line.split()[:3]]
        angles = [float(v) for line in lines[at + 1 :] if line for v in line.split()[3:]]
        return np.array([*offsets, *places]), np.array(angles)

    (in_m, angles), (in_cm, same) = lengths("m"), lengths("cm")
    assert np.abs(in_cm - 100 * in_m).max() < 2e-4
    np.testing.assert_array_equal(angles, same)


def long_motion(person: Person, body: BodyModel, frames: int, fps: float = 120.0) -> Person:
    """A person who walks a millimetre a frame, and is not measured in the last."""
    trans = np.zeros((frames, 3))
    trans[:, 0] = 0.001 * np.arange(frames)
    poses, valid = np.zeros((frames, 72)), np.arange(frames) < frames - 1
    about = fps, poses, trans, np.zeros(body.shapes), np.zeros((1, 24, 3)), valid, np.zeros((1, 24)), True
    return Person("p0", body.identity, *about, np.ones(frames, bool))


def test_without_ezc3d_a_warning_says_that_trc_has_the_markers(
    tmp_path: Path, person: Person, body: BodyModel, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert motion_files.c3d(tmp_path / "p2.c3d", person, body) == []
    assert "p2: no C3D file" in "".join(capsys.readouterr())
    monkeypatch.undo()  # ezc3d is installed
    assert motion_files.c3d(tmp_path / "p2.c3d", person, body)
    assert "no C3D file" not in "".join(capsys.readouterr())


@pytest.mark.parametrize(("frames", "files"), [(100, 1), (101, 2), (170, 2)])
def test_a_motion_longer_than_a_c3d_file_comes_back_whole(
    tmp_path: Path,
    person: Person,
    body: BodyModel,
    frames: int,
    files: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert motion_files._C3D_FRAMES < 2**16, "the header counts frames in 16 bits"
    monkeypatch.setattr(motion_files, "_C3D_FRAMES", 100)
    whole = long_motion(person, body, frames)
    written = motion_files.c3d(tmp_path / "p0.c3d", whole, body)
    assert sorted(tmp_path.iterdir()) == written
    assert len(written) == files
    read = [ezc3d.c3d(str(path))["data"]["points"] for path in written]
    nose_x = np.concatenate([points[0, 0] for points in read])
    assert len(nose_x) == frames
    assert np.abs(np.diff(nose_x[:-1]) - 1).max() < 0.02
    assert np.isnan(nose_x[-1])
    messages = capsys.readouterr().out
    assert all(path.name in messages for path in written) == (files > 1)


def test_an_hour_of_ntsc_is_timed_right_in_every_format(tmp_path: Path, person: Person, body: BodyModel) -> None:
    """Time from the rate in the file must be right within a tenth of a frame at the end."""
    fps, hour = 30_000 / 1001, 108_000
    ntsc = replace(person, fps=fps)
    rates = []
    for name in ("trc", "bvh", "c3d", "amass"):
        motion_files.WRITERS["amass.npz" if name == "amass" else name](tmp_path / f"p2.{name}", ntsc, body)
    rates.append(float((tmp_path / "p2.trc").read_text().split("\n")[2].split("\t")[0]))
    rates.append(1 / float((tmp_path / "p2.bvh").read_text().split("Frame Time:")[1].split()[0]))
    rates.append(ezc3d.c3d(str(tmp_path / "p2.c3d"))["parameters"]["POINT"]["RATE"]["value"][0])
    rates.append(float(np.load(tmp_path / "p2.amass")["mocap_framerate"]))
    assert np.abs(hour / np.array(rates) - hour / fps).max() < 0.1 / fps


def test_a_glb_that_its_lengths_cannot_say_is_refused(
    tmp_path: Path, person: Person, body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_glb(tmp_path / "p2.glb", person, body)
    size = (tmp_path / "p2.glb").stat().st_size
    for limit, refused in ((size, False), (size - 1, True)):
        monkeypatch.setattr(gltf, "_MAX_BYTES", limit)
        with pytest.raises(UserError, match=r"count: N. in capture\.yaml") if refused else nullcontext():
            write_glb(tmp_path / "p2.glb", person, body)


@pytest.mark.parametrize("pitch", [90.0, -90.0, 89.9999, 0.0])
def test_bvh_angles_survive_the_gimbal_lock(pitch: float) -> None:
    rotation = Rotation.from_euler("ZXY", [30, pitch, 20], degrees=True).as_matrix()
    back = Rotation.from_euler("ZXY", motion_files.euler_zxy_deg(rotation), degrees=True).as_matrix()
    assert np.abs(back - rotation).max() < 1e-9


def test_trc_has_named_markers_and_gaps_where_nothing_was_measured(
    tmp_path: Path, person: Person, body: BodyModel
) -> None:
    motion_files.trc(tmp_path / "p2.trc", person, body)
    lines = (tmp_path / "p2.trc").read_text().splitlines()
    assert lines[2].split("\t") == ["24", "24", "7", "25", "m", "24", "1", "7"]
    names = [name for name in lines[3].split("\t")[2:] if name]
    assert names[:3] == ["Nose", "Neck", "RShoulder"]
    assert len(names) == 25
    assert len(lines[3].split("\t")) == len(lines[6].split("\t")) == 2 + 75
    rows = [line.split("\t") for line in lines[6:]]
    assert set(rows[3][2:]) == {""}
    values = np.array(rows[5][2:], np.float64).reshape(25, 3)
    expected = body.keypoints(["nose", "right_heel"], person.poses, person.betas, person.trans)[5]
    assert np.abs(values[[0, 24]] - y_up(expected)).max() < 1e-6
    assert (float(rows[5][0]), float(rows[5][1])) == (6, pytest.approx(5 / FPS, abs=1e-6))


def test_c3d_holds_the_same_markers_in_millimetres_and_none_where_nothing_was_measured(
    tmp_path: Path, person: Person, body: BodyModel
) -> None:
    motion_files.c3d(tmp_path / "p2.c3d", person, body)
    whole = (tmp_path / "p2.c3d").read_bytes()
    file = ezc3d.c3d(str(tmp_path / "p2.c3d"))
    reported = file["parameters"]["POINT"]
    assert reported["LABELS"]["value"][:3] == ["Nose", "Neck", "RShoulder"]
    assert reported["UNITS"]["value"] == ["mm"]
    assert reported["RATE"]["value"].tolist() == [FPS]
    assert reported["FRAMES"]["value"].tolist() == [FRAMES]
    assert [reported[axis]["value"] for axis in ("X_SCREEN", "Y_SCREEN")] == [["+X"], ["+Z"]]
    points = file["data"]["points"]
    assert points.shape == (4, 25, FRAMES)
    expected = 1000 * body.keypoints(["nose", "right_heel"], person.poses, person.betas, person.trans)
    measured = np.flatnonzero(person.valid)
    assert np.abs(points[:3, [0, 24]][..., measured] - expected[measured].transpose(2, 1, 0)).max() < 1e-2
    assert np.isnan(points[:3][..., ~person.valid]).all()
    residuals = file["data"]["meta_points"]["residuals"]
    assert (residuals[..., ~person.valid] == -1).all()
    assert (residuals[..., measured] == 0).all()
    motion_files.c3d(tmp_path / "p2.c3d", person, body)
    assert (tmp_path / "p2.c3d").read_bytes() == whole


def test_openpose_3d_says_which_frames_were_filled(tmp_path: Path, person: Person, body: BodyModel) -> None:
    motion_files.openpose_3d(tmp_path / "p2.json", person, body)
    frames = json.loads((tmp_path / "p2.json").read_text())
    points = np.array([frame["people"][0]["pose_keypoints_3d"] for frame in frames]).reshape(FRAMES, 25, 4)
    assert points[:, 0, 3].tolist() == [1, 1, 1, 0, 1, 1, 1]
    expected = body.keypoints(["left_ankle"], person.poses, person.betas, person.trans)[:, 0]
    assert np.abs(points[:, 14, :3] - expected).max() < 1e-6
    assert frames[0]["people"][0]["person_id"] == [2]


def test_amass_trans_is_smpls(tmp_path: Path, person: Person, body: BodyModel) -> None:
    motion_files.amass(tmp_path / "p2.npz", person, body)
    with np.load(tmp_path / "p2.npz", allow_pickle=False) as data:
        assert data["trans"] + body.rest_joints(data["betas"])[0] == pytest.approx(person.joints[:, 0])
        assert float(data["mocap_framerate"]) == FPS


def test_a_person_with_a_size_of_their_own_brings_shape_and_scale(
    tmp_path: Path, person: Person, body: BodyModel
) -> None:
    betas = of_size(person.betas, 0.6)
    child = replace(person, betas=betas, joints=body.joints(person.poses, betas, person.trans))
    motion_files.amass(tmp_path / "child.npz", child, body)
    with np.load(tmp_path / "child.npz", allow_pickle=False) as data:
        assert data["betas"] == pytest.approx(person.betas)
        assert float(data["scale"]) == pytest.approx(0.6)
        # As another program poses it: the shaped model, times the scale.
        rest = data["scale"] * body.rest_joints(data["betas"])
        assert data["trans"] + rest[0] == pytest.approx(child.joints[:, 0])
        thigh = np.linalg.norm(rest[4] - rest[1])
    assert np.linalg.norm(child.joints[:, 4] - child.joints[:, 1], axis=-1) == pytest.approx(thigh)


def read_glb(path: Path) -> tuple[dict, list[np.ndarray]]:
    """The document and the accessors' arrays of a binary glTF."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    document = json.loads(data[20 : 20 + size])
    binary = data[20 + size + 8 :]
    assert len(binary) == document["buffers"][0]["byteLength"]
    kinds = {5126: "<f4", 5121: "u1", 5125: "<u4"}
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        arrays.append(
            np.frombuffer(raw, kinds[accessor["componentType"]]).reshape(accessor["count"], widths[accessor["type"]])
        )
    return document, arrays


def test_glb_replays_the_surface(tmp_path: Path, person: Person, body: BodyModel) -> None:
    """Nodes, inverse binds and skinning by the glTF specification give the fitted surface."""
    write_glb(tmp_path / "p2.glb", person, body)
    document, arrays = read_glb(tmp_path / "p2.glb")
    assert document["meshes"][0]["name"] == "p2"
    mesh = document["meshes"][0]["primitives"][0]
    rest, bones, weights = (arrays[mesh["attributes"][name]] for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
    assert weights.sum(axis=1) == pytest.approx(1, abs=1e-6)
    bind = arrays[document["skins"][0]["inverseBindMatrices"]].reshape(24, 4, 4).transpose(0, 2, 1)
    samplers = document["animations"][0]["samplers"]
    moves = {
        (c["target"]["node"], c["target"]["path"]): arrays[samplers[c["sampler"]]["output"]]
        for c in document["animations"][0]["channels"]
    }
    worst = 0.0
    for frame in (0, 3, 6):
        world: list = [None] * 24

        def place(node: int, above: np.ndarray, frame: int = frame, world: list = world) -> None:
            own = np.eye(4)
            own[:3, :3] = Rotation.from_quat(moves[node, "rotation"][frame]).as_matrix()
            own[:3, 3] = moves[node, "translation"][frame] if node == 0 else document["nodes"][node]["translation"]
            world[node] = above @ own
            for child in document["nodes"][node].get("children", []):
                place(child, world[node])

        place(0, np.eye(4))
        carried = np.stack(world) @ bind
        blended = np.einsum("vk,vkxy->vxy", weights, carried[bones])
        points = np.einsum("vxy,vy->vx", blended, np.insert(rest, 3, 1, axis=1))[:, :3]
        worst = max(worst, np.abs(points - y_up(body.vertices(person.poses, person.betas, person.trans)[frame])).max())
    assert worst < 0.004, "four bones per vertex instead of all cost less than 4 mm"
    turned = moves[0, "rotation"]
    assert (np.sum(turned[1:] * turned[:-1], axis=1) > 0).all(), "components can be interpolated"
    faces = arrays[mesh["indices"]].reshape(-1, 3)
    normals = arrays[mesh["attributes"]["NORMAL"]]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-5)
    litres = [
        1000 * np.einsum("fx,fx->", v[faces[:, 0]], np.cross(v[faces[:, 1]], v[faces[:, 2]])) / 6
        for v in (rest, rest + 0.005 * normals)
    ]
    assert litres[0] > 30
    assert litres[1] > 1.05 * litres[0], "normals point outwards"
    assert faces.max() < len(rest)


def test_a_fit_of_another_body_is_not_delivered(tmp_path: Path, person: Person, body: BodyModel) -> None:
    written = write_motion(tmp_path, person, body)
    endings = ["amass.npz", "angles.tsv", "bvh", "c3d", "glb", "mot", "openpose3d.json", "trc"]
    assert sorted(p.name for p in written) == [f"p2.{ending}" for ending in endings]
    assert all(p.stat().st_size > 1000 for p in written)
    other = Person(**{**vars(person), "body": "smpl_neutral"})
    with pytest.raises(UserError, match=r"p2 is of the body model smpl_neutral.*use the same body file"):
        write_motion(tmp_path, other, body)


def test_a_motion_too_long_for_a_glb_fits_with_fewer_frames(
    tmp_path: Path, person: Person, body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_glb(path := tmp_path / "p2.glb", person, body)
    monkeypatch.setattr(gltf, "_MAX_BYTES", path.stat().st_size - 1)
    with pytest.raises(UserError, match=r"take fewer frames \(frames: "):
        write_glb(path, person, body)
    fewer = FRAMES - 2
    per_frame = {
        name: getattr(person, name)[:fewer] for name in ("poses", "trans", "joints", "valid", "sigma", "present")
    }
    write_glb(path, replace(person, **per_frame), body)


def test_while_somebody_is_away_formats_say_so_that_can(tmp_path: Path, person: Person, body: BodyModel) -> None:
    away = replace(person, present=np.arange(FRAMES) < 5, valid=person.valid & (np.arange(FRAMES) < 5))
    for name, one in (("always", person), ("away", away)):
        (tmp_path / name).mkdir()
        write_motion(tmp_path / name, one, body)
    frames = json.loads((tmp_path / "away/p2.openpose3d.json").read_text())
    assert [len(frame["people"]) for frame in frames] == [1] * 5 + [0] * 2
    with np.load(tmp_path / "away/p2.amass.npz") as data:
        assert data["present"].tolist() == away.present.tolist()
    document, arrays = read_glb(tmp_path / "away/p2.glb")
    moves = document["animations"][0]
    (sized,) = (c for c in moves["channels"] if c["target"]["path"] == "scale")
    assert sized["target"]["node"] == 0, "the root, and all joints with it"
    sampler = moves["samplers"][sized["sampler"]]
    assert sampler["interpolation"] == "STEP"
    assert arrays[sampler["input"]].ravel() * FPS == pytest.approx(np.arange(FRAMES))
    assert arrays[sampler["output"]].tolist() == [[1.0] * 3] * 5 + [[0.0] * 3] * 2
    always, _ = read_glb(tmp_path / "always/p2.glb")
    assert not any(c["target"]["path"] == "scale" for c in always["animations"][0]["channels"])
    rows = [line.split("\t") for line in (tmp_path / "away/p2.trc").read_text().splitlines()[6:]]
    assert set(rows[6][2:]) == {""}
    # BVH cannot mark absence: the skeleton continues.
    assert (tmp_path / "away/p2.bvh").read_text() == (tmp_path / "always/p2.bvh").read_text()
