# SPDX-License-Identifier: Apache-2.0
"""Serves a finished scene's folder to this machine's browser, read only, at a secret address."""

from __future__ import annotations

import contextlib
import hmac
import http.server
import mimetypes
import os
import re
import secrets
from http import HTTPStatus
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote, unquote_to_bytes

from studiorecon.errors import UserError

_RANGE = re.compile(r"bytes=([0-9]{0,18})-([0-9]{0,18})")


class Viewer(http.server.ThreadingHTTPServer):
    """Serves one folder on 127.0.0.1 below ``/<token>/``; not yet running.

    The token is new every time, so that other people on the machine, and other sites' pages, do not know it. Files are
    read, never listed, and links that lead out of the folder are not followed.
    """

    daemon_threads = True

    def __init__(self, folder: Path, port: int) -> None:
        """Raises UserError when the port is taken; 0 takes a free one."""
        self.folder, self.token = folder.resolve(), secrets.token_urlsafe(16)
        try:
            super().__init__(("127.0.0.1", port), _Reader)
        except (OSError, OverflowError) as error:
            raise UserError(
                f"port {port} of 127.0.0.1 cannot be opened ({error}); choose another with --port, or --port 0 for "
                "a free one"
            ) from None

    def address(self, page: str) -> str:
        """The address of a file of the folder."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/{page}"


class _Reader(http.server.BaseHTTPRequestHandler):
    server: Viewer
    # Browsers seek in films by ranges, which came with 1.1.
    protocol_version = "HTTP/1.1"
    # Seconds without traffic after which a connection is closed; a browser on this machine never takes that long.
    timeout = 30

    def handle(self) -> None:
        # A browser that left the page closes the connection in the middle of a film.
        with contextlib.suppress(ConnectionError):
            super().handle()

    def do_GET(self) -> None:
        path = self._path()
        if path is not None and path.is_dir():
            # Pages link relative to their folder, whose address ends in a slash.
            parts = path.relative_to(self.server.folder).parts
            self._begin(HTTPStatus.MOVED_PERMANENTLY, 0)
            self.send_header(
                "Location", "/".join(["", self.server.token, *(quote(os.fsencode(part)) for part in parts), ""])
            )
            return self.end_headers()
        try:
            file = path.open("rb") if path else None
        except OSError:
            file = None
        if path is None or file is None:
            return self.send_error(HTTPStatus.NOT_FOUND)
        with file:
            self._send(file, mimetypes.guess_type(path.name)[0] or "application/octet-stream")

    do_HEAD = do_GET

    def _path(self) -> Path | None:
        """The requested file, or the folder whose address lacks its slash; None for a path that may not be read."""
        here = f"http://{self.headers.get('Host', '')}/"
        requested = re.split(r"[?#]", "/" + self.path.removeprefix(here).removeprefix("/"), maxsplit=1)[0]
        token, *parts = [os.fsdecode(unquote_to_bytes(part)) for part in requested.split("/")][1:]
        if not hmac.compare_digest(os.fsencode(token), self.server.token.encode()):
            return None
        if any(part in (".", "..") or re.search(r"[/\\\0]", part) for part in parts):
            return None
        try:
            path = self.server.folder.joinpath(*filter(None, parts)).resolve()
            page = (path / "index.html").resolve()
            found = page if requested.endswith("/") else path
            held = page if path.is_dir() else path
            return found if held.is_file() and found.is_relative_to(self.server.folder) else None
        except (OSError, RuntimeError):  # a name too long, a loop of links
            return None

    def _begin(self, status: HTTPStatus, length: int) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(length))

    def _send(self, file: BinaryIO, kind: str) -> None:
        size = os.fstat(file.fileno()).st_size
        status, part = self._part(size)
        self._begin(status, len(part))
        if status is HTTPStatus.PARTIAL_CONTENT:
            self.send_header("Content-Range", f"bytes {part.start}-{part.stop - 1}/{size}")
        if status is HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            self.send_header("Content-Range", f"bytes */{size}")
        self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind.startswith("text/") else kind)
        self.end_headers()
        left = len(part) if self.command == "GET" else 0
        file.seek(part.start)
        while left and (chunk := file.read(min(left, 1 << 16))):
            self.wfile.write(chunk)
            left -= len(chunk)

    def _part(self, size: int) -> tuple[HTTPStatus, range]:
        """The status of an answer and its range of bytes; several or invalid ranges get the whole file (RFC 9110,
        14.2)."""
        requested = _RANGE.fullmatch(self.headers.get("Range", "").strip())
        first, last = requested.groups() if requested else ("", "")
        whole = HTTPStatus.OK, range(size)
        # Files have no version tag here: a request for a part of a certain version gets the whole file.
        if self.command != "GET" or not (first or last) or "If-Range" in self.headers:
            return whole
        if first and last and int(last) < int(first):
            return whole
        start = int(first) if first else max(size - int(last), 0)
        stop = min(int(last) + 1, size) if first and last else size
        if start >= stop:
            return HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, range(0)
        return HTTPStatus.PARTIAL_CONTENT, range(start, stop)

    def end_headers(self) -> None:
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Cache-Control", "no-cache")  # the next run writes the same names
        self.send_header("Connection", "close")
        self.send_header("Referrer-Policy", "no-referrer")  # a link in a page must not reveal the token
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Drops the message: requests are not logged."""
