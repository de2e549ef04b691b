# SPDX-License-Identifier: Apache-2.0
"""Frames of working videos at any time, read forwards: memory stays flat, and going back jumps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from studiorecon.images.seeking import read_frames_from


class Playback:
    """One video from frame ``first`` on, for ``count`` frames: ``at(i)`` is frame ``first + i``.

    The training shot holds all cameras one after the other, so each camera's part is a Playback of its own.
    """

    def __init__(self, path: Path, first: int, count: int) -> None:
        self._path, self._first, self._count = path, first, count
        self._frames: Iterator[np.ndarray] = iter(())
        self._index = -1
        self._current: np.ndarray | None = None
        self._rewind()

    def at(self, index: int) -> np.ndarray:
        """Frame ``index`` as stored; IndexError outside 0 … count - 1."""
        if not 0 <= index < self._count:
            raise IndexError(f"{self._path} has {self._count} frames from {self._first}, not {index}")
        if index < self._index:
            self._rewind()
        while self._index < index:
            self._current = next(self._frames)
            self._index += 1
        assert self._current is not None
        return self._current

    def _rewind(self) -> None:
        self._frames = read_frames_from(self._path, self._first, self._first + self._count)
        self._index = -1
