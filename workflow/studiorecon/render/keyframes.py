# SPDX-License-Identifier: Apache-2.0
"""``spline``: a smooth camera path through keyframes, each with its own lens and time (bullet time, slow motion)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy

from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.geometry.camera_path import look_at, scene_centre, with_pose
from studiorecon.render.look_at_targets import LookAtTargets, Target
from studiorecon.render.moves import camera_named
from studiorecon.render.shots import usual_focal
from studiorecon.scene.camera import Camera
from studiorecon.scene.path import PathStep


@dataclass(frozen=True)
class Spline:
    """Settings of a ``spline`` shot.

    Attributes:
        keys: keyframes (``CameraKey`` or ``FreeKey``) in the order of their pictures, at least two; none = from
            training camera to training camera.
    """

    kind: Literal["spline"]
    keys: tuple[dict, ...] = ()


@dataclass(frozen=True)
class CameraKey:
    """A keyframe at the position and direction of a training camera.

    Attributes:
        picture: number of the picture in the film, from 0.
        camera: name of the training camera.
        frame: capture frame that is shown; equal frames at two keys stop time between them. None interpolates between
            the neighbouring keys, with the first and last frame at the ends.
        zoom: focal length as a multiple of the training cameras' mean.
    """

    picture: int
    camera: str
    frame: float | None = None
    zoom: float = 1.0


@dataclass(frozen=True)
class FreeKey:
    """A keyframe at a free position.

    Attributes:
        picture: number of the picture in the film, from 0.
        eye_m: world position of the camera, metres.
        target: the middle of the picture.
        frame: capture frame that is shown, as for ``CameraKey``.
        zoom: focal length as a multiple of the training cameras' mean.
    """

    picture: int
    eye_m: tuple[float, float, float]
    target: Target = "people"
    frame: float | None = None
    zoom: float = 1.0


def read_keys(values: Sequence[Any], name: str) -> list[CameraKey | FreeKey]:
    """The keyframes of shot ``name``; raises UserError for fewer than two, or pictures that do not increase from 0."""
    keys: list[CameraKey | FreeKey] = []
    for index, value in enumerate(values):
        where, load = f"render.shots.{name}.keys[{index}]", settings_module.load
        keys.append(load(CameraKey, value, where) if "camera" in value else load(FreeKey, value, where))
    pictures = [key.picture for key in keys]
    if len(keys) < 2 or pictures[0] != 0 or any(np.diff(pictures) <= 0):
        raise UserError(
            f"shot {name} needs at least two keys whose pictures start at 0 and increase; they are {pictures}"
        )
    return keys


def from_camera_to_camera(cameras: Sequence[Camera], name: str) -> list[CameraKey | FreeKey]:
    """Keys at the training cameras, by azimuth from the first one on, directed at the people.

    Raises UserError with fewer than two cameras.
    """
    if len(cameras) < 2:
        raise UserError(f"shot {name} goes from camera to camera and needs at least two of them; give it keys")
    offsets = np.array([camera.centre_m - scene_centre(cameras) for camera in cameras])
    azimuth = np.arctan2(offsets[:, 1], offsets[:, 0])
    order = np.argsort(np.mod(azimuth - azimuth[0], 2 * np.pi), kind="stable")
    eyes_m = [cameras[index].centre_m for index in order]
    # Pictures from one camera to the next in a film without keys.
    return [FreeKey(30 * place, (float(x), float(y), float(z))) for place, (x, y, z) in enumerate(eyes_m)]


def spline_steps(
    keys: Sequence[CameraKey | FreeKey],
    name: str,
    cameras: Sequence[Camera],
    subjects: LookAtTargets,
    wh: tuple[int, int],
) -> list[PathStep]:
    """One step per picture, from the first key's to the last key's.

    Positions follow an Akima curve, rotations a spline on SO(3). Time and the logarithm of the focal length follow
    monotone curves, so that time never runs backwards unless the keys do. If all keys name a target, the camera points
    at the targets (which may walk) between keys, too. Raises UserError for an unknown camera or person.
    """
    at = np.array([key.picture for key in keys], np.float64)
    pictures = np.arange(keys[-1].picture + 1, dtype=np.float64)
    times = np.clip(_times(keys, pictures, subjects.frames - 1), 0, subjects.frames - 1)
    zooms = np.exp(_monotone(at, [np.log(key.zoom) for key in keys], pictures))
    places = np.array([_eye(key, cameras, name) for key in keys])
    eyes = _curve(at, places, pictures)
    free = [key for key in keys if isinstance(key, FreeKey)]
    if len(free) == len(keys):
        targets = np.stack([subjects.at(key.target, times, name) for key in free])
        aims = _blend_targets(at, targets, pictures)
        turned = np.stack([look_at(eye, aim) for eye, aim in zip(eyes, aims)])
    else:
        rotations = scipy.spatial.transform.Rotation.from_matrix(
            np.stack([_rotation(key, cameras, subjects, name) for key in keys])
        )
        turned = scipy.spatial.transform.RotationSpline(at, rotations)(pictures).as_matrix()
    steps = []
    for zoom, eye, rotation, time in zip(zooms, eyes, turned, times):
        focal = zoom * usual_focal(cameras, wh[0])
        intrinsics = np.array([[focal, 0, wh[0] / 2], [0, focal, wh[1] / 2], [0, 0, 1.0]])
        steps.append(PathStep(with_pose(Camera(name, wh, intrinsics, np.eye(4)), rotation, eye), float(time), "00"))
    return steps


def _times(keys: Sequence[CameraKey | FreeKey], pictures: np.ndarray, last: int) -> np.ndarray:
    frames = [key.frame for key in keys]
    ends = {0: 0.0, len(keys) - 1: float(last)}
    known = [(key.picture, ends.get(k) if frame is None else frame) for k, (key, frame) in enumerate(zip(keys, frames))]
    at, shown = zip(*[(picture, frame) for picture, frame in known if frame is not None])
    return _monotone(np.array(at, np.float64), shown, pictures)


def _eye(key: CameraKey | FreeKey, cameras: Sequence[Camera], name: str) -> np.ndarray:
    return (
        camera_named(key.camera, cameras, name).centre_m
        if isinstance(key, CameraKey)
        else np.asarray(key.eye_m, np.float64)
    )


def _rotation(key: CameraKey | FreeKey, cameras: Sequence[Camera], subjects: LookAtTargets, name: str) -> np.ndarray:
    if isinstance(key, CameraKey):
        return camera_named(key.camera, cameras, name).world_from_camera[:3, :3]
    return look_at(np.asarray(key.eye_m, np.float64), subjects.at(key.target, np.array([key.frame]), name)[0])


def _blend_targets(at: np.ndarray, targets: np.ndarray, pictures: np.ndarray) -> np.ndarray:
    """(P, 3) targets over time: from each key's target to the next one's, with a gentle start and end."""
    last = np.clip(np.searchsorted(at, pictures, side="right") - 1, 0, len(at) - 2)
    share = (pictures - at[last]) / (at[last + 1] - at[last])
    share = (share**2 * (3 - 2 * share))[:, None]
    count = np.arange(len(pictures))
    return (1 - share) * targets[last, count] + share * targets[last + 1, count]


def _monotone(at: np.ndarray, values: Sequence[float], pictures: np.ndarray) -> np.ndarray:
    return np.asarray(scipy.interpolate.PchipInterpolator(at, np.asarray(values, np.float64))(pictures))


def _curve(at: np.ndarray, places: np.ndarray, pictures: np.ndarray) -> np.ndarray:
    if len(at) == 2:
        return places[0] + ((pictures - at[0]) / (at[1] - at[0]))[:, None] * (places[1] - places[0])
    # The modified form does not overshoot between two equal keys, where the camera rests.
    return np.asarray(scipy.interpolate.Akima1DInterpolator(at, places, method="makima")(pictures))
