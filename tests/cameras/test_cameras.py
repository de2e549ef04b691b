# SPDX-License-Identifier: Apache-2.0
"""Calibration files of six formats, names, worlds and units; the check and refinement on people."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from studiorecon.calibration import files as calibration
from studiorecon.calibration.names import pairings
from studiorecon.calibration.world import camera_up, metres_per_unit
from studiorecon.camera_files.colmap import quaternion_from_rotation, read_model
from studiorecon.camera_files.raw_camera import rigid_camera_from_world
from studiorecon.cameras import refine
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.geometry.camera_motion import move_camera
from studiorecon.geometry.rotations import exp, log
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import write_detections
from studiorecon.scene.schema import record

from tests.made.cameras import detect, ring, walk
from tests.made.cameras_parts import DISTORTION, matrix, write_toml
from tests.made.imported import imported
from tests.made.remedies import follow, made_sentences

FRAMES = 40


def write_easymocap(folder: Path, cameras: list[Camera], newline: str = "\r\n", volcap: bool = False) -> list[Path]:
    intri = extri = "%YAML:1.0\n---\n" + "names:\n" + "".join(f'   - "{c.name}"\n' for c in cameras)
    for c in cameras:
        k = c.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
        intri += matrix(f"K_{c.name}", k) + matrix(
            f"{'D' if volcap else 'dist'}_{c.name}", np.array(DISTORTION).reshape((5, 1) if volcap else (1, 5))
        )
        if volcap:
            intri += f"H_{c.name}: {c.wh[1]}.0\nW_{c.name}: {c.wh[0]}.0\n"
        rotation = c.camera_from_world[:3, :3]
        extri += matrix(f"Rot_{c.name}", rotation) if volcap else matrix(f"R_{c.name}", log(rotation)[:, None])
        extri += matrix(f"T_{c.name}", c.camera_from_world[:3, 3:])
    paths = [folder / "intri.yml", folder / "extri.yml"]
    for path, text in zip(paths, (intri, extri)):
        path.write_text(text.replace("\n", newline), newline="")
    return paths


def write_qualisys(folder: Path, cameras: list[Camera]) -> list[Path]:
    text = "<?xml version='1.0'?><calibration><cameras>"
    for c in cameras:
        axes = np.diag([1, -1, -1]) @ c.camera_from_world[:3, :3]
        r = (
            " ".join(f'r{i + 1}{j + 1}="{axes[i, j]!r}"' for i in range(3) for j in range(3))
            .replace("np.float64(", "")
            .replace(")", "")
        )
        x, y, z = (float(v) * 1000 for v in c.centre_m)
        (fx, fy), (cx, cy) = c.focal_px, c.principal_px
        text += f'<camera active="1" serial="{c.name}" viewrotation="0">'
        text += (
            f'<fov_video left="0" top="0" right="{c.wh[0] - 1}" '
            f'bottom="{c.wh[1] - 1}"/><transform {r} x="{x}" y="{y}" z="{z}"/>'
        )
        text += f'<intrinsic focalLengthU="{fx * 64}" focalLengthV="{fy * 64}" centerPointU="{(cx - 0.5) * 64}" '
        text += f'centerPointV="{(cy - 0.5) * 64}" radialDistortion1="-0.1" radialDistortion2="0.02" '
        text += 'tangentalDistortion1="0.001" tangentalDistortion2="-0.002"/></camera>'
    (folder / "Calib.qca.txt").write_text(text + "</cameras></calibration>")
    return [folder / "Calib.qca.txt"]


def write_colmap(folder: Path, cameras: list[Camera], binary: bool) -> list[Path]:
    parameters = [[*c.focal_px, *c.principal_px, *DISTORTION[:4]] for c in cameras]
    poses = [[*quaternion_from_rotation(c.camera_from_world[:3, :3]), *c.camera_from_world[:3, 3]] for c in cameras]
    suffix = "bin" if binary else "txt"
    paths = [folder / f"cameras.{suffix}", folder / f"images.{suffix}"]
    if binary:
        one, two = struct.pack("<Q", len(cameras)), struct.pack("<Q", len(cameras))
        for i, (c, p, pose) in enumerate(zip(cameras, parameters, poses)):
            one += struct.pack("<iiQQ8d", i + 1, 4, *c.wh, *p)
            two += (
                struct.pack("<idddddddi", i + 1, *pose, i + 1)
                + f"{c.name}/00001.jpg".encode()
                + b"\0"
                + struct.pack("<Q", 1)
                + bytes(24)
            )
        paths[0].write_bytes(one)
        paths[1].write_bytes(two)
    else:
        numbers = [" ".join(f"{v:.17g}" for v in row) for row in parameters]
        lines = [f"{i + 1} OPENCV {c.wh[0]} {c.wh[1]} {n}" for i, (c, n) in enumerate(zip(cameras, numbers))]
        paths[0].write_text("# Camera list\n" + "\n".join(lines) + "\n")
        images = [
            f"{i + 1} " + " ".join(f"{v:.17g}" for v in pose) + f" {i + 1} images/{c.name}.png\n"
            for i, (c, pose) in enumerate(zip(cameras, poses))
        ]
        paths[1].write_text("# Image list\n" + "1.5 2.5 -1\n".join(images) + "\n")
    return paths


def write_nerfstudio(folder: Path, cameras: list[Camera]) -> list[Path]:
    applied = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0.0], [0, 0, 0, 1]])
    frames = []
    for c in cameras:
        (fx, fy), (cx, cy) = c.focal_px, c.principal_px
        pose = applied @ c.world_from_camera @ np.diag([1, -1, -1, 1])
        frames.append(
            {
                "file_path": f"images/{c.name}/0001.png",
                "transform_matrix": pose.tolist(),
                "fl_x": fx,
                "fl_y": fy,
                "cx": cx,
                "cy": cy,
            }
        )
    content = {
        "w": cameras[0].wh[0],
        "h": cameras[0].wh[1],
        "frames": frames,
        "applied_transform": applied[:3].tolist(),
        "camera_model": "OPENCV",
    }
    content |= dict(zip(("k1", "k2", "p1", "p2"), DISTORTION))
    (folder / "transforms.json").write_text(json.dumps(content))
    return [folder / "transforms.json"]


WRITERS = {
    "easymocap": write_easymocap,
    "easyvolcap": lambda f, c: write_easymocap(f, c, "\n", volcap=True),
    "pose2sim": write_toml,
    "caliscope": lambda f, c: write_toml(f, c, caliscope=True),
    "qualisys": write_qualisys,
    "colmap text": lambda f, c: write_colmap(f, c, False),
    "colmap binary": lambda f, c: write_colmap(f, c, True),
    "nerfstudio": write_nerfstudio,
}


@pytest.fixture
def options(default_settings):
    def load(kind: type = calibration.Settings, **changed):
        return settings_module.load(kind, default_settings("cameras", **changed), "cameras")

    return load


def named_ring() -> list[Camera]:
    return [Camera(f"cam{i:02d}", c.wh, c.intrinsics, c.camera_from_world) for i, c in enumerate(ring())]


@pytest.mark.parametrize("form", WRITERS)
def test_every_format_gives_the_same_cameras(tmp_path, options, form):
    cameras = named_ring()
    names = [c.name for c in cameras][::-1]  # the footage's order is not the file's
    imported(options(), WRITERS[form](tmp_path, cameras), names, "{}", tmp_path / "calibration.json")
    lenses = [record(Lens, v) for v in read_json(tmp_path / "calibration.json")["lenses"]]
    assert [lens.name for lens in lenses] == names
    shift = lenses[0].camera_from_world[:3, :3].T @ (
        cameras[-1].camera_from_world[:3, 3] - lenses[0].camera_from_world[:3, 3]
    )
    assert np.abs(shift[:2]).max() < 1e-9  # a COLMAP world has no known floor: only its height may be changed
    assert form.startswith("colmap") or abs(shift[2]) < 1e-9
    for lens, camera in zip(lenses, cameras[::-1]):
        assert np.abs(lens.intrinsics - camera.intrinsics).max() < 1e-9
        assert np.abs(lens.camera_from_world[:3, :3] - camera.camera_from_world[:3, :3]).max() < 1e-9
        assert lens.wh == (camera.wh if form != "easymocap" else (0, 0))
        assert lens.model == "opencv"
        assert np.allclose(lens.distortion[:4], DISTORTION[:4])


def test_pixel_maps_are_inverted(tmp_path, options):
    files = write_toml(tmp_path, named_ring())
    imported(options(), files, ["cam00", "cam01"], '{"cam01": [0.5, 3.0, 7.0]}', tmp_path / "c.json")
    first, second = (np.array(v["calibration_from_video"]) for v in read_json(tmp_path / "c.json")["lenses"])
    assert np.array_equal(first, np.eye(2, 3))
    assert np.allclose(second @ [0.5 * 11 + 3, 0.5 * 13 + 7, 1], [11, 13])


@pytest.mark.parametrize(
    ("footage", "calibrated", "expected"),
    [
        (["cam01", "cam02"], ["int_cam01_img", "int_cam02_img"], ["int_cam01_img", "int_cam02_img"]),
        (["00", "01"], ["0", "1", "2"], ["0", "1"]),
        (["cam_1", "cam_10"], ["cam_10", "cam_1"], ["cam_1", "cam_10"]),
        (["Left", "right"], ["left", "RIGHT"], ["left", "RIGHT"]),
    ],
)
def test_names_are_matched_without_guessing(footage, calibrated, expected):
    assert list(pairings(footage, calibrated, "x")[0].calibrated.values()) == expected


@pytest.mark.parametrize(
    ("footage", "calibrated"),
    [(["a", "b", "c", "d", "e"], ["f", "g", "h", "i", "j"]), (["cam1", "cam2"], ["cam2"]), (["cam01"], [])],
)
def test_a_calibration_for_other_cameras_is_refused_with_both_lists(footage, calibrated):
    with pytest.raises(
        UserError,
        match=f"for other cameras: it has {', '.join(calibrated) or 'none'}, the footage has {', '.join(footage)}",
    ):
        pairings(footage, calibrated, "x")


def test_no_calibration_is_refused_with_what_to_bring():
    with pytest.raises(UserError, match=r"bring intri\.yml"):
        calibration.read_calibration([])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda text: re.sub(r"rotation = \[(\[.*?\]), (\[.*?\]), ", r"rotation = [\2, \1, ", text), "mirror image"),
        (lambda text: text[: len(text) // 2], "not valid TOML|missing"),
        (lambda text: text.replace("translation", "position"), "extrinsic calibration"),
    ],
    ids=["mirrored", "cut short", "intrinsics only"],
)
def test_spoilt_files_are_refused(tmp_path, options, spoil, message):
    path = write_toml(tmp_path, named_ring(), caliscope=True)[0]
    path.write_text(spoil(path.read_text()))
    with pytest.raises(UserError, match=message):
        calibration.read_calibration([path])


def test_scale_is_taken_out_of_a_pose():
    pose = ring()[1].camera_from_world
    clean, scale = rigid_camera_from_world(2.5 * pose[:3, :3], 2.5 * pose[:3, 3], "x")
    assert scale == pytest.approx(2.5)
    assert np.abs(clean - pose).max() < 1e-12


@pytest.mark.parametrize("axis", ["y", "-y", "x", "-z", "tilted"])
def test_a_world_that_is_not_z_up_is_turned_and_said_so(options, axis):
    turn = exp(np.array([0.9, 0.4, 0.2])) if axis == "tilted" else np.linalg.inv(_z_from(axis))
    raw = [
        calibration_raw(move_camera(c, c.camera_from_world[:3, :3] @ turn.T, turn @ c.centre_m)) for c in named_ring()
    ]
    lenses, notes, floor_known = calibration.paired_lenses(
        reading(raw), "x", [c.name for c in named_ring()], {}, options()
    )
    up = camera_up(np.array([lens.camera_from_world[:3, :3] for lens in lenses]))
    assert up[2] > 0.999
    assert any("turned" in n for n in notes)
    assert not floor_known


def test_one_camera_a_kilometre_away_decides_no_unit():
    """Of three, and beside the lenses of stereo pairs, whose base is 10 cm."""
    near = np.array([[0, 0, 0], [4.0, 0, 0], [0, 1000.0, 0]])
    assert metres_per_unit(near, "unknown", "auto")[0] == 1.0
    pairs = np.array([[0, 0, 0], [90.0, 0, 0], [4000.0, 0, 0], [4090.0, 0, 0]])
    assert metres_per_unit(pairs, "unknown", "auto")[0] == 0.001


def test_millimetres_are_recognised_by_the_spread_and_said_so():
    factor, note = metres_per_unit(np.array([[0, 0, 0], [4000.0, 0, 0]]), "unknown", "auto")
    assert factor == 0.001
    assert "millimetres" in note
    assert metres_per_unit(np.array([[0, 0, 0], [4.0, 0, 0]]), "mm", "auto") == (0.001, None)


def _z_from(axis: str) -> np.ndarray:
    from studiorecon.calibration.world import z_up_from_world

    return z_up_from_world(np.eye(3)[None], axis)[0]


def calibration_raw(camera: Camera):
    from studiorecon.camera_files.raw_camera import RawCamera

    return RawCamera(camera.name, camera.wh, camera.intrinsics, "opencv", np.zeros(8), camera.camera_from_world)


def reading(raw):
    from studiorecon.calibration.formats.reading import Reading

    return Reading("test", tuple(raw), "m", ())


PEOPLE = [walk([-0.6, -0.5, 0], [0.02, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.02, 0], FRAMES, 2.0)]


def refined(
    tmp_path: Path,
    given: list[Camera],
    truth: list[Camera],
    settings,
    held_out: tuple[str, ...] = (),
    noise_px: float = 1.5,
):
    """Run the step on what ``truth`` cameras see of two people, with the poses ``given``; files under tmp_path."""
    lenses = [Lens(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world, np.eye(2, 3)) for c in given]
    write_json(tmp_path / "calibration.json", {"lenses": [lens.as_json() for lens in lenses], "floor_known": True})
    footage = tuple(
        Footage(c.name, c.name in held_out, c.wh, c.intrinsics.tolist(), 30.0, FRAMES, 0, "v", "", c.wh, 0, 0.0, [])
        for c in given
    )
    write_manifest(tmp_path / "manifest.json", Manifest("x", 30.0, FRAMES, footage))
    training = [c for c in truth if c.name not in held_out]
    paths = []
    for d in detect(training, PEOPLE, noise_px, np.random.default_rng(0)):
        paths.append(tmp_path / f"{d.camera}.npz")
        write_detections(paths[-1], d)
    refine.run(
        settings,
        tmp_path / "calibration.json",
        tmp_path / "manifest.json",
        paths,
        [],
        [],
        tmp_path / "m" / "images.txt",
        tmp_path / "m" / "heldout" / "images.txt",
        tmp_path / "refinement.json",
        tmp_path / "refinement.png",
    )
    return read_model(tmp_path / "m"), read_model(tmp_path / "m" / "heldout"), read_json(tmp_path / "refinement.json")


def test_a_good_calibration_is_kept_to_the_bit(tmp_path, options):
    cameras = ring()
    model, held_out, report = refined(tmp_path, cameras, cameras, options(refine.Settings), held_out=("c3",))
    assert not report["refined"]
    assert [c.name for c in model] == ["c0", "c1", "c2"]
    assert [c.name for c in held_out] == ["c3"]
    for camera, truth in zip([*model, *held_out], cameras):
        assert np.abs(camera.camera_from_world - truth.camera_from_world).max() < 1e-12
    assert (tmp_path / "refinement.png").stat().st_size > 1000
    assert (tmp_path / "m" / "points3D.txt").read_text().count("\n") > 100


def test_a_camera_that_was_knocked_is_put_back(tmp_path, options):
    truth = ring()
    given = [
        move_camera(truth[0], exp(np.radians([0.3, 1.2, 0.2])) @ truth[0].camera_from_world[:3, :3], truth[0].centre_m),
        *truth[1:],
    ]
    model, _, report = refined(tmp_path, given, truth, options(refine.Settings))
    assert report["refined"]
    assert report["after_px"] < 0.5 * report["before_px"]
    before = np.abs(seen_error(given, truth)).max()
    assert np.abs(seen_error(model, truth)).max() < 0.3 * before


def seen_error(cameras: list[Camera], truth: list[Camera]) -> np.ndarray:
    """(V,) how far, in pixels, the middle of the scene moved in every camera."""
    middle = np.array([[0.0, 0.0, 1.0]])
    return np.array([np.linalg.norm(a.project(middle)[0] - b.project(middle)[0]) for a, b in zip(cameras, truth)])


def test_a_calibration_of_other_cameras_is_refused(tmp_path, options):
    truth = ring()
    given = [
        Camera(t.name, t.wh, t.intrinsics, g.camera_from_world)
        for t, g in zip(truth, [truth[2], truth[0], truth[3], truth[1]])
    ]
    with pytest.raises(UserError, match="calibration"):
        refined(tmp_path, given, truth, options(refine.Settings))


@pytest.mark.parametrize(
    ("place", "metres", "radians"),
    [
        ("cameras/refine.py _nothing_agrees", 10.0, 0.0),
        ("cameras/calibration_check.py Check.refuse_other_starts 2", 1.0, 0.35),
    ],
)
def test_a_calibration_that_fits_nothing_is_refused_and_the_right_one_is_used(
    tmp_path, options, place, metres, radians
):
    truth, rng = ring(), np.random.default_rng(0)
    given = [
        move_camera(
            c,
            exp(radians * rng.normal(size=3)) @ c.camera_from_world[:3, :3],
            c.centre_m + metres * (rng.normal(size=3) if radians else np.array([0, 0, number])),
        )
        for number, c in enumerate(truth)
    ]
    settings = options(refine.Settings)
    follow(place, lambda: refined(tmp_path, given, truth, settings), lambda: refined(tmp_path, truth, truth, settings))


@pytest.mark.parametrize("pair", [(0, 1), (1, 3)])
def test_swapped_cameras_are_refused_by_name(tmp_path, options, pair):
    """Some swaps leave every two cameras with somebody they agree on, and no three: that must not pass for
    unchecked."""
    given = ring()
    for i, j in (pair, pair[::-1]):
        given[i] = Camera(given[i].name, given[i].wh, given[i].intrinsics, ring()[j].camera_from_world)
    with pytest.raises(UserError, match=f"cameras c{pair[0]} and c{pair[1]} are swapped"):
        refined(tmp_path, given, ring(), options(refine.Settings))


def test_two_pairs_of_cameras_that_see_a_person_each_do_not_contradict_one_another(options):
    truth = ring()
    apart = [walk([0, 0, 0], [0.01, 0, 0], FRAMES), walk([30.0, 0, 0], [0, 0.01, 0], FRAMES)]
    there = [move_camera(c, c.camera_from_world[:3, :3], c.centre_m + np.array([30.0, 0, 0])) for c in truth[:2]]
    cameras = [*truth[:2], *(Camera(f"c{i + 2}", c.wh, c.intrinsics, c.camera_from_world) for i, c in enumerate(there))]
    outcome = refine.decide(
        cameras, [], detect(cameras, apart, 1.5, np.random.default_rng(0)), FRAMES, 30.0, True, options(refine.Settings)
    )
    assert not outcome.report["refined"]
    assert all((a.camera_from_world == b.camera_from_world).all() for a, b in zip(outcome.training, cameras))


def test_inverted_poses_are_recognised(tmp_path, options):
    truth = ring()
    given = [Camera(c.name, c.wh, c.intrinsics, np.linalg.inv(c.camera_from_world)) for c in truth]
    with pytest.raises(UserError, match="world-from-camera"):
        refined(tmp_path, given, truth, options(refine.Settings))


def test_without_people_the_calibration_is_used_as_given(tmp_path, options):
    cameras = ring()
    lenses = [
        Lens(c.name, c.wh, c.intrinsics, "opencv", np.zeros(8), c.camera_from_world, np.eye(2, 3)) for c in cameras
    ]
    write_json(tmp_path / "calibration.json", {"lenses": [lens.as_json() for lens in lenses]})
    footage = tuple(
        Footage(c.name, False, c.wh, c.intrinsics.tolist(), 30.0, FRAMES, 0, "v", "", c.wh, 0, 0.0, []) for c in cameras
    )
    write_manifest(tmp_path / "manifest.json", Manifest("x", 30.0, FRAMES, footage))
    refine.run(
        options(refine.Settings),
        tmp_path / "calibration.json",
        tmp_path / "manifest.json",
        [],
        [],
        [],
        tmp_path / "m" / "images.txt",
        tmp_path / "m" / "heldout" / "images.txt",
        tmp_path / "refinement.json",
        tmp_path / "refinement.png",
    )
    assert read_model(tmp_path / "m" / "heldout") == []
    assert read_json(tmp_path / "refinement.json")["reason"] == "no keypoints"


@pytest.mark.real
def test_the_real_calibrations_are_read(real_data, tmp_path, options):
    """Two files of one take against the numbers that were derived from them by hand, and a third with other videos."""
    folder = real_data / "pose2sim_balancing"
    derived = json.loads((folder / "derived" / "cameras_opencv.json").read_text())
    names = ["cam01", "cam02", "cam03", "cam04"]
    for file, key in (("Calib_scene.toml", "scene"), ("Calib.qca.txt", "qualisys")):
        imported(options(), [folder / "calibration" / file], names, "{}", tmp_path / "c.json")
        for lens in read_json(tmp_path / "c.json")["lenses"]:
            expected = derived[key][lens["name"]]
            pose = np.array(lens["camera_from_world"])
            assert np.abs(pose[:3, :3] - expected["R_world_to_cam"]).max() < 1e-8
            assert np.abs(pose[:3, 3] - expected["t_world_to_cam_m"]).max() < 1e-6
            assert np.abs(np.array(lens["intrinsics"])[:2, 2] - np.array(expected["K"])[:2, 2] - 0.5).max() < 1e-4
    others = [real_data / "caliscope_webcams" / "camera_array.toml"]
    with pytest.raises(UserError, match="for other cameras"):
        imported(options(), others, [*names, "cam05"], "{}", tmp_path / "c.json")


def test_cameras_that_all_moved_by_degrees_are_put_back_where_people_see_them(tmp_path, options):
    """Every camera off by 2 to 4° and 15 to 35 cm: nothing agrees as given, and two people could be taken for one
    another."""
    truth, rng = ring(), np.random.default_rng(3)
    given = []
    for camera in truth:
        axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        turn = exp(np.radians(rng.uniform(2, 4)) * axis)
        given.append(
            move_camera(
                camera, turn @ camera.camera_from_world[:3, :3], camera.centre_m + rng.uniform(0.15, 0.35) * way
            )
        )
    with made_sentences() as made:
        model, _, report = refined(tmp_path, given, truth, options(refine.Settings))
    assert "cameras/changes.py log_changes" in made
    with made_sentences() as made:
        refined(tmp_path, truth, truth, options(refine.Settings))
    assert "cameras/changes.py log_changes" not in made, "calibrated again"
    ours, true = ([c.camera_from_world[:3, :3] for c in group] for group in (model, truth))
    pairs = [(i, j) for i in range(len(truth)) for j in range(i)]
    between = [np.degrees(np.linalg.norm(log(ours[i] @ ours[j].T @ (true[i] @ true[j].T).T))) for i, j in pairs]
    assert max(between) < 3 * max(report["sigma_deg"].values())
    assert max(between) < 0.6
    assert report["after_px"] < 3
