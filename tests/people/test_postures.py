# SPDX-License-Identifier: Apache-2.0
"""Where limbs point by the detector's guess: the same from every camera, another for another person, sides apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.association.affinity import AssociationLimits, track_pairs
from studiorecon.people.association.postures import limb_differences_rad, limb_directions
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.made.scene import ring

LAYOUT = LAYOUTS["blazepose33"]
CAMERAS = ring([0, 90, 200], "cam", wh=(640, 480))


def bodies(root: Path, count: int, seed: int = 0) -> np.ndarray:
    """(P, 33, 3) keypoints in the world of upright people with bent limbs who stand near one another."""
    body, rng = BodyModel.load(root / "resources/body.npz"), np.random.default_rng(seed)
    known = [name if name in body.keypoint_names else "nose" for name in LAYOUT.keypoints]
    out = []
    for k in range(count):
        pose = rng.normal(0, 0.5, (1, 24, 3))
        pose[0, 0] = rotations.log(rotations.exp([0, 0, rng.uniform(-3, 3)]) @ rotations.exp([np.pi / 2, 0, 0]))
        out.append(body.keypoints(known, pose.reshape(1, 72), np.zeros(10), np.array([[0.25 * k, 0.0, 0.95]]))[0])
    return np.array(out)


def guessed(points: np.ndarray, camera: Camera) -> Detections:
    """What a network says of one picture that it sees through crops: as if each person stood straight ahead."""
    pixels = camera.project(points)[0]
    keypoints = np.concatenate([pixels, np.ones((*pixels.shape[:2], 1))], axis=-1)
    in_camera = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    guesses = []
    for person in in_camera:
        towards = person.mean(0) / np.linalg.norm(person.mean(0))
        axis = np.cross([0, 0, 1], towards)
        angle = np.arctan2(np.linalg.norm(axis), towards[2])
        ahead = rotations.exp(axis / max(np.linalg.norm(axis), 1e-12) * angle)
        guesses.append((person - person.mean(0)) @ ahead)
    number = np.arange(len(points))
    return Detections(camera.name, LAYOUT.name, np.zeros_like(number), number, keypoints, points_m=np.array(guesses))


def test_limbs_point_the_same_way_from_every_camera_and_another_for_another_person(root: Path) -> None:
    people = bodies(root, 4)
    seen = [limb_directions(guessed(people, camera), camera) for camera in CAMERAS]
    assert seen[0].shape == (4, 12, 3)
    for other in seen[1:]:
        apart = limb_differences_rad(seen[0][:, None], other[None])
        assert np.diag(apart).max() < 0.06, "the middle of what is seen is not quite the body's"
        assert apart[~np.eye(4, dtype=bool)].min() > 0.4


def test_left_differs_from_right(root: Path) -> None:
    person = guessed(bodies(root, 1), CAMERAS[0])
    order = np.arange(len(LAYOUT.keypoints))
    for left, right in LAYOUT.pairs:
        order[[left, right]] = order[[right, left]]
    mirrored = replace(person, points_m=person.points_m[:, order])
    apart = limb_differences_rad(limb_directions(person, CAMERAS[0]), limb_directions(mirrored, CAMERAS[0]))
    assert apart[0] > 0.5


def test_without_a_guess_nothing_is_known(root: Path) -> None:
    found = guessed(bodies(root, 2), CAMERAS[0])
    assert np.isnan(limb_directions(replace(found, points_m=None), CAMERAS[0])).all()
    other = replace(found, layout="smpl24", keypoints=found.keypoints[:, :24], points_m=found.points_m[:, :24])
    assert np.isnan(limb_directions(other, CAMERAS[0])).all()


def test_who_stands_where_rays_cannot_tell_differs_by_posture(root: Path) -> None:
    people = bodies(root, 3, seed=4)
    found = [guessed(people, camera) for camera in CAMERAS]
    pairs = track_pairs(found, found, CAMERAS, AssociationLimits())
    other_view = pairs.graph.view[:, None] != pairs.graph.view
    same = (pairs.graph.track[:, None] == pairs.graph.track) & other_view
    assert 4 * pairs.pose_rad[same].max() < pairs.pose_rad[other_view & ~same].min()
    blind = [replace(one, points_m=None) for one in found]
    assert np.isnan(track_pairs(blind, blind, CAMERAS, AssociationLimits()).pose_rad).all()
