# SPDX-License-Identifier: Apache-2.0
"""The files that users may bring, one whole one of each kind, and what reads them."""

from __future__ import annotations

import io
import json
import pickle
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import yaml
from studiorecon.body.model import BodyModel
from studiorecon.calibration.files import Settings, paired_lenses, read_calibration
from studiorecon.depth.estimates import read_estimate
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.footage.frames import decode
from studiorecon.footage.lens_metadata import focal_px_from_metadata
from studiorecon.footage.source import open_source
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import write_watchable
from studiorecon.geometry.lens import rayless_share
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.keypoints.tracking import TrackingLimits, drop_duplicates
from studiorecon.masks.user_masks import mask_pictures
from studiorecon.models.adapters.comotion import Comotion
from studiorecon.people.corrected_identities import read_corrected_identities
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.capture import Footage
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.people import Detections
from studiorecon.studio.description import read_description
from studiorecon.tracks.bodies import Settings as BodySettings
from studiorecon.tracks.bodies import detections_from_bodies, read_bodies, require_used_frames

from tests.made.file_contents import npy, npz


@dataclass(frozen=True)
class Reader:
    """A file that a user may bring, whole, and what reads it and gives what it holds."""

    name: str
    whole: bytes
    right: Callable[[Path], Any]
    beside: tuple[tuple[str, bytes], ...] = ()
    text: bool = True

    def written(self, folder: Path, data: bytes) -> Path:
        for name, content in (*self.beside, (self.name, data)):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder / self.name


def of_json(name: str, value: Any, right: Callable[[Path], Any]) -> Reader:
    return Reader(name, json.dumps(value, indent=1).encode(), right)


def keypoints_right(path: Path) -> Any:
    found = read_keypoints(path, (96, 54))
    assert found.keypoints.shape[0::2] == (len(found.frame), 3)
    assert found.keypoints.dtype == float
    assert np.isin(found.frame, found.pictures).all()
    assert (np.diff(found.frame) >= 0).all()
    order = np.lexsort([np.nansum(found.keypoints, axis=(1, 2)), found.frame])  # people of a picture have no order
    found = replace(found, keypoints=found.keypoints[order])
    return found.only(drop_duplicates(found.frame, found.keypoints, TrackingLimits()))


def calibration_right(path: Path) -> Any:
    files = sorted(path.parent.glob("*.yml")) if path.suffix == ".yml" else [path]
    reading = read_calibration(files)
    names = [c.name for c in reading.cameras]
    lenses, notes, _ = paired_lenses(reading, path.name, names, {}, Settings(unit="m", up="z"))
    print(*notes, sep="\n")
    for lens in lenses:
        assert np.isfinite(lens.intrinsics).all()
        assert np.isfinite(lens.camera_from_world).all()
        try:
            print(rayless_share(lens, lens.wh if min(lens.wh) else (1920, 1080)) > 0)
        except UserError as refusal:
            raise UserError(f"{path}: {refusal}") from None
    return {lens.name: lens for lens in lenses}


def identities_right(path: Path) -> Any:
    seen = [Detections(c, "coco17", np.zeros(1, int), np.array([k]), STOOD[None]) for k, c in enumerate("ab")]
    return read_corrected_identities(path, seen)


def capture_right(path: Path) -> Any:
    found = open_dataset(path.parent)
    assert all(np.isfinite(focal) and focal > 0 for focal in found.focal_px.values())
    assert set(found.held_out) <= set(found.footage)
    print(*found.notes, sep="\n")
    return found


STOOD = np.column_stack([30 + np.arange(17.0) % 5, 20 + 2 * np.arange(17.0), np.full(17, 0.8)])
BESIDE = STOOD + np.array([40, 5, 0.1])
TRIPLES, AWAY = STOOD.ravel().tolist(), BESIDE.ravel().tolist()
OPENPOSE = {"people": [{"person_id": [-1], "pose_keypoints_2d": TRIPLES}, {"pose_keypoints_2d": AWAY}]}
EASYMOCAP = {"annots": [{"personID": 3, "keypoints": STOOD.tolist()}]}
COCO = [{"image_id": f"{t}.jpg", "keypoints": TRIPLES, "idx": 1, "score": 1.0} for t in range(3)]
MMPOSE = {
    "instance_info": [
        {"frame_id": t, "instances": [{"keypoints": STOOD[:, :2].tolist(), "keypoint_scores": [0.5] * 17}]}
        for t in (1, 2)
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
_TEXTS = {
    "openpose": replace(
        of_json("k/f_000.json", OPENPOSE, lambda p: keypoints_right(p.parent)),
        beside=(("k/f_001.json", json.dumps(OPENPOSE).encode()),),
    ),
    "easymocap keypoints": replace(
        of_json("k/f_000.json", EASYMOCAP, lambda p: keypoints_right(p.parent)),
        beside=(("k/f_001.json", json.dumps(EASYMOCAP).encode()),),
    ),
    "coco": of_json("k.json", COCO, keypoints_right),
    "mmpose": of_json("k.json", MMPOSE, keypoints_right),
    "mediapipe": of_json("k.json", MEDIAPIPE, keypoints_right),
    "keypoint npz": Reader(
        "k.npz",
        npz(keypoints=np.tile(np.stack([STOOD, BESIDE]), (4, 1, 1, 1)), ids=np.ones((4, 2))),
        keypoints_right,
        text=False,
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
    "corrected identities": Reader("identities.tsv", b"camera\ttrack\tperson\na\t0\tp0\nb\t1\tp0\n", identities_right),
    "capture.yaml": Reader("capture.yaml", yaml.safe_dump(CAPTURE).encode(), capture_right, VIDEOS),
}


BODY = Path(__file__).parents[2] / "resources" / "body.npz"
STUDIO = Path(__file__).parents[2] / "resources" / "studio" / "demo.yaml"


def plate_right(path: Path) -> Any:
    rgb, measured = read_plate(path)
    assert np.isfinite(rgb).all()
    assert measured.shape == rgb.shape[:2]
    return rgb, measured


def estimate_right(path: Path) -> Any:
    depth, sure = read_estimate(path)
    assert np.isfinite(depth).all()
    assert (depth >= 0).all()
    assert sure.shape == depth.shape
    return depth, sure


def depth_right(path: Path) -> Any:
    depth_m, sure = read_depth(path)
    assert np.isfinite(depth_m).all()
    assert np.isfinite(sure).all()
    return depth_m, sure


def masks_right(path: Path) -> Any:
    found = list(mask_pictures(path.parent))
    assert all(picture.dtype == np.uint8 and picture.ndim == 2 for picture in found)
    return found


def bodies_right(path: Path) -> Any:
    found = require_used_frames(read_bodies(path, Comotion), len(ROWS["id"]), path.name)
    kept = detections_from_bodies(found, Comotion.layout, BODIES_FILM, BodySettings())
    assert np.isfinite(kept.body_pose).all()
    return kept


def film_right(path: Path) -> Any:
    source = open_source(path, 30.0)
    assert np.isfinite(source.fps)
    assert source.fps > 0
    pictures = list(decode(source, 0, 0))
    print(*source.notes, sep="\n")
    assert all(picture.shape == (source.wh[1], source.wh[0], 3) for picture in pictures)
    return pictures, source.fps, focal_px_from_metadata(path, source.wh)


def body_right(path: Path) -> Any:
    joints = BodyModel.load(path).rest_joints(np.zeros(10))
    assert np.isfinite(joints).all()
    return joints


def picture(suffix: str, values: np.ndarray) -> bytes:
    return cv2.imencode(suffix, values)[1].tobytes()


def written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write(path := Path(folder) / f"file{suffix}")
        return path.read_bytes()


def torch_file(rows: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    torch.save({name: torch.from_numpy(values) for name, values in rows.items()}, stream)
    return stream.getvalue()


RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (12, 16), np.uint8)
FILM = [np.repeat(np.roll(GREY, k, 1).repeat(4, 0).repeat(4, 1)[..., None], 3, -1) for k in range(8)]
DEPTH = (1 + RNG.random((12, 16))).astype(np.float32)
ROWS = {
    "id": np.arange(1, 4),
    "frame_idx": np.array([0, 0, 1]),
    "pose": np.zeros((3, 72), np.float32),
    "betas": np.zeros((3, 10), np.float32),
    "trans": np.ones((3, 3), np.float32),
    "conf": np.ones(3, np.float32),
    "pred_2d": np.ones((3, 27, 2), np.float32),
    "pred_3d": np.ones((3, 27, 3), np.float32),
}
BODIES_FILM = Footage("cam", False, (48, 27), np.eye(3).tolist(), 30.0, 3, 0, "", "", (48, 27), 0, 0.0, [])
CLOUD = Gaussians(
    RNG.normal(size=(5, 3)).astype(np.float32),
    np.tile(np.float32([1, 0, 0, 0]), (5, 1)),
    np.full((5, 3), -3, np.float32),
    np.zeros(5, np.float32),
    np.zeros((5, 4, 3), np.float32),
)
_BINARIES = {
    "given plate": Reader("plate.png", picture(".png", np.dstack([GREY] * 4)), plate_right, text=False),
    "plate of 16 bits": Reader("plate.png", picture(".png", GREY.astype(np.uint16) * 257), plate_right, text=False),
    "photograph": Reader("plate.jpg", picture(".jpg", GREY), plate_right, text=False),
    "mask": Reader("masks/0.png", picture(".png", GREY), masks_right, text=False),
    "given depth": Reader(
        "cam.exr", written(lambda p: write_depth(p, DEPTH, DEPTH - 1), ".exr"), depth_right, text=False
    ),
    "depth npy": Reader("cam.npy", npy(DEPTH), estimate_right, text=False),
    "depth npz": Reader("cam.npz", npz(depth=DEPTH), estimate_right, text=False),
    "depth png": Reader("cam.png", picture(".png", (DEPTH * 1000).astype(np.uint16)), estimate_right, text=False),
    "canonical human": Reader("cloud.ply", written(lambda p: write_ply(p, CLOUD), ".ply"), read_ply, text=False),
    "bodies npz": Reader("cam.npz", npz(**ROWS), bodies_right, text=False),
    "bodies pt": Reader("cam.pt", torch_file(ROWS), bodies_right, text=False),
    "film": Reader("cam.mp4", written(lambda p: write_watchable(p, FILM, 30.0), ".mp4"), film_right, text=False),
    "studio": Reader("studio.yaml", STUDIO.read_bytes(), read_description),
}
READERS = _TEXTS | _BINARIES
