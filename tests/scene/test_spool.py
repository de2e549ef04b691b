# SPDX-License-Identifier: Apache-2.0
"""Arrays in a file without a name: what comes back is what was put, and memory does not hold it."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from studiorecon.scene.spool import Spool


def test_arrays_come_back_as_they_were_and_in_memory_of_their_own(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "new")
    arrays = [
        np.arange(24, dtype=np.uint8).reshape(2, 4, 3)[:, ::2],
        np.array([[True, False]]),
        np.zeros((0, 3), np.float32),
        np.float64([[np.nan, -1.5]]),
    ]
    slots = [spool.put(array) for array in arrays]
    for array, slot in zip(arrays, slots):
        found = spool.get(slot)
        np.testing.assert_array_equal(found, array)
        assert (found.dtype, found.flags.writeable) == (array.dtype, True)
    spool.get(slots[0])[:] = 0
    np.testing.assert_array_equal(spool.get(slots[0]), arrays[0])
    spool.put_back(slots[1], np.array([[False, True]]))
    np.testing.assert_array_equal(spool.get(slots[1]), [[False, True]])
    np.testing.assert_array_equal(spool.get(slots[3]), arrays[3])
    with pytest.raises(ValueError, match=r"array is \(2,\) of bool"):
        spool.put_back(slots[1], np.array([False, True]))
    assert not list((tmp_path / "new").iterdir()), "nothing is left behind, whoever is killed"


def test_memory_does_not_grow_with_what_is_put(tmp_path: Path) -> None:
    spool, slots = Spool(tmp_path), []
    tracemalloc.start()
    for k in range(400):
        slots.append(spool.put(np.full((200, 100), k % 256, np.uint8)))
    assert all(spool.get(slot)[0, 0] == k % 256 for k, slot in enumerate(slots))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 400 * 20_000 / 10
