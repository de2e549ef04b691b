# SPDX-License-Identifier: Apache-2.0
"""Pelvises at the scene's depth: a monocular network's depth in the metres of the first moment, by one alignment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import write_lossless
from studiorecon.geometry.triangulation import Limits
from studiorecon.keypoints.correspondence import stable_detections
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.models.adapters import moge
from studiorecon.models.catalogue.card import Card
from studiorecon.people import lift
from studiorecon.people.association.affinity import AssociationLimits, track_pairs
from studiorecon.people.association.gaps import group_tracks
from studiorecon.people.association.grouping import TrackComparison
from studiorecon.people.lift import Lifting, Settings
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections, read_detections, write_detections

from tests.made.cameras import detect, look_at, walk

WH = (160, 88)
FRAMES = 6
UNIT, SHIFT = 0.4, 0.3
THICK_M = 0.13
PLACES = np.array([[0.6, -0.2, 1.0], [-0.7, 0.5, 1.0]])
LAYOUT = LAYOUTS["body_25"]


def rig() -> list[Camera]:
    return [
        look_at(name, np.array(place), [0, 0, 1]).resized(WH)
        for name, place in (("a", [4.0, 0.5, 1.5]), ("b", [0.3, 4.0, 1.4]), ("c", [-3.5, -1.0, 1.6]))
    ]


def room_depth(camera: Camera) -> np.ndarray:
    """(H, W) z-depth of the walls of a box of 10 m by 9 m by 6 m."""
    origin, directions = camera.rays()
    half = np.array([5.0, 4.5, 3.0])
    with np.errstate(divide="ignore"):
        return np.where(directions > 0, (half - origin) / directions, (-half - origin) / directions).min(-1)


def moments(camera: Camera) -> list[np.ndarray]:
    """Depth (H, W) of the room with two balls about the pelvises, frame by frame: the first walks."""
    origin, directions = camera.rays()
    depths = []
    for t in range(FRAMES):
        depth = room_depth(camera)
        for place in pelvises(t):
            o = origin - place
            a, b, c = (directions**2).sum(-1), (directions * o).sum(-1), (o**2).sum() - THICK_M**2
            root = b**2 - a * c
            hit = (-b - np.sqrt(np.maximum(root, 0))) / a
            depth = np.where((root > 0) & (hit > 0), np.minimum(depth, hit), depth)
        depths.append(depth)
    return depths


def pelvises(t: int) -> np.ndarray:
    return PLACES + np.array([[0.1 * t, 0.0, 0.0], [0.0, 0.0, 0.0]])


def seen_by(camera: Camera) -> Detections:
    """Two people with a pelvis pixel, and shoulders and feet that say how large they are."""
    frames, tracks, points, own = [], [], [], []
    for t in range(FRAMES):
        for k, place in enumerate(pelvises(t)):
            keypoints = np.full((25, 3), np.nan)
            keypoints[:, 2] = 0
            for name, up in (("left_shoulder", 0.45), ("right_shoulder", 0.45), ("left_ankle", -0.9)):
                keypoints[LAYOUT.index(name)] = [*camera.project(place + np.array([0, 0, up]))[0], 0.9]
            frames.append(t)
            tracks.append(k)
            points.append(keypoints)
            own.append([*camera.project(place)[0], np.nan])
    return Detections(
        camera.name, "body_25", np.array(frames), np.array(tracks), np.array(points), pelvis=np.array(own)
    )


def network_depths(camera: Camera) -> dict[int, np.ndarray]:
    """What a network says of them in a unit of its own."""
    return {t: (d - SHIFT) / UNIT for t, d in enumerate(moments(camera))}


def lifted_m(camera: Camera, found: Detections) -> np.ndarray:
    """(D, 3) world places of lifted pelvises."""
    assert found.pelvis is not None
    return camera.unproject(found.pelvis[:, :2], found.pelvis[:, 2])


def planted(camera: Camera, **lifting: float) -> tuple[Detections, np.ndarray]:
    seen, predicted, first_m = seen_by(camera), network_depths(camera), moments(camera)[0]
    alignment = lift.align_to_first(predicted, first_m, seen)
    assert alignment.model == "affine"
    return lift.lift_detections(seen, predicted, first_m, alignment, camera, Lifting(**lifting)), np.concatenate(
        [pelvises(t) for t in range(FRAMES)]
    )


@pytest.mark.parametrize("camera", rig(), ids=lambda c: c.name)
def test_pelvises_come_out_where_they_are(camera: Camera) -> None:
    found, truth = planted(camera)
    gap_m = np.linalg.norm(lifted_m(camera, found) - truth, axis=-1)
    assert gap_m.max() < 0.03
    # The paper's letter reads the surface, which is as far in front as the body is thick.
    found, _ = planted(camera, surface_to_joint_m=0.0)
    gap_m = np.linalg.norm(lifted_m(camera, found) - truth, axis=-1)
    assert gap_m == pytest.approx(np.full(len(gap_m), THICK_M), abs=0.03)


def test_one_alignment_for_all_frames_keeps_a_person_who_stands_at_one_depth() -> None:
    camera = rig()[0]
    seen, predicted, first_m = seen_by(camera), network_depths(camera), moments(camera)[0]
    # The walls differ from frame to frame, people do not: a fit of each frame's own would move whoever stands.
    rng = np.random.default_rng(5)
    for t, depth in predicted.items():
        nobody = lift.static_pixels(camera.hw, seen.keypoints[seen.frame == t])
        predicted[t] = np.where(nobody, depth * rng.normal(1, 0.02, depth.shape), depth)
    alignment = lift.align_to_first(predicted, first_m, seen)
    assert alignment.scale == pytest.approx(UNIT, rel=0.1)
    alone = [lift.align_to_first({t: depth}, first_m, seen).scale for t, depth in predicted.items()]
    assert np.ptp(alone) > 1e-4
    found = lift.lift_detections(seen, predicted, first_m, alignment, camera, Lifting())
    still = lifted_m(camera, found)[seen.track == 1][1:]
    assert np.ptp(still, axis=0).max() < 1e-9


def test_the_first_moment_keeps_its_own_depth() -> None:
    camera = rig()[0]
    seen, predicted = seen_by(camera), network_depths(camera)
    first_m = moments(camera)[0]
    alignment = lift.align_to_first(predicted, first_m, seen)
    nearer = lift.lift_detections(seen, predicted, 0.9 * first_m, alignment, camera, Lifting())
    assert nearer.pelvis is not None
    as_it_was = lift.lift_detections(seen, predicted, first_m, alignment, camera, Lifting())
    assert as_it_was.pelvis is not None
    moved = np.abs(nearer.pelvis[:, 2] - as_it_was.pelvis[:, 2]) > 0.05
    assert moved[seen.frame == 0].all()
    assert not moved[seen.frame > 0].any()


def test_people_are_no_part_of_what_stands_still() -> None:
    points = np.zeros((1, 25, 3))
    points[0, :2] = [[40, 20, 0.9], [60, 60, 0.9]]
    mask = lift.static_pixels((88, 160), points)
    assert not mask[20:61, 40:61].any()
    assert not mask[15, 36]
    assert mask[5].all()
    assert mask[:, 80].all()


def test_without_a_body_the_middle_of_the_hips_is_lifted() -> None:
    seen = replace(seen_by(rig()[0]), pelvis=None)
    assert np.isnan(lift.pelvis_pixels(seen)).all()
    for name, x in (("left_hip", 30.0), ("right_hip", 40.0)):
        seen.keypoints[0, LAYOUT.index(name)] = [x, 50.0, 0.8]
    assert lift.pelvis_pixels(seen)[0].tolist() == [35.0, 50.0]


def run_lifting(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    camera: Camera,
    bend: Callable[[np.ndarray], np.ndarray] = np.asarray,
    apart: float = 0.5,
) -> Detections:
    """The whole step, with a calibration whose unit is ``apart`` of that of the cameras in use; ``bend``s depth."""
    frames = iter(network_depths(camera).values())

    class Planted:
        def __init__(self, card: Card, weights: Path, where: str) -> None:
            assert card.name == "moge"

        def depth(self, picture: np.ndarray, focal_px: float | None) -> np.ndarray:
            assert picture.shape == (*camera.hw, 3)
            assert focal_px == pytest.approx(camera.focal_px[0])
            return bend(next(frames))

    monkeypatch.setattr(moge, "ADAPTER", Planted)
    half = []
    for own in rig():
        pose = own.camera_from_world.copy()
        pose[:3, 3] *= apart
        half.append(replace(own, camera_from_world=pose))
    write_model(tmp_path / "network", half)
    write_model(tmp_path / "cameras", rig())
    first_m = moments(camera)[0]
    write_depth(tmp_path / "first.exr", 0.5 * first_m, np.ones(camera.hw))
    write_lossless(tmp_path / "seen.mkv", [np.zeros((*camera.hw, 3), np.uint8)] * FRAMES, 24.0)
    write_detections(tmp_path / f"{camera.name}.npz", seen_by(camera))
    lift.run(
        Settings(),
        camera.name,
        tmp_path / "cameras/images.txt",
        tmp_path / "seen.mkv",
        tmp_path / f"{camera.name}.npz",
        tmp_path / "first.exr",
        tmp_path / "network/images.txt",
        "moge",
        tmp_path,
        "cpu",
        tmp_path / f"lifted/{camera.name}.npz",
    )
    return read_detections(tmp_path / f"lifted/{camera.name}.npz")


def test_two_cameras_find_the_same_people_by_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = rig()[:2]
    found = [run_lifting(tmp_path, monkeypatch, camera) for camera in cameras]
    limits = AssociationLimits(method="star", affinity="position", position="scene")
    now = [one.only(one.frame == FRAMES - 1) for one in found]
    pairs = track_pairs(now, stable_detections(now), cameras, limits)
    similar = pairs.affinity[np.ix_(pairs.graph.view == 0, pairs.graph.view == 1)]
    assert (np.diag(similar) > 0.7).all()
    # Beyond 0.3 m two pelvises are two people.
    assert similar[0, 1] == similar[1, 0] == 0
    nobody = [replace(one, pelvis=None) for one in found]
    compared = TrackComparison(nobody, cameras, FRAMES, 30.0, limits, Limits())
    with pytest.raises(UserError, match="depth is unknown at every pelvis; set it to rays"):
        group_tracks(compared)
    assert replace(compared, limits=replace(limits, position="rays")).pairs.nodes


@pytest.mark.parametrize(
    ("bend", "apart", "cause"),
    [
        (lambda depth: np.random.default_rng(2).uniform(0.5, 50, depth.shape), 0.5, "differ by"),
        (np.zeros_like, 0.5, "the unit of .* is unknown"),
        (np.asarray, 0.0, "the scale of its depth is unknown"),
    ],
    ids=("another view", "no depth", "cameras in one place"),
)
def test_a_depth_that_gives_no_metre_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    bend: Callable[[np.ndarray], np.ndarray],
    apart: float,
    cause: str,
) -> None:
    """Its remedy, ``position: rays``, needs no depth and separates the same people."""
    cameras = rig()[:2]
    with pytest.raises(UserError, match=cause + r".*set people\.association\.position to rays"):
        run_lifting(tmp_path, monkeypatch, cameras[0], bend, apart)
    people = [walk(place - [0, 0, 1], np.array([0.02, 0.01, 0]), FRAMES) for place in PLACES]
    seen = detect(cameras, people, 0.3, np.random.default_rng(0))
    limits = AssociationLimits(method="star", affinity="position", position="rays")
    pairs = track_pairs(seen, stable_detections(seen), cameras, limits)
    similar = pairs.affinity[np.ix_(pairs.graph.view == 0, pairs.graph.view == 1)]
    assert similar.max(axis=1).min() > 0.5
    assert sorted(similar.argmax(axis=1)) == [0, 1]
