# SPDX-License-Identifier: Apache-2.0
"""Writes several videos in parallel while their frames are produced, with memory independent of the clip's length."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

Writer = Callable[[Iterator[np.ndarray]], object]


@contextmanager
def parallel_writers(writers: Sequence[Writer]) -> Iterator[Callable[..., None]]:
    """A function ``put(frame_0, frame_1, …)`` that hands one frame to each writer, which consumes an iterator.

    The files are complete when the block ends. When the block, or any writer, fails, every writer is stopped by an
    error inside its iterator, so that none of them keeps a partial file, and that first error is raised.
    """
    # Frames that may wait for a slow encoder; the producer pauses beyond that.
    queues: list[queue.Queue] = [queue.Queue(maxsize=8) for _ in writers]
    failures: list[BaseException] = []
    ended: set[int] = set()

    def frames_of(waiting: queue.Queue) -> Iterator[np.ndarray]:
        while (frame := waiting.get()) is not None:
            if isinstance(frame, BaseException):
                raise frame
            yield frame
        ended.add(id(waiting))

    def work(writer: Writer, waiting: queue.Queue) -> None:
        try:
            writer(frames_of(waiting))
        except BaseException as error:  # passed to the caller's thread below
            failures.append(error)
            # Keep draining, or the producer would block for ever. After the last frame, when closing a file fails on a
            # full disk, no more frames come.
            while id(waiting) not in ended and waiting.get() is not None:
                pass

    threads = [threading.Thread(target=work, args=pair, daemon=True) for pair in zip(writers, queues)]
    for thread in threads:
        thread.start()

    def put(*frames: np.ndarray) -> None:
        if failures:
            raise failures[0]
        for waiting, frame in zip(queues, frames, strict=True):
            waiting.put(frame)

    try:
        yield put
    except BaseException:
        for waiting in queues:
            waiting.put(_Stopped("the maker of the frames failed"))
        raise
    finally:
        for waiting in queues:
            waiting.put(None)
        for thread in threads:
            thread.join()
    if failures:
        raise failures[0]


class _Stopped(Exception):
    """Ends a writer's iterator when the producer of frames has failed."""
