# SPDX-License-Identifier: Apache-2.0
"""Packs arrays into one compressed run of bytes, with a description of each for the reader in a browser.

Bytes are stored in planes (all first bytes of a column, then all second ones), so that slowly varying arrays compress
well. ``Bytes`` writes; the page's own reader is ``unpacked`` in ``resources/player/scene.js``. A description's
``packed`` gives the type: ``levels`` and ``floats`` are numbers, ``whole`` whole numbers, ``turns`` unit quaternions,
and a ``file`` stays bytes.
"""

from __future__ import annotations

import base64
import gzip
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Largest possible value of a unit quaternion's three smaller numbers.
_SMALLER = np.sqrt(0.5)
_QUATERNION_BITS = 10
# An even number, so that 0 is one of the levels.
_STEPS = 1022


class Bytes:
    """Arrays stored in sequence; every method adds one and returns its description."""

    def __init__(self) -> None:
        self.data = bytearray()

    def levels(
        self,
        values: Num[np.ndarray, "N ..."],
        bits: int,
        low: Num[np.ndarray, " C"] | float | None = None,
        high: Num[np.ndarray, " C"] | float | None = None,
    ) -> dict[str, Any]:
        """(N, C) values in 2^bits even steps between ``low`` and ``high``, per column; None takes the column's own."""
        values = _table(values, np.float64)
        empty = not len(values)
        low, high = (
            np.broadcast_to((0.0 if empty else own(axis=0)) if end is None else end, values.shape[1]).astype(np.float64)
            for end, own in ((low, values.min), (high, values.max))
        )
        steps = (1 << bits) - 1
        share = (values - low) / np.where(high > low, high - low, 1.0)
        described = self.whole(np.rint(np.clip(share, 0, 1) * steps).astype(np.uint64), bits)
        return described | {"packed": "levels", "low": low.tolist(), "high": high.tolist()}

    def whole(self, values: Num[np.ndarray, "N ..."], bits: int) -> dict[str, Any]:
        """(N, C) whole numbers below 2^bits, 8 to 32."""
        values = _table(values, np.uint64)
        planes = [((values >> np.uint64(shift)) & np.uint64(255)) for shift in range(bits - 8, -1, -8)]
        raw = np.stack(planes, axis=1).astype(np.uint8).transpose(2, 1, 0).tobytes()
        return self._add("whole", raw, count=len(values), columns=values.shape[1], bits=bits)

    def floats(self, values: Num[np.ndarray, "N ..."]) -> dict[str, Any]:
        """(N, C) as float32."""
        values = _table(values, "<f4")
        return self._add("floats", values.tobytes(), count=len(values), columns=values.shape[1])

    def quaternions(self, values: Num[np.ndarray, "N 4"]) -> dict[str, Any]:
        """Quaternions of any length, one 32-bit number each, within 0.2 degrees: largest component's index, other
        three."""
        values = np.asarray(values, np.float64)
        length = np.linalg.norm(values, axis=1, keepdims=True)
        unit = np.where(length < 1e-12, [1.0, 0, 0, 0], values / np.where(length < 1e-12, 1, length))
        largest = np.abs(unit).argmax(axis=1)
        unit *= np.where(np.take_along_axis(unit, largest[:, None], 1) < 0, -1.0, 1.0)
        packed = largest.astype(np.uint64)
        for k in range(3):
            other = (largest + 1 + k) % 4
            share = unit[np.arange(len(unit)), other] / _SMALLER / 2 + 0.5
            packed = (packed << np.uint64(_QUATERNION_BITS)) | np.rint(share * _STEPS).astype(np.uint64)
        return self.whole(packed, 32) | {"packed": "turns"}

    def file(self, content: bytes) -> dict[str, Any]:
        """A file as it is: a film, a picture."""
        return self._add("file", content, count=len(content))

    def text(self) -> str:
        """All bytes, compressed, as letters that a page may contain."""
        return base64.b64encode(gzip.compress(bytes(self.data), 9, mtime=0)).decode("ascii")

    def _add(self, kind: str, raw: bytes, **shape: int) -> dict[str, Any]:
        self.data += b"\0" * (-len(self.data) % 4)
        described = {"packed": kind, "at": len(self.data), **shape}
        self.data += raw
        return described


def _table(values: np.ndarray, kind: Any) -> np.ndarray:
    """(N, C) of values (N, ...); there may be none."""
    return np.asarray(values, kind).reshape(len(values), int(np.prod(np.shape(values)[1:])))


def quantise_weights(weights: Float[np.ndarray, "N K"]) -> Integer[np.ndarray, "N K"]:
    """Uint8 that add up to exactly 255 in every row, nearest to ``weights`` that add up to 1.

    A splat whose shares add up to less would be pulled towards the origin of the world.
    """
    exact = np.asarray(weights, np.float64) * 255
    found = np.floor(exact + 1e-9)
    missing = np.rint(255 - found.sum(axis=1)).astype(int)
    order = np.argsort(found - exact, axis=1, kind="stable")
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, np.arange(exact.shape[1])[None], axis=1)
    return (found + (rank < missing[:, None])).astype(np.uint8)


def morton_order(points_m: Float[np.ndarray, "N 3"]) -> Integer[np.ndarray, " N"]:
    """The order of points along Morton's curve, in which neighbours stay near."""
    if not len(points_m):
        return np.zeros(0, np.int64)
    low, high = np.percentile(points_m, (1, 99), axis=0)
    cells = np.clip((points_m - low) / np.maximum(high - low, 1e-9), 0, 1) * 1023
    code = np.zeros(len(points_m), np.uint64)
    for axis in range(3):
        bits = cells[:, axis].astype(np.uint64)
        for bit in range(10):
            code |= ((bits >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")
