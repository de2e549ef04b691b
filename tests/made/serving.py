# SPDX-License-Identifier: Apache-2.0
"""A local server that runs in a thread of the test."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.types import ASGIApp
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
