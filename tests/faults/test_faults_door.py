# SPDX-License-Identifier: Apache-2.0
"""Files of users, damaged in every way, at every reader: one sentence that names the file, or a right result; never
another exception, and never a number that is not one."""

from __future__ import annotations

import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon.calibration.files import Settings, lenses_of, read_calibration
from studiorecon.errors import UserError
from studiorecon.keypoints.readers import MOST_PEOPLE_PER_PICTURE, read_keypoints
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.names import checked_name
from studiorecon.scene.numbered import gaps_named, pictures_in
from studiorecon.scene.outside import read_npz
from studiorecon.scene.people import read_identities

from tests.faults import damage
from tests.faults.readers import NIGHTLY, SAMPLE, Reader, damaged, npy, npz, of_json, survives


def keypoints_right(path: Path) -> None:
    found = read_keypoints(path)
    assert found.keypoints.shape[0::2] == (len(found.frame), 3)
    assert found.keypoints.dtype == float
    assert np.isin(found.frame, found.pictures).all()
    assert (np.diff(found.frame) >= 0).all()


def calibration_right(path: Path) -> None:
    files = sorted(path.parent.glob("*.yml")) if path.suffix == ".yml" else [path]
    reading = read_calibration(files)
    names = [c.name for c in reading.cameras]
    lenses, *_ = lenses_of(reading, path.name, names, {}, Settings(unit="m", up="z"))
    for lens in lenses:
        assert np.isfinite(lens.intrinsics).all()
        assert np.isfinite(lens.camera_from_world).all()


def identities_right(path: Path) -> None:
    assert all(isinstance(track, int) for _, track in read_identities(path))


def capture_right(path: Path) -> None:
    found = open_dataset(path.parent)
    assert all(np.isfinite(focal) and focal > 0 for focal in found.focal_px.values())
    assert set(found.held_out) <= set(found.footage)


TRIPLES = (np.arange(51.0) % 17).tolist()
OPENPOSE = {"people": [{"person_id": [-1], "pose_keypoints_2d": TRIPLES}, {"pose_keypoints_2d": TRIPLES}]}
EASYMOCAP = {"annots": [{"personID": 3, "keypoints": [[1.0, 2.0, 0.5]] * 17}]}
COCO = [{"image_id": f"{t}.jpg", "keypoints": TRIPLES, "idx": 1, "score": 1.0} for t in range(3)]
MMPOSE = {
    "instance_info": [
        {"frame_id": t, "instances": [{"keypoints": [[1.0, 2.0]] * 17, "keypoint_scores": [0.5] * 17}]} for t in (1, 2)
    ]
}
POSE = [[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 2.0]]
TRANSFORMS = {
    "fl_x": 900.0,
    "w": 1920,
    "h": 1080,
    "k1": 0.01,
    "frames": [
        {"file_path": f"images/{c}/0.png", "transform_matrix": [[1.0, 0, 0, x], [0, 1.0, 0, 0], [0, 0, 1.0, 0]]}
        for c, x in (("a", 0.0), ("b", 3.0))
    ],
}
TRAIN_META = {"w": 640, "h": 360, "k": [[[[500.0, 0, 320], [0, 500, 180], [0, 0, 1]]]], "w2c": [[POSE]]}
CAPTURE = {
    "held_out": ["c"],
    "frames": {"first": 0, "count": 30},
    "focal_px": {"a": 900.0},
    "height_m": {"p0": 1.7},
    "distance_m": ["a", "b", 3.2],
    "starts": {"a": 3},
    "people": 2,
    "keypoint_layout": "coco17",
    "pixel_maps": {"a": {"scale": 0.5, "offset": [0.0, 7.0]}},
    "masks": "videos",
    "train": ["a", "b"],
}
TOML = """[int_cam0_img]\nname = "int_cam0_img"\nsize = [ 1920.0, 1080.0,]
matrix = [ [ 1000.0, 0.0, 960.0,], [ 0.0, 1000.0, 540.0,], [ 0.0, 0.0, 1.0,],]
distortions = [ 0.0, 0.0, 0.0, 0.0,]\nrotation = [ 0.1, 0.2, 0.3,]\ntranslation = [ 0.1, 0.2, 3.0,]\nfisheye = false
"""
INTRI = """%YAML:1.0\n---\nnames:\n  - "a"\nK_a: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d
  data: [1000.0, 0.0, 960.0, 0.0, 1000.0, 540.0, 0.0, 0.0, 1.0]\n"""
EXTRI = """%YAML:1.0\n---\nnames:\n  - "a"\nR_a: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n  data: [0.1, 0.2, 0.3]
T_a: !!opencv-matrix\n  rows: 3\n  cols: 1\n  dt: d\n  data: [0.1, 0.2, 3.0]\n"""
CSV = "cam_uid,tx_world_cam,ty_world_cam,tz_world_cam,qw_world_cam,qx_world_cam,qy_world_cam,qz_world_cam," + (
    "intrinsics_0,intrinsics_1,intrinsics_2,intrinsics_3,image_width,image_height\n"
    "cam1,0,1,2,1,0,0,0,1000,1000,960,540,1920,1080\n"
)
QCA = """<calibration><cameras><camera active="1" serial="7" viewrotation="0">
<fov_video left="0" top="0" right="1919" bottom="1079"/>
<transform x="0" y="0" z="1000" r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1"/>
<intrinsic focalLengthU="64000" focalLengthV="64000" centerPointU="61440" centerPointV="34560"/>
</camera></cameras></calibration>"""


PARTS = [f"{side}{part}" for part in ("Shoulder", "Hip", "Knee", "Ankle") for side in "LR"]
DEEPLABCUT = "\n".join(
    ",".join([first, *(cell for part in PARTS for cell in cells(part))])
    for first, cells in {
        "scorer": lambda part: ["net"] * 3,
        "individuals": lambda part: ["one"] * 3,
        "bodyparts": lambda part: [part] * 3,
        "coords": lambda part: ["x", "y", "likelihood"],
        "0": lambda part: ["10.5", "20", "0.9"],
        "1": lambda part: ["", "", ""],
    }.items()
)


XCP = """<Cameras VERSION="2.0"><Camera DEVICEID="7" PIXEL_ASPECT_RATIO="1" SENSOR_SIZE="1920 1080"><KeyFrames>
<KeyFrame FOCAL_LENGTH="1000" ORIENTATION="0.5 0.5 0.5 0.5" POSITION="0 0 1000" PRINCIPAL_POINT="960 540"
VICON_RADIAL2="Vicon3Parameter 960 540 1e-8 0 0"/></KeyFrames></Camera></Cameras>"""
MCAL = """<?xml version="1.0" encoding="UTF-16LE"?><Cameras><Camera Serial="C7">
<Attributes ImagerPixelWidth="1920" ImagerPixelHeight="1080"/>
<IntrinsicStandardCameraModel LensCenterX="960" LensCenterY="540" HorizontalFocalLength="1000"
VerticalFocalLength="1000" k1="0" k2="0" k3="0" TangentialX="0" TangentialY="0"/>
<Extrinsic X="0" Y="1" Z="2" OrientMatrix0="1" OrientMatrix1="0" OrientMatrix2="0" OrientMatrix3="0" OrientMatrix4="1"
OrientMatrix5="0" OrientMatrix6="0" OrientMatrix7="0" OrientMatrix8="1"/></Camera></Cameras>"""
BIOCV = """1920\n1080\n\n1000 0 960\n0 1000 540\n0 0 1\n
1 0 0 0\n0 0 -1 0\n0 1 0 3000\n0 0 0 1\n\n0.01 0 0 0 0\n"""
OPENCAP = {
    "intrinsicMat": np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]]),
    "distortion": np.zeros((1, 5)),
    "imageSize": np.array([[1080.0], [1920.0]]),
    "rotation": np.eye(3),
    "translation": np.zeros((3, 1)),
}


VIDEOS = tuple((f"videos/{c}.mp4", b"") for c in "abc")
MEDIAPIPE = [{"pose_landmarks": [[{"x": 0.5, "y": 0.25, "z": 0.0, "visibility": 0.9}] * 33]}, {"pose_landmarks": []}]
READERS = {
    "openpose": Reader("k/f_000.json", json.dumps(OPENPOSE).encode(), lambda p: keypoints_right(p.parent), OPENPOSE),
    "easymocap keypoints": Reader(
        "k/f_000.json", json.dumps(EASYMOCAP).encode(), lambda p: keypoints_right(p.parent), EASYMOCAP
    ),
    "coco": of_json("k.json", COCO, keypoints_right),
    "mmpose": of_json("k.json", MMPOSE, keypoints_right),
    "mediapipe": of_json("k.json", MEDIAPIPE, keypoints_right),
    "keypoint npz": Reader(
        "k.npz", npz(keypoints=np.ones((4, 2, 17, 3)), ids=np.ones((4, 2))), keypoints_right, text=False
    ),
    "deeplabcut": Reader("k.csv", DEEPLABCUT.encode(), keypoints_right),
    "transforms": of_json("transforms.json", TRANSFORMS, calibration_right),
    "train_meta": of_json("train_meta.json", TRAIN_META, calibration_right),
    "toml": Reader("Calib.toml", TOML.encode(), calibration_right),
    "intri": Reader("intri.yml", INTRI.encode(), calibration_right, beside=(("extri.yml", EXTRI.encode()),)),
    "extri": Reader("extri.yml", EXTRI.encode(), calibration_right, beside=(("intri.yml", INTRI.encode()),)),
    "egoexo": Reader("gopro_calibs.csv", CSV.encode(), calibration_right),
    "qualisys": Reader("c.qca.txt", QCA.encode(), calibration_right),
    "vicon": Reader("c.xcp", XCP.encode(), calibration_right),
    "optitrack": Reader("c.mcal", MCAL.encode("utf-16"), calibration_right, text=False),
    "biocv": Reader("c.calib", BIOCV.encode(), calibration_right),
    "opencap": Reader("c.pickle", pickle.dumps(OPENCAP), calibration_right, text=False),
    "llff": Reader(
        "poses_bounds.npy",
        npy(np.array([[0, 1, 0, x, 360, 1, 0, 0, 0, 640, 0, 0, -1, 0, 500, 1, 9.0] for x in (0, 2.0)])),
        calibration_right,
        text=False,
    ),
    "identities": Reader("identities.tsv", b"camera\ttrack\tperson\na\t0\tp0\nb\t1\tp0\n", identities_right),
    "capture.yaml": Reader("capture.yaml", yaml.safe_dump(CAPTURE).encode(), capture_right, CAPTURE, VIDEOS),
}
EVERY = pytest.mark.parametrize("reader", READERS.values(), ids=READERS)


@EVERY
def test_the_whole_file_is_right(reader: Reader, tmp_path: Path) -> None:
    assert survives(reader, reader.written(tmp_path, reader.whole)) == "right"


@EVERY
@pytest.mark.parametrize("kind", damage.HARMLESS)
def test_what_editors_do_to_text_does_no_harm(reader: Reader, kind: str, tmp_path: Path) -> None:
    if reader.text:
        data = damage.HARMLESS[kind](reader.whole)
        assert survives(reader, reader.written(tmp_path, data)) == "right"


@EVERY
@pytest.mark.parametrize("kind", damage.ENCODINGS)
def test_what_is_no_such_file_is_refused(reader: Reader, kind: str, tmp_path: Path) -> None:
    path = reader.written(tmp_path, damage.ENCODINGS[kind](reader.whole))
    said = survives(reader, path)
    # XML says its own encoding, and an archive may stand behind other bytes.
    harmless = {("c.qca.txt", "utf-16"), ("c.xcp", "utf-16"), ("k.npz", "latin-1")}
    may_be_whole = reader.name in ("capture.yaml", "identities.tsv") and kind in ("empty", "half")
    if not may_be_whole and (reader.name, kind) not in harmless:
        assert said != "right"
        assert path.name in said or path.parent.name in said


@EVERY
def test_damage_ends_in_a_sentence_or_a_right_result(reader: Reader, tmp_path: Path) -> None:
    damaged(reader, reader.written(tmp_path, reader.whole), SAMPLE, 0)


@pytest.mark.slow
@EVERY
def test_damage_ends_in_a_sentence_or_a_right_result_ten_thousand_times(reader: Reader, tmp_path: Path) -> None:
    damaged(reader, reader.written(tmp_path, reader.whole), NIGHTLY, 1)


def test_a_crowd_beyond_the_limit_is_refused_with_its_frame(tmp_path: Path) -> None:
    people = [{"pose_keypoints_2d": TRIPLES}] * (MOST_PEOPLE_PER_PICTURE + 1)
    (tmp_path / "cam_0007.json").write_text(json.dumps({"people": people}))
    with pytest.raises(UserError, match=r"frame 7: 501 detections .* at most 500"):
        read_keypoints(tmp_path)


def test_an_array_that_promises_more_than_it_holds_reserves_nothing(tmp_path: Path) -> None:
    whole = npy(np.zeros((4, 4)))
    promised = whole.replace(b"(4, 4)", b"(4, 9999999999)").replace(b" " * 9 + b"\n", b"\n", 1)
    with zipfile.ZipFile(tmp_path / "k.npz", "w") as archive:
        archive.writestr("keypoints.npy", promised)
    with pytest.raises(UserError, match=r"promises|not a readable array"):
        read_npz(tmp_path / "k.npz")


def test_numbered_pictures_come_in_the_order_of_their_numbers_and_gaps_are_named(tmp_path: Path) -> None:
    for number in (*range(12), 14, 15, 20):
        (tmp_path / f"{number}.png").touch()
    found = pictures_in(tmp_path)
    assert [int(p.stem) for p in found] == [*range(12), 14, 15, 20]
    assert gaps_named(found) == "12, 13, 16 and 3 more"
    assert gaps_named(found[:12]) == ""


@pytest.mark.parametrize("name", damage.NAMES)
def test_hostile_names_are_refused(name: str) -> None:
    with pytest.raises(UserError, match="cannot be used"):
        checked_name(name, "the scene", "rename it")


@pytest.mark.parametrize("name", ["cam 1", "GX010042", "video (1)", "Küche", "cam_01.left", "カメラ1"])
def test_ordinary_names_are_taken(name: str) -> None:
    assert checked_name(name, "the scene", "rename it") == name
