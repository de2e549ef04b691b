# SPDX-License-Identifier: Apache-2.0
"""Threads of a job, for work inside OpenCV, ONNX Runtime and FFmpeg, which release Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Out = TypeVar("Out")


def given_threads() -> int:
    """The threads that Snakemake gives this job; all cores outside of a job."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    return int(given) if given.isdigit() and int(given) else os.cpu_count() or 1


def in_threads(function: Callable[..., Out], *items: Iterable) -> Iterator[Out]:
    """``function`` of each of the ``items`` (one iterable per argument), in their order, in ``given_threads`` threads;
    raises what the first that fails raises."""
    if (threads := given_threads()) == 1:
        yield from map(function, *items)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(function, *items)
