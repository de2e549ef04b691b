# SPDX-License-Identifier: Apache-2.0
"""``enhance.comparison``: writes films side by side (render | enhanced | photo) and with a wipe."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.streams import parallel_writers
from studiorecon.footage.video import read_frames, write_watchable
from studiorecon.progress import progress, say
from studiorecon.scene.path import PathStep, read_path
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Integer

_BAR_PX = 24
_GAP_PX = 4


def side_by_side(
    pictures: Sequence[Integer[np.ndarray, "H W 3"]], words: Sequence[str]
) -> Integer[np.ndarray, "h w 3"]:
    """(H + bar, W', 3) uint8: the pictures next to each other, each under its label."""
    height = pictures[0].shape[0] + _BAR_PX
    parts = []
    for picture, word in zip(pictures, words, strict=True):
        part = np.zeros((height, picture.shape[1] + _GAP_PX, 3), np.uint8)
        part[_BAR_PX:, : picture.shape[1]] = picture
        cv2.putText(part, word, (6, _BAR_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
        parts.append(part)
    return np.concatenate(parts, axis=1)[:, :-_GAP_PX]


def wipe_picture(
    left: Integer[np.ndarray, "H W 3"], right: Integer[np.ndarray, "H W 3"], share: float, words: tuple[str, str]
) -> Integer[np.ndarray, "H W 3"]:
    """``left`` up to ``share`` of the width, ``right`` beyond, a white line between, a label on either side."""
    width = left.shape[1]
    at = round(np.clip(share, 0, 1) * width)
    picture = right.copy()
    picture[:, :at] = left[:, :at]
    picture[:, max(at - 1, 0) : at + 1] = 255
    for word, column in ((words[0], 6), (words[1], width - 6 - 9 * len(words[1]))):
        for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(picture, word, (column, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, thick, cv2.LINE_AA)
    return picture


def wipe_share(picture: int, fps: float) -> float:
    """Position of the wipe's line as a share of the width; it starts in the middle and moves at an even, slow speed."""
    # Seconds in which the wipe goes from one side to the other and back.
    return 0.5 + 0.45 * float(np.sin(2 * np.pi * picture / (fps * 4.0)))


def photo_at_steps(steps: Sequence[PathStep], videos: Sequence[Path]) -> Iterator[Integer[np.ndarray, "H W 3"] | None]:
    """The photo of every step whose camera has footage (``<camera>.mkv``) and whose time is a whole frame, else
    None."""
    by_camera = {video.stem: video for video in videos}
    playing: tuple[str, int, Iterator[np.ndarray]] | None = None
    for step in steps:
        video, frame = by_camera.get(step.camera.name), round(step.frame)
        if video is None or abs(step.frame - frame) > 1e-6:
            yield None
            continue
        if playing is None or playing[:2] != (step.camera.name, frame):
            playing = (step.camera.name, frame, read_frames(video, frame))
        picture = next(playing[2])
        playing = (step.camera.name, frame + 1, playing[2])
        yield picture


def run(
    shot: str,
    render: Path,
    render_path: Path,
    video: Path,
    videos: list[Path],
    beside: Written,
    wipe: Written,
) -> None:
    """Write both films, with photos where a camera of ``videos`` took them, else render and enhanced."""
    steps, fps = read_path(render_path)
    photos = list(photo_at_steps(steps[:1], videos))
    with_photos = photos[0] is not None
    words = ("render", "enhanced", "photo") if with_photos else ("render", "enhanced")
    raws, made = read_frames(render, 0, len(steps)), read_frames(video, 0, len(steps))
    real = photo_at_steps(steps, videos) if with_photos else iter([None] * len(steps))
    writers = [lambda frames, p=p: write_watchable(p, frames, fps) for p in (beside, wipe)]
    with parallel_writers(writers) as put:
        for number, (raw, output, photo) in enumerate(
            zip(progress(raws, f"comparison of {shot}", total=len(steps)), made, real)
        ):
            if with_photos and photo is None:
                raise UserError(
                    f"picture {number} of shot {shot} has no photo though the first one has; render the shot again"
                )
            shown = [raw, output] if photo is None else [raw, output, _pad_photo(photo, raw.shape)]
            put(side_by_side(shown, words), wipe_picture(shown[-2], shown[-1], wipe_share(number, fps), words[-2:]))
    say(f"{beside} and {wipe} compare {' | '.join(words)} of shot {shot}")


def _pad_photo(photo: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The photo at the top left of a picture of the film's size (see ``render/shots.py``, every_frame)."""
    fitted = np.zeros(shape, np.uint8)
    fitted[: photo.shape[0], : photo.shape[1]] = photo[: shape[0], : shape[1]]
    return fitted
