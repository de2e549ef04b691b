# SPDX-License-Identifier: Apache-2.0
"""Reads masks that the user provides: a video or a folder of pictures, 0 = background, any other value = a person."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.camera_files.calibration import find_lens
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_image
from studiorecon.footage.video import read_frames
from studiorecon.geometry.lens import video_from_working
from studiorecon.images.channels import channel_max
from studiorecon.images.palette import UNASSIGNED
from studiorecon.images.regions import signed_distance_px
from studiorecon.images.silhouette import front_person
from studiorecon.masks.tracks import MIN_SHARE, count_overlaps
from studiorecon.progress import warn
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.numbered_files import missing_numbers_text, pictures_in

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

MAX_LABELS = 32
"""Masks of more grey levels or colours than this hold no exact labels, and are thresholded at ``_HALF``."""
_HALF = 127


@dataclass(frozen=True)
class UserMasks:
    """Masks that the user provides, frame by frame in working pixels, read again at every pass.

    Attributes:
        chosen: indices of the frames in use among its pictures, ascending.
        columns, rows: pixel of the picture at each working pixel.
        exact: its values are labels; else greys to threshold.
    """

    path: Path
    chosen: Sequence[int]
    columns: Num[np.ndarray, "H W"]
    rows: Num[np.ndarray, "H W"]
    exact: bool

    def __iter__(self) -> Iterator[Integer[np.ndarray, "H W"]]:
        """Yields the labels of every frame."""
        wanted = iter(self.chosen)
        at = next(wanted, None)
        for number, picture in enumerate(mask_pictures(self.path)):
            while at == number:
                label = picture[self.rows, self.columns]
                yield label if self.exact else (label > _HALF).astype(np.uint8)
                at = next(wanted, None)


def read_given(path: Path, footage: Path, calibration: Path, frames: int) -> UserMasks:
    """The masks of a camera, sampled at the nearest source pixel.

    They must have the size of the source frames, or its shape, and cover the frames in use: either exactly those, or
    the whole source. Raises UserError naming the path and the remedy.
    """
    about = read_footage(footage)
    lens = find_lens(calibration, about.camera)
    columns = rows = np.zeros(0, int)
    occur: list[np.ndarray] = []
    for picture in mask_pictures(path):
        if not occur:
            columns, rows = _source_pixels(about, lens, (picture.shape[1], picture.shape[0]), path)
        occur.append(np.bincount(picture[rows, columns].ravel(), minlength=256) > 0)
    count = len(occur)
    chosen = list(about.used) if count > max(about.used) and count != frames else list(range(count))
    if len(chosen) != frames:
        raise UserError(
            f"masks {path} hold {count} pictures, but {frames} frames of camera "
            f"{about.camera} are in use; bring one mask for each"
        )
    values = np.any([occur[k] for k in chosen], axis=0)
    # Lossy codecs turn 0 into 1 and smear borders: a video with more grey levels than this holds no exact labels and is
    # thresholded.
    return UserMasks(path, chosen, columns, rows, int(values.sum()) <= MAX_LABELS)


def label_given_masks(
    labels: Iterable[Integer[np.ndarray, "H W"]],
    depths_m: Iterable[Float[np.ndarray, "K H W"]],
    people: int,
    gate_m: float,
    camera: Camera,
) -> tuple[Iterator[Integer[np.ndarray, "H W"]], str]:
    """Uint8 masks with this project's labels, frame by frame, and a sentence on how they were matched.

    ``labels`` and ``depths_m`` are read twice. A single value only marks people: each pixel goes to the fitted body in
    front or nearest, within ``gate_m``. Several values are identities: each goes to the person it covers most, one to
    one.
    """
    from scipy.optimize import linear_sum_assignment  # half a second to import, only needed for given masks

    sizes = sum((np.bincount(label.ravel(), minlength=256) for label in labels), np.zeros(256, np.int64))
    values = [int(v) for v in np.flatnonzero(sizes) if v > 0]
    if not values or not people:
        unknown = (np.where(label > 0, np.uint8(UNASSIGNED), np.uint8(0)) for label in labels)
        return unknown, "they show none of the fitted people"
    overlap = count_overlaps(labels, depths_m, people)[values]
    if (on_people := overlap[:, 1:].sum() / overlap.sum()) < MIN_SHARE:
        warn(
            f"only {on_people:.0%} of the pixels in the masks of camera {camera.name} belong to a person of the "
            "scene: check that they are of this camera and these frames, upright, with 0 for the background"
        )
    if len(values) == 1:
        by_body = (_by_body(label > 0, depth, gate_m, camera) for label, depth in zip(labels, depths_m, strict=True))
        return by_body, "bodies decide the identities"
    overlap = overlap[:, 1:].astype(np.float64)
    table = np.zeros(256, np.uint8)
    table[values] = UNASSIGNED
    matched = []
    for row, k in zip(*linear_sum_assignment(-overlap)):
        if overlap[row, k] >= MIN_SHARE * sizes[values[row]]:
            table[values[row]] = k + 1
            matched.append(f"{values[row]} = p{k}")
    described = "values were matched by overlap with the bodies: " + (", ".join(matched) or "none")
    return (table[label] for label in labels), described


def _by_body(region: np.ndarray, depths_m: np.ndarray, gate_m: float, camera: Camera) -> np.ndarray:
    distance_m = np.full(depths_m.shape, -np.inf, np.float32)
    for k, depth_m in enumerate(depths_m):
        if (depth_m > 0).any():
            distance_m[k] = signed_distance_px(depth_m > 0) * (
                float(np.median(depth_m[depth_m > 0])) / camera.focal_px[0]
            )
    front = front_person(depths_m)
    owner = np.where(front > 0, front, distance_m.argmax(axis=0) + 1)
    owner = np.where(distance_m.max(axis=0) < -gate_m, UNASSIGNED, owner)
    return np.where(region, owner, 0).astype(np.uint8)


class ColourLabels:
    """Labels of masks that mark people by colours, the same in all pictures of a folder: grey ones keep their values,
    others count down from 254.

    The colours of photos are none: cut-outs have their alpha, others their greatest channel, to be thresholded.
    """

    def __init__(self) -> None:
        self._of_code = np.zeros(0, np.uint8)
        self._free = 254

    def of(self, picture: Integer[np.ndarray, "H W ..."]) -> Integer[np.ndarray, "H W"]:
        """(H, W) uint8 of a picture with one, three (BGR) or four channels; what alpha hides is background."""
        if picture.ndim == 2:
            return picture
        colours, alpha = picture[..., :3], picture[..., 3:].max(-1, initial=0 if picture.shape[-1] == 4 else 255)
        most = channel_max(colours)
        if (alpha < 255).any() and len(np.unique(most)) > MAX_LABELS:
            return alpha
        grey = np.array_equal(colours, np.broadcast_to(most[..., None], colours.shape))
        return np.where(alpha > _HALF, most if grey else self._coloured(colours, most), 0)

    def _coloured(self, colours: np.ndarray, most: np.ndarray) -> np.ndarray:
        if not len(self._of_code):
            self._of_code = np.zeros(1 << 24, np.uint8)
            self._of_code[0x010101 * np.arange(256)] = np.arange(256)
        code = colours.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16], np.uint32)
        new = np.unique(code[(self._of_code[code] == 0) & (code > 0)])
        if 254 - self._free + len(new) > MAX_LABELS:
            return most
        self._of_code[new] = self._free - np.arange(len(new))
        self._free -= len(new)
        return self._of_code[code]


def mask_pictures(path: Path) -> Iterable[Integer[np.ndarray, "H W ..."]]:
    if path.is_dir():
        files = pictures_in(path)
        if missing := missing_numbers_text(files):
            raise UserError(f"masks {path} lack the numbers {missing}; bring one mask for each frame")
        wh: tuple[int, ...] | None = None
        labels = ColourLabels()
        for file in files:
            picture = read_image(file, cv2.IMREAD_UNCHANGED)
            if picture.dtype != np.uint8:
                raise UserError(f"{file} holds {picture.dtype} numbers; save masks with 8 bits")
            if wh not in (None, picture.shape[1::-1]):
                raise UserError(
                    f"{file} is {picture.shape[1]}×{picture.shape[0]}, but the first mask of its folder is "
                    f"{wh[0]}×{wh[1]}; bring masks of one size"
                )
            wh = picture.shape[1::-1]
            yield labels.of(picture)
        return
    for frame in read_frames(path):
        yield frame if frame.ndim == 2 else channel_max(frame)


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
