# SPDX-License-Identifier: Apache-2.0
"""Keypoints of one camera that the user recorded with another detector: ``detect/recorded/<camera>.npz``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.files import write_npz
from studiorecon.scene.schema import flag, real, record, text, whole
from studiorecon.scene.step_files import expect, read

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num


_RECORDED = {
    "program": text(),
    "pictures": whole("P"),
    "frame": whole("D"),
    "keypoints": real("D K 3", gaps=True),
    "counted": flag(),
    "layout": text(),
    "refusal": text(),
}


@dataclass(frozen=True)
class RecordedKeypoints:
    """2D keypoints of all people in the pictures of one camera, as in their file; D people over P pictures.

    Attributes:
        program: the program whose format the file has.
        pictures: ascending numbers of all pictures in the file, with people or without.
        frame: ascending, number of the picture that shows each person, one of ``pictures``.
        keypoints: x, y, score; NaN where the file holds no number. A score of 0 or less = missing.
        counted: whether the format itself numbers the film's frames from 0, and not the files' names.
        layout: name of the keypoint layout (``keypoints/layouts.py``); "" = not known yet.
        refusal: the reason why they do not fit the film under any interpretation; "" where they can be used.
    """

    program: str
    pictures: Integer[np.ndarray, " P"]
    frame: Integer[np.ndarray, " D"]
    keypoints: Float[np.ndarray, "D K 3"]
    counted: bool = False
    layout: str = ""
    refusal: str = ""

    def only(self, which: Bool[np.ndarray, " D"]) -> RecordedKeypoints:
        """The people selected by ``which``; the pictures stay."""
        return replace(self, frame=self.frame[which], keypoints=self.keypoints[which])

    def renumbered(self, frame_of: Num[np.ndarray, " P"], frames: int) -> RecordedKeypoints:
        """The same with the film's frames as numbers: picture p shows frame ``frame_of[p]``; beyond ``frames`` left
        out.
        """
        inside = (frame_of >= 0) & (frame_of < frames)
        place = np.searchsorted(self.pictures, self.frame)
        shown = np.asarray(frame_of, dtype=np.int64)[place] if len(place) else self.frame
        kept = inside[place] if len(place) else np.zeros(0, bool)
        order = np.argsort(shown[kept], kind="stable")
        return replace(
            self,
            pictures=np.unique(np.asarray(frame_of, dtype=np.int64)[inside]),
            frame=shown[kept][order],
            keypoints=self.keypoints[kept][order],
            counted=True,
        )


def write_recorded(path: Path, recorded: RecordedKeypoints) -> None:
    write_npz(path, {name: getattr(recorded, name) for name in RecordedKeypoints.__dataclass_fields__})


def read_recorded(path: Path) -> RecordedKeypoints:
    """The output of ``detect.keypoints``; raises UserError with the file's name where it is missing or damaged."""

    def made(data: dict[str, Any]) -> RecordedKeypoints:
        expect(np.isin(data["frame"], data["pictures"]).all(), "frame names a picture that is not among pictures")
        return record(RecordedKeypoints, data)

    return read(path, _RECORDED, made)
