# SPDX-License-Identifier: Apache-2.0
"""The nouns that pass between steps: a whole file of each, another one's, and what reads it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from studiorecon.body.avatar.avatar_files import Avatar, read_avatar, write_avatar
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person, write_person
from studiorecon.calibration.formats.reading import Reading, read_reading, write_reading
from studiorecon.camera_files.calibration import read_calibration
from studiorecon.camera_files.colmap import read_model, read_points, write_model
from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.deliver.player_data import read_shade
from studiorecon.depth.layout.primitives import Primitive, read_primitives, write_primitives
from studiorecon.depth.layout.votes import read_sweeps
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.render.room_light import Lamps, Light, read_light, write_light
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, Manifest, read_footage, read_manifest, write_footage, write_manifest
from studiorecon.scene.clocks import Clock, Clocks, read_clocks, write_clocks
from studiorecon.scene.decisions import Decision, read_decisions, write_decisions
from studiorecon.scene.factors import read_factors, write_factors
from studiorecon.scene.files import write_json, write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.keypoint_verdict import KeypointVerdict, read_keypoint_verdict, write_keypoint_verdict
from studiorecon.scene.path import PathStep, read_path, write_path
from studiorecon.scene.people import (
    Detections,
    Person,
    read_detections,
    read_identities,
    read_people,
    write_detections,
    write_identities,
    write_people,
)
from studiorecon.scene.provenance import read_provenance, write_provenance
from studiorecon.scene.raw_detections import RawDetections, read_raw_detections, write_raw_detections
from studiorecon.scene.readouts import Readout, read_readouts, write_readouts
from studiorecon.scene.reports import read_association, read_metrics, read_refinement
from studiorecon.scene.room import Platform, RoomBox, read_room, write_room
from studiorecon.splatting.rigid_object import RigidObject, read_objects, write_objects

T, N, WH = 4, 6, (48, 27)


@dataclass(frozen=True)
class Noun:
    """A file between two steps. ``write(path, k)``: that of camera or person ``k``; ``read``: what steps work with."""

    name: str
    write: Callable[[Path, int], object]
    read: Callable[[Path], Any]


def _camera(k: int) -> Camera:
    c, s = math.cos(0.3 + k), math.sin(0.3 + k)
    pose = np.array([[c, 0, -s, 0.2], [0, 1, 0, 1.1], [s, 0, c, 3.0 + k], [0, 0, 0, 1.0]])
    intrinsics = np.array([[500.0 + k, 0, 24], [0, 501.0, 13.5], [0, 0, 1]])
    return Camera(f"cam{k + 1}", WH, intrinsics, pose)


def _lens(k: int) -> dict[str, Any]:
    c = _camera(k)
    flat = np.array([0.01, -0.02, 0.001, 0.002, 0.03])
    return Lens(c.name, c.wh, c.intrinsics, "opencv", flat, c.camera_from_world, np.eye(2, 3)).as_json()


def _footage(k: int) -> Footage:
    k3 = _camera(k).intrinsics.tolist()
    reported = ("videos/cam.mp4", "0" * 64, (96, 54), 0, 0.1 * (k + 1), ["cut"], (3, 4, 5, 7))
    return Footage(f"cam{k + 1}", False, WH, k3, 30.0, T, 3, *reported)


def _rng(k: int) -> np.random.Generator:
    return np.random.default_rng(k)


def _cloud(k: int) -> Gaussians:
    rng = _rng(k)
    shapes = ((N, 3), (N, 4), (N, 3), (N,), (N, 4, 3))
    return Gaussians(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))


def _clocks(k: int) -> Clocks:
    times = tuple(float(t) for t in np.arange(T) / 30 + 0.001 * k)
    return Clocks(30.0, 0.5, T, (Clock("cam1", 30.0, T, times, 0.1, 12.0, 0.01), Clock("cam2", 29.97, T, (), -0.2)))


def _decisions(k: int) -> list[Decision]:
    return [
        Decision("exposure", "difference, %", 3.5 + k, (2.0, 5.0), 1.0, "on", "measured", "%", detail={"n": 3}),
        Decision("shadows", "share", None, None, 0.2, "undetermined", "nothing seen"),
    ]


def _room(k: int) -> RoomBox:
    box = RoomBox(0.1, np.array([-2.0 - k, -3, 0]), np.array([2.5, 3.5, 2.8]), np.ones(6, bool), np.full(6, 0.7))
    gains = {"cam1": np.array([1.0, 1.1, 0.9]), "cam2": np.ones(3)}
    platform = Platform(np.array([-0.5, -0.4]), np.array([0.6, 0.7]), 0.3)
    box = replace(box, fitted=np.array([True] * 5 + [False]), score=np.array([0.7] * 5 + [np.nan]))
    return replace(box, gains=gains, platform=platform)


def _found(k: int) -> dict[str, Any]:
    rng = _rng(k)
    keypoints = np.concatenate([rng.uniform(0, 48, (T, 17, 2)), rng.uniform(0.1, 1, (T, 17, 1))], axis=-1)
    frames = np.arange(T) + k
    return {"camera": f"cam{k + 1}", "layout": "coco17", "frame": frames, "keypoints": keypoints}


def _detections(path: Path, k: int) -> None:
    more = {"points_m": _rng(k + 9).normal(size=(T, 17, 3)), "row": np.arange(T)}
    write_detections(path, Detections(**_found(k), track=np.array([0, 0, 1, 1]), **more))


def _raw(path: Path, k: int) -> None:
    rng = _rng(k)
    more = {
        "presence": rng.uniform(0.2, 1, T),
        "points_m": rng.normal(size=(T, 17, 3)),
        "looked": [(0, T)],
        "note": "x",
    }
    mask = rng.integers(0, 256, (T, 4, 4)).astype(np.uint8)
    write_raw_detections(
        path, RawDetections(**_found(k), **more, mask=mask, mask_from_picture=rng.normal(size=(T, 2, 3)))
    )


@cache
def body() -> BodyModel:
    return BodyModel.load(Path(__file__).parents[2] / "resources" / "body.npz")


def _person(path: Path, k: int) -> None:
    rng, model = _rng(k), body()
    poses, trans, betas = rng.normal(0, 0.2, (T, 72)), rng.normal(0, 1, (T, 3)), rng.normal(0, 0.5, model.shapes)
    joints = model.joints(poses, betas, trans)
    valid, sigma = np.array([True, True, False, True]), np.full((T, 24), 0.01)
    write_person(path, Person(f"p{k}", model.identity, 30.0, poses, trans, betas, joints, valid, sigma, True))


def _avatar(path: Path, k: int) -> None:
    rng, model = _rng(k), body()
    network = TemporalNetwork.start(np.full(3, -1.0), np.full(3, 1.0), T, rng, width=4, layers=2)
    bones, weights = rng.integers(0, 24, (N, 2)).astype(np.uint8), np.full((N, 2), 0.5, np.float32)
    marks = np.array([0, 0, 1, 1, 0, 0], np.uint8)
    motion = (rng.normal(0, 0.2, (T, 72)), rng.normal(0, 1, (T, 3)), rng.normal(0, 0.5, model.shapes), np.ones(T, bool))
    made = Avatar(f"p{k}", model, _cloud(k), bones, weights, marks, *motion, 30.0, True, network)
    write_avatar(path.with_suffix(".ply"), path.with_suffix(".npz"), made, "mark")


def _objects(path: Path, k: int) -> None:
    centres = np.array([[1.0 + k, 2, 3], [1.1, 2, 3], [np.nan] * 3, [1.3, 2, 3]])
    there = np.isfinite(centres[:, 0])
    turned = np.tile(np.eye(3)[[1, 2, 0]], (T, 1, 1))
    thing = RigidObject("o0", _cloud(k), np.zeros(N, np.uint8), centres, there, there, 0.1, turned, "measured")
    write_objects(path, [thing], T)


def _sweep(path: Path, k: int) -> None:
    rng = _rng(k)
    arrays = {"planes": _room(0).faces, "chosen": rng.integers(0, 6, (5, 7)).astype(np.int16), "floor_m": 0.02}
    more = {"cost": rng.uniform(0, 1, (5, 7)), "confident": rng.random((5, 7)) < 0.5, "yaw_rad": 0.1}
    write_npz(path, arrays | more | {"gains": np.array([[1.0, 1.1, 0.9]])})


def _light(path: Path, k: int) -> None:
    lamps = Lamps(np.array([[0.0, 0, 3 + k], [1, 2, 3]]), np.array([[0, 0, -1.0], [0, 0, -1]]), np.array([0.2, 0.3]))
    write_light(path, Light(True, "kept", lamps, np.array([0.5, 0.3]), np.ones(2), 0.1, 0.2, 0.1, 0.0, {"gain": 0.2}))


def _shade(path: Path, k: int) -> None:
    write_npz(path, {"at": np.array([1, 3]), "times": np.array([0, 2, 3]), "factors": np.full((3, 2), 0.8 + 0.01 * k)})


def _model(path: Path, k: int) -> None:
    write_model(path.parent, [_camera(k), _camera(k + 1)], _rng(k).normal(size=(3, 3)))


def _plate(path: Path, k: int) -> None:
    rgba = _rng(k).integers(1, 256, (WH[1], WH[0], 4)).astype(np.uint8)
    cv2.imwrite(str(path), rgba)


def _depth(path: Path, k: int) -> None:
    rng = _rng(k)
    write_depth(path, rng.uniform(1, 5, (WH[1], WH[0])), rng.uniform(0, 1, (WH[1], WH[0])))


def _film(path: Path, k: int, grey: bool) -> None:
    shape = (T, WH[1] // 2 * 2, WH[0]) if grey else (T, WH[1] // 2 * 2, WH[0], 3)
    write_lossless(path, iter(_rng(k).integers(0, 256, shape).astype(np.uint8)), 30.0)


def _people(path: Path, k: int) -> None:
    write_people(path, [("p0", 4, "cam1,cam2", 0.9, "keypoints"), (f"p{k + 1}", 3, "cam1", 0.8, "keypoints")])


def _reading(path: Path, k: int) -> None:
    camera = RawCamera("cam1", WH, _camera(k).intrinsics, "opencv", np.zeros(5), _camera(k).camera_from_world)
    write_reading(path, Reading("a format", (camera,), "m", ("a note",)), "a.toml")


def _association(path: Path, k: int) -> None:
    track = {"camera": "cam1", "track": k, "first": 0, "last": 3, "detections": 4, "person": "p0", "margin": 0.5}
    left_out = {"name": "r0", "seconds": 0.5, "cameras": ["cam2"], "reason": "far", "lines": ["cam2\t0\tp1"]}
    tracks, missed = [{**track, "reason": ""}], [{**left_out, "tracks": [["cam2", 0]]}]
    write_json(path, {"corrected": False, "tracks": tracks, "left_out": missed})


def _refinement(path: Path, k: int) -> None:
    errors = {f"{when}_px_per_camera": [0.5 + k, None] for when in ("before", "after")}
    edges = {"cameras": ["cam1", "cam2"], "off_deg": 0.4, "believed": False, "off_sigmas": 0.5}
    write_json(path, {"cameras": ["cam1", "cam2"], **errors, "edges": edges, "calibration": {"doubts": ["a doubt"]}})


def _metrics(path: Path, k: int) -> None:
    measure, rig = {"value": 20.5 + k, "reason": None}, {"position_deg": 90.0, "viewing_deg": 70.0}
    of_body = dict.fromkeys(("mpjpe_world_mm", "mpjpe_pelvis_mm", "mpjpe_similarity_mm"), 30.5)
    bodies = {"people": {"p0": {"true_person": "a", "frames": 4, **of_body}}, "missed": [], "invented": []}
    metrics = {
        "pictures": {"raw": {"psnr": measure}, "enhanced": {"psnr": measure}},
        "bodies": {**bodies, **of_body, "reason": None},
        "jitter": {"p0": {"joints_mm_f2": 1.5, "pose_deg_f2": None}},
        "coverage": {"orbit": {"measured": 0.5, "inferred": 0.3, "invented": 0.2}},
        "rig": {**rig, "training_cameras": 4},
        "held_out_cameras": [{"sentence": "still", "turned_deg": 0.5, "is_verified": True}],
        "identities": {"accuracy": None},
        "provenance": {"libraries": {"numpy": "2"}, "revision": None, "masks": "none"},
    }
    write_json(path, metrics)


PRIMITIVE = Primitive((1.0, 1.5), 0.2, (0.5, 0.6), 0.0, 1.0, 30.0)
NOUNS = {
    "reading": Noun("read.json", _reading, read_reading),
    "association": Noun("association.json", _association, read_association),
    "refinement": Noun("refinement.json", _refinement, read_refinement),
    "metrics": Noun("metrics.json", _metrics, read_metrics),
    "clocks": Noun("clocks.json", lambda p, k: write_clocks(p, _clocks(k)), read_clocks),
    "footage": Noun("cam1.json", lambda p, k: write_footage(p, _footage(k)), read_footage),
    "manifest": Noun(
        "manifest.json",
        lambda p, k: write_manifest(p, Manifest("demo", 30.0, T, (_footage(k), _footage(k + 1)))),
        read_manifest,
    ),
    "decisions": Noun("decisions.json", lambda p, k: write_decisions(p, _decisions(k)), read_decisions),
    "path": Noun(
        "path.json",
        lambda p, k: write_path(p, [PathStep(_camera(k + i), 1.5 + i, f"0{i}") for i in range(3)], 30.0),
        read_path,
    ),
    "factors": Noun(
        "gains.json", lambda p, k: write_factors(p, {"cam1": np.full((T, 3), 1.1 + k)}), lambda p: read_factors([p], T)
    ),
    "readouts": Noun(
        "readouts.json",
        lambda p, k: write_readouts(p, [Readout("cam1", 0.02, 0.001, 0.02 + k / 99, "")]),
        lambda p: read_readouts(p, ["cam1"]),
    ),
    "room": Noun("room.json", lambda p, k: write_room(p, _room(k)), lambda p: read_room(p, ["cam1", "cam2"])),
    "primitives": Noun(
        "primitives.json",
        lambda p, k: write_primitives(p, [PRIMITIVE, replace(PRIMITIVE, yaw_rad=0.3 + k)]),
        read_primitives,
    ),
    "calibration": Noun(
        "calibration.json",
        lambda p, k: write_json(p, {"lenses": [_lens(k), _lens(k + 1)], "floor_known": True, "notes": ["a note"]}),
        read_calibration,
    ),
    "cameras": Noun("cameras.txt", _model, lambda p: read_model(p.parent)),
    "poses": Noun("images.txt", _model, lambda p: read_model(p.parent)),
    "points": Noun("points3D.txt", _model, lambda p: read_points(p.parent)),
    "detections": Noun("cam1.npz", _detections, read_detections),
    "keypoint verdict": Noun(
        "cam1.json",
        lambda p, k: write_keypoint_verdict(p, KeypointVerdict(f"cam{k + 1}", WH, (1.5, 2.0, 3.0), "", ("a note",))),
        read_keypoint_verdict,
    ),
    "raw detections": Noun("cam1.npz", _raw, lambda p: read_raw_detections(p, True)),
    "people": Noun("people.tsv", _people, read_people),
    "identities": Noun(
        "identities.tsv",
        lambda p, k: write_identities(p, {("cam1", 0): "p0", ("cam2", k): "p1", ("cam2", 12): ""}),
        read_identities,
    ),
    "person": Noun("p0.npz", _person, read_person),
    "avatar": Noun("p0.npz", _avatar, lambda p: read_avatar(p.with_suffix(".ply"), p, body())),
    "avatar's gaussians": Noun("p0.ply", _avatar, lambda p: read_avatar(p, p.with_suffix(".npz"), body())),
    "gaussians": Noun("scene.ply", lambda p, k: write_ply(p, _cloud(k)), read_ply),
    "provenance": Noun(
        "provenance.npz",
        lambda p, k: write_provenance(p, np.array([0, 1, 2, 0, 1, k], np.uint8)),
        lambda p: read_provenance(p, N),
    ),
    "objects": Noun("objects.npz", _objects, read_objects),
    "sweep": Noun("cam1.sweep.npz", _sweep, lambda p: read_sweeps([p], 1)),
    "light": Noun("room.light.json", _light, read_light),
    "shade": Noun("room.shade.npz", _shade, lambda p: read_shade(p, N)),
    "plate": Noun("cam1.png", _plate, lambda p: read_plate(p, WH)),
    "depth": Noun("cam1.exr", _depth, lambda p: read_depth(p, WH)),
    "frames": Noun("cam1.mkv", lambda p, k: _film(p, k, False), lambda p: read_stack(p, 0, T)),
    "masks": Noun("cam1.masks.mkv", lambda p, k: _film(p, k, True), lambda p: read_stack(p, 0, T)),
}
"""Every kind of file that a step writes and another computes with."""
