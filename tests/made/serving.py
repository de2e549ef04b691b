# SPDX-License-Identifier: Apache-2.0
"""A local server that runs in a thread of the test, and films to drop into its window."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from starlette.types import ASGIApp
from studiorecon.footage.video import write_watchable
from studiorecon.window.serving import LocalServer


@contextmanager
def served(app: ASGIApp) -> Iterator[LocalServer]:
    """The running server of ``app``, on a free port."""
    server = LocalServer(app, 0)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield server
    finally:
        server.end()
        thread.join()


def small_film(path: Path, seed: int = 0) -> bytes:
    """The bytes of a film of noise in the file ``path``, another one for every ``seed``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pictures = np.random.default_rng(seed).integers(0, 255, (6, 48, 64, 3), np.uint8)
    write_watchable(path, pictures, 15.0)
    return path.read_bytes()
