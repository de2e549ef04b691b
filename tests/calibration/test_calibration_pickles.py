# SPDX-License-Identifier: Apache-2.0
"""Pickled arrays are read as numpy wrote them, without numpy's or anybody's code."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from studiorecon.calibration.formats.pickles import read_pickle
from studiorecon.errors import UserError

OBJECTS = np.empty(2, object)
OBJECTS[0], OBJECTS[1] = [np.eye(2), np.zeros((0, 3))], {"t": (1, np.float32(2.5))}
TABLE = {
    "numbers": np.arange(6.0).reshape(2, 3),
    "turned": np.asfortranarray(np.arange(6, dtype=">f4").reshape(2, 3)),
    "one": np.float64(3),
    "marks": np.array([True, False]),
    "none": np.zeros((0, 2)),
    "text": ["a", b"b", None],
}


@pytest.mark.parametrize("protocol", range(2, 6))
def test_arrays_come_back_as_they_were(protocol: int, tmp_path: Path) -> None:
    path = tmp_path / "table.pkl"
    path.write_bytes(pickle.dumps(TABLE | {"objects": OBJECTS}, protocol))
    found = read_pickle(path)
    for name in ("numbers", "turned", "one", "marks", "none"):
        assert np.array_equal(found[name], TABLE[name])
        assert np.asarray(found[name]).dtype == np.asarray(TABLE[name]).dtype
    assert found["text"] == TABLE["text"]
    assert np.array_equal(found["objects"][0][0], np.eye(2))
    assert found["objects"][0][1].shape == (0, 3)
    assert found["objects"][1]["t"] == (1, 2.5)


@pytest.mark.parametrize("kind", ["<M8[s]", "U4", "V8", "complex128"])
def test_arrays_of_anything_but_numbers_are_refused(kind: str, tmp_path: Path) -> None:
    (tmp_path / "table.pkl").write_bytes(pickle.dumps(np.zeros(2, kind), 4))
    with pytest.raises(UserError, match="it holds arrays of"):
        read_pickle(tmp_path / "table.pkl")


def test_a_list_that_is_named_a_billion_times_is_held_once(tmp_path: Path) -> None:
    value: list = [np.eye(2)]
    for _ in range(30):
        value = [value, value]
    (tmp_path / "table.pkl").write_bytes(pickle.dumps(value, 4))
    found = read_pickle(tmp_path / "table.pkl")
    for _ in range(30):
        assert found[0] is found[1]
        found = found[0]
    assert np.array_equal(found[0], np.eye(2))


@pytest.mark.parametrize("number", [b"r\xff\xff\xff\x7f", b"p2147483647\n"])
def test_a_number_beyond_the_file_reserves_no_memory(number: bytes, tmp_path: Path) -> None:
    (tmp_path / "table.pkl").write_bytes(b"\x80\x02}" + number + b".")
    with pytest.raises(UserError, match="numbers more values than it holds"):
        read_pickle(tmp_path / "table.pkl")
