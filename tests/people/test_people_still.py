# SPDX-License-Identifier: Apache-2.0
"""Who stands or sits still changes no picture, and is a person all the same: at ten pictures a second and at 120."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.footage.video import write_lossless
from studiorecon.images.plate import write_plate
from studiorecon.people import associate
from studiorecon.people.association.acceptance import identities_from_keypoints
from studiorecon.people.association.picture_terms import view_nats
from studiorecon.people.pictures.change import steps_m
from studiorecon.people.pictures.coverage import CameraEvidence
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections, write_raw_detections

from tests.defaults import loaded
from tests.made.cameras import STANDING, detect, owner, ring

WH, SECONDS, MASK_PX = (320, 176), 3.0, 64
# Of somebody on a chair: hips and knees as high, feet before it.
SITTING = (
    STANDING
    - [0, 0, 0.47] * np.repeat([1, 1, 1, 1, 0, 0], 2)[:, None]
    + [0.42, 0, 0] * np.repeat([0, 0, 0, 0, 1, 1], 2)[:, None]
)
WALKERS, STANDS, SITS = (0, 1), 2, 3


def walking(fps: float, start: list[float], velocity_m_s: list[float]) -> np.ndarray:
    """(T, 12, 3) somebody whose arms and legs swing once a second."""
    times_s = np.arange(round(SECONDS * fps)) / fps
    swing = 0.3 * np.sin(2 * np.pi * times_s)[:, None] * np.repeat([0, 0.5, 1, 0, 0.5, 1], 2) * np.tile([1, -1], 6)
    moved = np.stack([swing, 0 * swing, 0 * swing], axis=-1) + times_s[:, None, None] * np.array(velocity_m_s)
    return STANDING + np.array(start) + moved


def wandering(fps: float, rest: np.ndarray, place: list[float], rng: np.random.Generator, drift_s: float) -> np.ndarray:
    """(T, 12, 3) where the landmarks of somebody who keeps still are taken to be: some centimetres off, and off
    otherwise after ``drift_s``."""
    count = round(SECONDS * fps)
    kept = np.exp(-1 / (fps * drift_s))
    off = np.zeros((count, 12, 3))
    off[0] = rng.normal(0, 0.04, (12, 3))
    for t in range(1, count):
        off[t] = kept * off[t - 1] + np.sqrt(1 - kept**2) * rng.normal(0, 0.04, (12, 3))
    return rest + np.array(place) + off


@dataclass(frozen=True)
class Room:
    """Four cameras that see two people walk, one stand and one sit; ``true``: where they are, ``found``: what is taken
    for them."""

    fps: float
    cameras: list[Camera]
    true: list[np.ndarray]
    found: list[Detections]
    videos: list[Path]
    folder: Path

    def people(self, witnesses: list[CameraEvidence | None]) -> tuple[set[int], str]:
        """Who of them is a person, and the reasons against the others."""
        options = loaded(associate.Settings)
        limits = options.association, options.triangulation
        frames = len(self.true[0])
        table, _, left = identities_from_keypoints(
            *limits, self.cameras, self.found, self.videos, frames, self.fps, witnesses
        )
        owners = owner(self.cameras, self.found, self.true)
        named = {owners[v, t] for (v, t) in owners if table[self.cameras[v].name, t].person}
        return named, "; ".join(one.reason for one in left)

    def witness(self, view: int, masked: bool, plate: Path | None = None, on: float = 1.0) -> CameraEvidence:
        """What a camera has beside its film: masks over everybody it sees, ``on`` (1) or beside (0) them, or a
        plate."""
        camera = self.cameras[view]
        lens = Lens(camera.name, WH, camera.intrinsics, "opencv", np.zeros(5), camera.camera_from_world, np.eye(2, 3))
        about = Footage(
            camera.name, False, WH, camera.intrinsics.tolist(), self.fps, len(self.true[0]), 0, "", "", WH, 0, 0.0, []
        )
        file = self.folder / f"{camera.name}.found.npz" if masked else None
        if file:
            rows, owners = [], owner(self.cameras, self.found, self.true)
            for frame, track, keypoints in zip(
                *(getattr(self.found[view], n) for n in ("frame", "track", "keypoints"))
            ):
                body = camera.project(self.true[owners[view, int(track)]][frame])[0]
                middle, side = np.median(body, axis=0) + (1 - on) * 500, 2.5 * np.ptp(body, axis=0).max()
                affine = np.array([[MASK_PX / side, 0, 0], [0, MASK_PX / side, 0]])
                affine[:, 2] = MASK_PX / 2 - affine[:, :2] @ middle
                mask = np.zeros((MASK_PX, MASK_PX), np.uint8)
                hull = cv2.convexHull(((body + (1 - on) * 500) @ affine[:, :2].T + affine[:, 2]).astype(np.float32))
                cv2.fillConvexPoly(mask, np.round(hull).astype(np.int32), 255)
                mask = cv2.dilate(mask, np.ones((5, 5), np.uint8))
                rows.append((int(frame), keypoints, 0.97, np.zeros((17, 3)), mask, affine))
            write_raw_detections(
                file, RawDetections.of(camera.name, "coco17", 17, rows, [(0, len(self.true[0]))], "made")
            )
        return CameraEvidence(lens, about, file, plate)


@pytest.fixture(params=[10, 120])
def fps(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture
def room(fps: float, drift_s: float, tmp_path: Path) -> Room:
    rng = np.random.default_rng(0)
    cameras = [c.resized(WH) for c in ring()]
    still = [(STANDING, [0.1, -1.2, 0]), (SITTING, [-0.9, 0.9, 0])]
    true = [walking(fps, [-0.6, -0.5, 0], [0.4, 0, 0]), walking(fps, [0.7, 0.6, 0], [0, -0.4, 0])]
    taken = [*true, *(wandering(fps, rest, place, rng, drift_s) for rest, place in still)]
    true += [np.repeat((rest + np.array(place))[None], len(true[0]), axis=0) for rest, place in still]
    found = [replace(d, row=np.arange(len(d.frame))) for d in detect(cameras, taken, 0.3, rng)]
    videos, colours = [], ((230, 220, 60), (230, 60, 220), (60, 140, 160), (150, 90, 40))
    for camera in cameras:
        empty = np.full((WH[1], WH[0], 3), 70, np.uint8)
        write_plate(tmp_path / f"{camera.name}.png", empty, np.ones(WH[::-1], bool))

        def pictures(camera: Camera = camera, empty: np.ndarray = empty):
            for t in range(len(true[0])):
                picture = empty.copy()
                for points_m, colour in zip(true, colours):
                    for x, y in camera.project(points_m[t])[0]:
                        cv2.circle(picture, (int(x), int(y)), 6, colour, -1)
                yield picture

        videos.append(tmp_path / f"{camera.name}.mkv")
        write_lossless(videos[-1], pictures(), fps)
    return Room(fps, cameras, true, found, videos, tmp_path)


@pytest.mark.parametrize("drift_s", [0.3])
def test_landmarks_that_tremble_over_somebody_still_are_a_person(room: Room) -> None:
    assert room.people([None] * 4)[0] == {*WALKERS, STANDS, SITS}


@pytest.mark.parametrize("drift_s", [2.0])
def test_whom_one_camera_s_network_covers_is_a_person_though_nothing_changes(room: Room) -> None:
    alone, _ = room.people([None] * 4)
    assert room.people([None, room.witness(1, masked=True), None, None])[0] == {*WALKERS, STANDS, SITS}
    beside, _ = room.people([room.witness(v, masked=True, on=0.0) for v in range(4)])
    assert beside <= alone, "masks beside them speak for nobody"


@pytest.mark.parametrize("drift_s", [2.0])
def test_a_clean_plate_that_one_camera_has_confirms_them_too(room: Room) -> None:
    plated = room.witness(0, masked=False, plate=room.folder / "c0.png")
    assert room.people([plated, None, None, None])[0] == {*WALKERS, STANDS, SITS}


def test_a_camera_that_shows_change_where_joints_move_speaks_for_a_person_and_one_limb_is_not_contradicted() -> None:
    def nats(changed: float, limb: float = 0.0, places: int = 10) -> float:
        counts = np.column_stack([np.full(12, changed * places), np.full(12, places)])
        counts[[2, 4], 0] = max(changed, limb) * places  # left elbow and wrist
        return view_nats(counts)

    assert view_nats(np.zeros((12, 2))) == 0
    assert nats(1.0) > 2
    assert nats(0.0) < -4
    assert -3 < nats(0.0, limb=1.0) < 0, "a table may hide the rest, or somebody else move there"
    assert nats(0.0, places=0) == 0


def test_how_far_a_joint_must_move_is_the_same_at_every_frame_rate() -> None:
    """An arm that swings once a second, and landmarks that drift and tremble: ten times as many pictures of it say no
    more of either."""
    found = {}
    for fps in (10.0, 30.0, 120.0):
        drifting = [wandering(fps, STANDING, [0, 0, 0], np.random.default_rng(seed), 0.3) for seed in range(8)]
        found[fps] = np.mean([steps_m(one, fps).mean() for one in drifting])
        swinging = steps_m(walking(fps, [0, 0, 0], [1.2, 0, 0]), fps)
        assert (swinging < 1.3 * 0.06).all(), "a swing is no wandering"
    assert found[120.0] == pytest.approx(found[10.0], rel=0.25)
    assert found[30.0] == pytest.approx(found[10.0], rel=0.25)
