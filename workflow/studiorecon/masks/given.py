# SPDX-License-Identifier: Apache-2.0
"""Masks that the user brings: a video or a folder of pictures, 0 = background, any other value = somebody."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from studiorecon.camera_files.calibration import lens_of
from studiorecon.errors import UserError
from studiorecon.footage.stills import decoded
from studiorecon.footage.video import read_frames
from studiorecon.geometry.lens import video_from_working
from studiorecon.images.regions import signed_distance_px
from studiorecon.images.silhouette import front_person
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.numbered import gaps_named, pictures_in

_UNASSIGNED = 255
# Lossy codecs turn 0 into 1 and smear borders: a video's greys are read as yes or no unless they are exact labels.
_MOST_LABELS = 32
# A label belongs to the person on whom at least this share of its pixels lies.
_LEAST_SHARE = 0.3


def read_given(path: Path, footage: Path, calibration: Path, frames: int) -> np.ndarray:
    """(T, H, W) uint8 labels in working pixels, sampled at the nearest source pixel.

    The masks must have the size of the source frames (or their shape: then they are scaled), and cover the frames in
    use: either exactly those, or the whole source. Raises UserError naming the path and the remedy.
    """
    about = read_footage(footage)
    lens = lens_of(calibration, about.camera)
    pictures = list(pictures_of(path))
    if len(pictures) > max(about.used) and len(pictures) != frames:
        pictures = [pictures[k] for k in about.used]
    if len(pictures) != frames:
        raise UserError(
            f"masks {path} hold {len(pictures)} pictures, but {frames} frames of camera "
            f"{about.camera} are in use; bring one mask for each"
        )
    columns, rows = _source_pixels(about, lens, (pictures[0].shape[1], pictures[0].shape[0]), path)
    labels = np.stack([picture[rows, columns] for picture in pictures])
    values = np.unique(labels)
    if len(values) > _MOST_LABELS:
        return np.where(labels > 127, np.uint8(1), np.uint8(0))
    return labels


def identified(
    labels: np.ndarray, depths_m: Iterable[np.ndarray], people: int, gate_m: float, camera: Camera
) -> tuple[np.ndarray, str]:
    """(T, H, W) uint8 masks with this project's labels, and a sentence how they were matched.

    ``labels`` with one value say where somebody is: each pixel goes to the fitted body in front or nearest, within
    ``gate_m``. Several values are identities: each goes to the person it lies on most, over all frames (one to one).
    """
    from scipy.optimize import linear_sum_assignment  # half a second to import, for the few who bring masks

    values = [int(v) for v in np.unique(labels) if v > 0]
    depths = list(depths_m)
    if not values or not people:
        return np.where(labels > 0, np.uint8(_UNASSIGNED), np.uint8(0)), "they show nobody who was fitted"
    if len(values) == 1:
        return np.stack(
            [_by_body(label > 0, depth, gate_m, camera) for label, depth in zip(labels, depths)]
        ), "bodies tell who is who"
    fronts = np.stack([front_person(depth) for depth in depths])
    overlap = np.array(
        [[np.sum((labels == v) & (fronts == k + 1)) for k in range(people)] for v in values], dtype=np.float64
    )
    sizes = np.array([np.sum(labels == v) for v in values])
    table = np.zeros(256, np.uint8)
    table[values] = _UNASSIGNED
    matched = []
    for row, k in zip(*linear_sum_assignment(-overlap)):
        if overlap[row, k] >= _LEAST_SHARE * sizes[row]:
            table[values[row]] = k + 1
            matched.append(f"{values[row]} = p{k}")
    return table[labels], "values were matched by overlap with the bodies: " + (", ".join(matched) or "none")


def _by_body(region: np.ndarray, depths_m: np.ndarray, gate_m: float, camera: Camera) -> np.ndarray:
    distance_m = np.full(depths_m.shape, -np.inf, np.float32)
    for k, depth_m in enumerate(depths_m):
        if (depth_m > 0).any():
            distance_m[k] = signed_distance_px(depth_m > 0) * (
                float(np.median(depth_m[depth_m > 0])) / camera.focal_px[0]
            )
    front = front_person(depths_m)
    owner = np.where(front > 0, front, distance_m.argmax(axis=0) + 1)
    owner = np.where(distance_m.max(axis=0) < -gate_m, _UNASSIGNED, owner)
    return np.where(region, owner, 0).astype(np.uint8)


def pictures_of(path: Path) -> Iterable[np.ndarray]:
    if path.is_dir():
        files = pictures_in(path)
        if missing := gaps_named(files):
            raise UserError(f"masks {path} lack the numbers {missing}; bring one mask for each frame")
        wh: tuple[int, ...] | None = None
        for file in files:
            picture = decoded(file, cv2.IMREAD_UNCHANGED)
            if picture.dtype != np.uint8:
                raise UserError(f"{file} holds {picture.dtype} numbers; save masks with 8 bits")
            if wh not in (None, picture.shape[1::-1]):
                raise UserError(
                    f"{file} is {picture.shape[1]}×{picture.shape[0]}, but the first mask of its folder is "
                    f"{wh[0]}×{wh[1]}; bring masks of one size"
                )
            wh = picture.shape[1::-1]
            yield picture if picture.ndim == 2 else picture[..., :3].max(axis=2)
        return
    for frame in read_frames(path):
        yield frame if frame.ndim == 2 else frame.max(axis=2)


def _source_pixels(about: Footage, lens: Lens, wh: tuple[int, int], path: Path) -> tuple[np.ndarray, np.ndarray]:
    scale = np.array(wh) / np.array(about.source_wh)
    if abs(scale[0] / scale[1] - 1) > 0.01:
        raise UserError(
            f"masks {path} are {wh[0]}×{wh[1]}, another shape than the footage of camera {about.camera} "
            f"({about.source_wh[0]}×{about.source_wh[1]}); bring masks of the footage's own pixels"
        )
    columns, rows = np.meshgrid(np.arange(about.wh[0]) + 0.5, np.arange(about.wh[1]) + 0.5)
    source = (
        video_from_working(np.stack([columns, rows], axis=-1), lens, about.source_wh, np.array(about.intrinsics))
        * scale
    )
    return tuple(np.clip(np.floor(source[..., i]).astype(int), 0, wh[i] - 1) for i in range(2))
