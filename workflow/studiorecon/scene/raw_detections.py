# SPDX-License-Identifier: Apache-2.0
"""The detector's result on the footage of one camera: ``detect/found/<camera>.npz``, before any calibration."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.files import write_npz
from studiorecon.scene.schema import CONFIDENT, OptionalField, metres, real, record, text, whole
from studiorecon.scene.step_files import read

if TYPE_CHECKING:
    from jaxtyping import Integer, Num


_FOUND = {
    "camera": text(),
    "layout": text(),
    "frame": whole("D", low=0),
    "keypoints": real("D K 3", gaps=True, such=CONFIDENT),
    "presence": real("D", low=0, high=1),
    "points_m": metres("D K 3", gaps=True),
    "mask": OptionalField(whole("D M M", low=0, high=255)),
    "mask_from_picture": real("D 2 3"),
    "looked": whole("R 2", low=0),
    "note": text(),
    "turns": whole(low=0, high=3),
}
_PER_DETECTION = ("frame", "keypoints", "presence", "points_m", "mask", "mask_from_picture")


@dataclass(frozen=True)
class RawDetections:
    """People in the pictures of one camera; D of them over all pictures, sorted by frame.

    Attributes:
        layout: name of the keypoint layout (``keypoints/layouts.py``).
        frame: number of the picture in the footage.
        keypoints: x, y in pixels of the footage (centres at +0.5), confidence in [0, 1]; 0 = missing.
        presence: the network's confidence that there is a person.
        points_m: its estimate in metres relative to the middle of the hips, camera's axes; NaN = none.
        mask: uint8, 255 = certainly this person; M may be 0.
        mask_from_picture: affine map of footage pixels to those of the mask, centres at +0.5 on both sides.
        looked: (first, count) of every stretch of pictures that was searched.
        note: the detector and its input, for people to read.
        turns: counter-clockwise quarter turns with which people are upright in the pictures.
    """

    camera: str
    layout: str
    frame: Integer[np.ndarray, " D"]
    keypoints: Num[np.ndarray, "D K 3"]
    presence: Num[np.ndarray, " D"]
    points_m: Num[np.ndarray, "D K 3"]
    mask: Integer[np.ndarray, "D M M"]
    mask_from_picture: Num[np.ndarray, "D 2 3"]
    looked: Sequence[tuple[int, int]]
    note: str
    turns: int = 0

    @staticmethod
    def of(
        camera: str, layout: str, points: int, rows: Sequence[tuple], looked: Sequence[tuple[int, int]], note: str
    ) -> RawDetections:
        """The detections from rows (frame, keypoints, presence, points_m, mask, mask_from_picture), ordered by
        frame."""
        frame, keypoints, presence, points_m, mask, affine = zip(*rows) if rows else ([],) * 6
        edge = len(mask[0]) if rows else 0
        return RawDetections(
            camera,
            layout,
            np.array(frame, dtype=np.int64),
            np.array(keypoints, dtype=np.float64).reshape(len(rows), points, 3),
            np.array(presence, dtype=np.float64),
            np.array(points_m, dtype=np.float64).reshape(len(rows), points, 3),
            np.array(mask, dtype=np.uint8).reshape(len(rows), edge, edge),
            np.array(affine, dtype=np.float64).reshape(len(rows), 2, 3),
            looked,
            note,
        )

    def grown(self, rows: Sequence[tuple]) -> RawDetections:
        """The detections with more rows (as for ``of``) appended, of any frame; existing rows keep their numbers."""
        if not rows:
            return self
        more = RawDetections.of(self.camera, self.layout, self.keypoints.shape[1], rows, self.looked, self.note)
        edge = more.mask.shape[1]
        own = replace(self, mask=self.mask.reshape(-1, edge, edge))
        arrays: dict[str, Any] = {n: np.concatenate([getattr(own, n), getattr(more, n)]) for n in _PER_DETECTION}
        return replace(own, **arrays)

    def completed(self, rows: Sequence[tuple], looked: Sequence[tuple[int, int]]) -> RawDetections:
        """The detections with rows (as for ``of``) of more stretches, ordered by frame; ``looked`` are then all."""
        whole = self.grown(rows)
        order = np.argsort(whole.frame, kind="stable")
        arrays: dict[str, Any] = {n: getattr(whole, n)[order] for n in _PER_DETECTION}
        return replace(whole, looked=sorted(looked), **arrays)


def write_raw_detections(path: Path, found: RawDetections) -> None:
    arrays = {name: getattr(found, name) for name in RawDetections.__dataclass_fields__}
    write_npz(path, arrays | {"looked": np.array(found.looked, dtype=np.int64).reshape(-1, 2)})


def is_detector_file(path: Path) -> bool:
    """Whether a file is the detector's, and not recorded keypoints."""
    if path.suffix != ".npz" or not path.is_file():
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return "mask_from_picture.npy" in archive.namelist()
    except (zipfile.BadZipFile, OSError):
        return False


def read_raw_detections(path: Path, masks: bool = False) -> RawDetections:
    """The detector's file, without masks unless ``masks``; raises UserError when the file does not exist."""

    def made(data: dict[str, Any]) -> RawDetections:
        looked = [(int(first), int(count)) for first, count in data["looked"]]
        empty = {} if masks else {"mask": np.zeros((len(data["frame"]), 0, 0), np.uint8)}
        return record(RawDetections, {**data, **empty, "looked": looked})

    return read(path, _FOUND, made, but=() if masks else ("mask",))


def unseen(looked: Sequence[tuple[int, int]], first: int, count: int) -> list[tuple[int, int]]:
    """(first, count) of the parts of ``count`` frames from ``first`` on that are in none of ``looked``."""
    found, begin, stop = [], first, first + count
    for one, length in [*sorted(looked), (stop, 0)]:
        if begin < min(one, stop):
            found.append((begin, min(one, stop) - begin))
        begin = max(begin, one + length)
    return found
