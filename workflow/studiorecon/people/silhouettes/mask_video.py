# SPDX-License-Identifier: Apache-2.0
"""Silhouettes over time: the labelled pictures of several cameras, compressed, so that thousands of frames fit into
memory.

A frame of four cameras at 480 × 270 takes half a megabyte as pictures and a few kilobytes here; unpacking one takes a
millisecond.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.people.silhouettes.contour import Targets

if TYPE_CHECKING:
    from jaxtyping import Integer

# A second of neighbouring frames is looked at again and again; no more is kept unpacked.
_KEPT = 16


class LabelFilm(Mapping[int, list[np.ndarray]]):
    """Frame → V pictures (H, W) uint8 of ``foreground.labels``; ``wh`` (V, 2) are the pictures' sizes."""

    def __init__(
        self, wh: Integer[np.ndarray, "V 2"], frames: Iterable[tuple[int, list[Integer[np.ndarray, "H W"]]]] = ()
    ) -> None:
        self.wh = np.asarray(wh, dtype=np.int64)
        self._packed: dict[int, bytes] = {}
        for frame, pictures in frames:
            self.add(frame, pictures)

    def add(self, frame: int, pictures: list[Integer[np.ndarray, "H W"]]) -> None:
        """Append a frame; raises ValueError for pictures of other sizes."""
        sizes = [p.shape[::-1] for p in pictures]
        if sizes != [tuple(int(n) for n in wh) for wh in self.wh]:
            raise ValueError(f"pictures of frame {frame} are {sizes}, not {self.wh.tolist()}")
        self._packed[int(frame)] = zlib.compress(np.concatenate([p.ravel() for p in pictures]).tobytes(), 1)

    def __getitem__(self, frame: int) -> list[Integer[np.ndarray, "H W"]]:
        flat = np.frombuffer(zlib.decompress(self._packed[int(frame)]), np.uint8)
        cuts = np.cumsum(self.wh.prod(1))[:-1]
        return [part.reshape(h, w) for part, (w, h) in zip(np.split(flat, cuts), self.wh)]

    def __iter__(self) -> Iterator[int]:
        return iter(self._packed)

    def __len__(self) -> int:
        return len(self._packed)

    def to_arrays(self) -> dict[str, Integer[np.ndarray, " ..."]]:
        """What ``from_arrays`` reads back: sizes, frame numbers, lengths of the compressed frames and their bytes."""
        joined = np.frombuffer(b"".join(self._packed.values()), np.uint8)
        lengths = np.array([len(one) for one in self._packed.values()], dtype=np.int64)
        return {
            "wh": self.wh,
            "frames": np.array(list(self._packed), dtype=np.int64),
            "lengths": lengths,
            "packed": joined,
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, Integer[np.ndarray, " ..."]]) -> LabelFilm:
        film = LabelFilm(arrays["wh"])
        ends = np.cumsum(arrays["lengths"])
        for frame, start, end in zip(arrays["frames"], ends - arrays["lengths"], ends):
            film._packed[int(frame)] = arrays["packed"][start:end].tobytes()
        return film


class FilmTargets(Mapping[int, Targets]):
    """Frame → the silhouettes' outlines, made when asked for; the last few are kept."""

    def __init__(self, film: LabelFilm) -> None:
        self.film = film
        self._of = lru_cache(maxsize=_KEPT)(lambda frame: Targets.of(film[frame]))

    def __getitem__(self, frame: int) -> Targets:
        return self._of(int(frame))

    def __iter__(self) -> Iterator[int]:
        return iter(self.film)

    def __len__(self) -> int:
        return len(self.film)
