# SPDX-License-Identifier: Apache-2.0
"""A finished scene's folder in the browser of this machine: read only, behind an address that nobody can guess."""

from __future__ import annotations

import hmac
import http.server
import secrets
from http import HTTPStatus
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError


class Viewer(http.server.ThreadingHTTPServer):
    """Serves one folder on 127.0.0.1 below ``/<token>/``; not yet running.

    The token is new every time: other people on the machine, and pages of other sites that a browser has open, do not
    know it. Files are read, never listed, and links that lead out of the folder are not followed.
    """

    daemon_threads = True

    def __init__(self, folder: Path, port: int) -> None:
        """Raises UserError when the port is taken; 0 takes a free one."""
        self.folder, self.token = folder.resolve(), secrets.token_urlsafe(16)
        try:
            super().__init__(("127.0.0.1", port), _Reader)
        except (OSError, OverflowError) as error:
            raise UserError(
                f"port {port} of 127.0.0.1 cannot be had ({error}); choose another with --port, or --port 0 for a free "
                "one"
            ) from None

    def address(self, page: str) -> str:
        """Where a file of the folder is to be opened."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/{page}"


class _Reader(http.server.SimpleHTTPRequestHandler):
    server: Viewer

    def __init__(self, request: Any, client_address: Any, server: Viewer) -> None:
        super().__init__(request, client_address, server, directory=str(server.folder))

    def send_head(self) -> Any:
        token, _, rest = self.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        self.path = f"/{rest}"
        if not Path(self.translate_path(self.path)).resolve().is_relative_to(self.server.folder):
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        return super().send_head()

    def list_directory(self, path: Any) -> None:
        self.send_error(HTTPStatus.NOT_FOUND)

    def end_headers(self) -> None:
        self.send_header("Referrer-Policy", "no-referrer")  # a link in a page must not tell the token
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are nothing to tell anybody."""
