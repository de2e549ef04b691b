# SPDX-License-Identifier: Apache-2.0
"""Small films and calibrations that tests write themselves."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path
from typing import IO

import av
import cv2
import numpy as np
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage
from studiorecon.scene.clocks import Clock, Clocks
from studiorecon.scene.files import write_json

WH = (96, 64)


def smooth_pictures(count: int, wh: tuple[int, int] = WH, seed: int = 0) -> np.ndarray:
    """(count, H, W, 3) uint8 soft random colours, all different."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [cv2.resize(rng.integers(0, 256, (4, 6, 3), np.uint8), wh, interpolation=cv2.INTER_CUBIC) for _ in range(count)]
    )


def write_video(path: Path, frames: np.ndarray, fps: int = 30, rotation: int = 0, times: Sequence[int] = ()) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "8", "g": "5"})
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        if rotation:
            stream.set_display_rotation(rotation)
        for frame, time in zip_longest(frames, times):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame))
            if time is not None:
                picture.pts, picture.time_base = time, Fraction(1, fps)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


def write_streamed(path: Path, frames: np.ndarray, fps: int = 30) -> Path:
    """A Matroska film as a recorder streams it: its header tells neither frames nor duration."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "wb") as file, av.open(_Pipe(file), "w", format="matroska", options={"live": "1"}) as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "8", "g": "5"})
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame))))
        container.mux(stream.encode(None))
    return path


class _Pipe:
    """What is written into it cannot be gone back to."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def write(self, data: bytes) -> int:
        return self._file.write(data)


def calibrated(folder: Path, wh: tuple[int, int] = WH, distortion: float = 0.0, name: str = "a") -> Path:
    intrinsics = np.array([[80.0, 0, wh[0] / 2], [0, 80, wh[1] / 2], [0, 0, 1]])
    lens = Lens(name, wh, intrinsics, "opencv", np.array([distortion, 0, 0, 0, 0]), np.eye(4), np.eye(2, 3))
    write_json(folder / "calibration.json", {"lenses": [lens.as_json()]})
    return folder / "calibration.json"


def footage(
    camera: str, frames: int = 60, fps: float = 30.0, wh: tuple[int, int] = WH, held_out: bool = False
) -> Footage:
    intrinsics = [[80.0, 0, wh[0] / 2], [0, 80, wh[1] / 2], [0, 0, 1]]
    return Footage(camera, held_out, wh, intrinsics, fps, frames, 0, f"videos/{camera}.mp4", "", wh, 0, 0.0, [])


def as_counted(camera: str, fps: float, first: int, frames: int) -> Clocks:
    """One camera whose working frames are its frames ``first`` … ``first`` + ``frames`` - 1."""
    return Clocks(fps, first / fps, frames, (Clock(camera, fps, first + frames),))
