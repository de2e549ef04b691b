# SPDX-License-Identifier: Apache-2.0
"""A hub of weights on this machine, as its ordinary client knows it: files at commits, checksums,
and connections that break."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread


@dataclass
class Hub:
    """Files by (repository, name), the same at every commit; ``asked`` has (file, commit, range) of what was served.

    ``breaks_at`` cuts every answer after so many bytes.
    """

    files: dict[tuple[str, str], bytes]
    breaks_at: int | None = None
    requested: list[tuple[str, str, str]] = field(default_factory=list)
    address: str = ""


@contextmanager
def serving(hub: Hub) -> Iterator[Hub]:
    """Meanwhile ``hub`` answers at its ``address``, on the loopback of this machine."""

    class Answers(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            pass

        def do_HEAD(self) -> None:
            self.do_GET()

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            found = re.fullmatch(r"/(.+?)/resolve/(\w+)/(.+)", path)
            repository, commit, name = found.groups() if found else ("", "", path)
            content = hub.files.get((repository, name))
            if content is None:
                self.send_error(404)
                return
            self._content(commit, name, content)

        def _content(self, commit: str, name: str, content: bytes) -> None:
            wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
            first = int(wanted.group(1)) if wanted else 0
            part = content[first : int(wanted.group(2)) + 1 if wanted and wanted.group(2) else None]
            self.send_response(206 if wanted else 200)
            self.send_header("ETag", f'"{hashlib.sha256(content).hexdigest()}"')
            self.send_header("X-Repo-Commit", commit)
            self.send_header("Accept-Ranges", "bytes")
            self.send_header("Content-Length", str(len(part)))
            if wanted:
                self.send_header("Content-Range", f"bytes {first}-{first + len(part) - 1}/{len(content)}")
            self.end_headers()
            if self.command == "HEAD":
                return
            hub.requested.append((name, commit, self.headers.get("Range", "")))
            self.wfile.write(part[: hub.breaks_at])
            if hub.breaks_at is not None and len(part) > hub.breaks_at:
                self.close_connection = True

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    hub.address = f"http://127.0.0.1:{server.server_port}"
    try:
        yield hub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
