# SPDX-License-Identifier: Apache-2.0
"""A file that users may bring, what reads it, and the verdict on what it does with a damaged one."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from studiorecon.errors import UserError

from tests.faults import damage

SAMPLE, NIGHTLY = 120, 10_000


def npz(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@dataclass(frozen=True)
class Reader:
    """A file that a user may bring, whole, and what reads it; ``value``: what it holds, where it is JSON or YAML."""

    name: str
    whole: bytes
    right: Callable[[Path], None]
    value: Any = None
    beside: tuple[tuple[str, bytes], ...] = ()
    text: bool = True

    def written(self, folder: Path, data: bytes) -> Path:
        for name, content in (*self.beside, (self.name, data)):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        return folder / self.name


def of_json(name: str, value: Any, right: Callable[[Path], None]) -> Reader:
    return Reader(name, json.dumps(value, indent=1).encode(), right, value)


def survives(reader: Reader, path: Path) -> str:
    """``right``, or the sentence of the refusal, which is one and names something of the user's."""
    try:
        reader.right(path)
    except UserError as refusal:
        sentence = str(refusal)
        assert "\n" not in sentence
        assert 20 < len(sentence) < 1500
        return sentence
    return "right"


def damaged(reader: Reader, path: Path, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for k in range(count):
        if k % 2 and reader.value is not None:
            dump = yaml.safe_dump if reader.name.endswith(".yaml") else json.dumps
            data = dump(damage.structure_changed(reader.value, rng)).encode()
        else:
            data = damage.bytes_changed(reader.whole, rng)
        path.write_bytes(data)
        try:
            survives(reader, path)
        except Exception as error:
            raise AssertionError(f"variant {k} of seed {seed}: {data[:2000]!r}") from error
