# SPDX-License-Identifier: Apache-2.0
"""What tests of masks and their neighbours share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.body.model import BodyModel, upright_global_orientation
from studiorecon.configuration.settings import load
from studiorecon.images.silhouette import front_person
from studiorecon.masks import labelling
from studiorecon.masks import segment as step
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Person

from tests.made.fitted import fitted_person

WH = (200, 160)


SHIRTS = ((200, 60, 50), (60, 80, 190))


def watching_camera() -> Camera:
    """At (0, -4, 1.2), looking along +y."""
    camera_from_world = np.array([[1.0, 0, 0, 0], [0, 0, -1, 1.2], [0, 1, 0, 4], [0, 0, 0, 1]])
    return Camera("a", WH, np.array([[190.0, 0, 100], [0, 190, 80], [0, 0, 1]]), camera_from_world)


def standing(name: str, identity: str, places_m: np.ndarray) -> Person:
    poses = np.zeros((len(places_m), 72))
    poses[:, :3] = upright_global_orientation(-np.pi / 2)
    poses[:, 16 * 3 + 2], poses[:, 17 * 3 + 2] = -1.2, 1.2
    trans = np.concatenate([places_m, np.full((len(places_m), 1), 0.95)], axis=1)
    return fitted_person(name, identity, 30.0, len(poses), poses=poses, trans=trans, sigma=np.ones((len(poses), 24)))


@dataclass(frozen=True)
class Scene:
    """Two people walk past each other in front of a patterned wall."""

    camera: Camera
    body: BodyModel
    people: list[Person]
    plate: np.ndarray
    frames: np.ndarray
    truth: np.ndarray


@pytest.fixture(scope="module")
def scene(root: Path) -> Scene:
    body = BodyModel.load(root / "resources/body.npz")
    camera = watching_camera()
    along = np.linspace(-1, 1, 5)
    people = [
        standing("p0", body.identity, np.stack([along, np.full(5, 0.8)], axis=1)),
        standing("p1", body.identity, np.stack([-along * 0.8, np.full(5, -0.2)], axis=1)),
    ]
    rng = np.random.default_rng(0)
    plate = cv2.resize(rng.integers(70, 200, (10, 12, 3), np.uint8), WH, interpolation=cv2.INTER_CUBIC)
    truth = np.stack([front_person(labelling.body_depths(people, body, camera, t)) for t in range(5)])
    frames = np.repeat(plate[None], 5, axis=0).astype(np.float64)
    for k, shirt in enumerate(SHIRTS):
        frames[truth == k + 1] = shirt
    frames += rng.normal(0, 1.5, frames.shape)
    return Scene(camera, body, people, plate, np.clip(np.rint(frames), 0, 255).astype(np.uint8), truth)


@pytest.fixture(scope="module")
def settings(default_settings) -> step.Settings:
    return load(step.Settings, default_settings("masks"), "masks")


def segmented(scene: Scene, settings: step.Settings, **changes) -> np.ndarray:
    given = {
        "frames": scene.frames,
        "plate": scene.plate,
        "measured": np.ones(WH[::-1], bool),
        "people": scene.people,
    } | changes
    plate_rgb = given["plate"].astype(np.float32) / 255
    bodies = labelling.Bodies(given["people"], scene.body, scene.camera, len(given["frames"]))
    return np.stack(list(labelling.segment(given["frames"], plate_rgb, given["measured"], bodies, settings)))
