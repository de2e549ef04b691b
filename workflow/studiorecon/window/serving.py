# SPDX-License-Identifier: Apache-2.0
"""A server for this machine's browser alone: a secret address, one gate before every page, and files of a folder."""

from __future__ import annotations

import asyncio
import hmac
import os
import re
import secrets
import socket
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote_to_bytes

import uvicorn
from starlette.datastructures import Headers
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from studiorecon.errors import UserError

IDLE_S = 30.0
"""Seconds without traffic after which a connection is closed; a browser on this machine never takes that long."""
# One range of bytes; several, or other units, get the whole file (RFC 9110, 14.2).
_RANGE = re.compile(r"bytes=([0-9]{1,18})-([0-9]{0,18})|bytes=-([0-9]{1,18})")
_HEADERS = {
    "cache-control": "no-cache",  # the next run writes the same names
    "referrer-policy": "no-referrer",  # a link in a page must not reveal the token
    "x-content-type-options": "nosniff",
    "content-security-policy": "frame-ancestors 'self'",
}


class LocalServer(uvicorn.Server):
    """Serves ``app`` on 127.0.0.1 below ``/<token>/``; ``serve_forever`` runs it until ``end`` or Ctrl-C.

    The token is new every time, so that other people on the machine, and other sites' pages, do not know it.
    """

    def __init__(self, app: ASGIApp, port: int) -> None:
        """Raises UserError when the port is taken; 0 takes a free one."""
        self.token = secrets.token_urlsafe(16)
        self._socket = socket.socket()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise UserError(
                f"port {port} of 127.0.0.1 cannot be opened ({error}); choose another with --port, or --port 0 for "
                "a free one"
            ) from None
        self.port = int(self._socket.getsockname()[1])
        super().__init__(
            uvicorn.Config(
                _Gate(app, self.token, self.port),
                http=_Impatient,
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                proxy_headers=False,
                server_header=False,
                date_header=False,
                timeout_graceful_shutdown=1,
            )
        )

    def address(self, page: str) -> str:
        """The address of a page of the app."""
        return f"http://127.0.0.1:{self.port}/{self.token}/{page}"

    def serve_forever(self) -> None:
        """Answer requests until the end; KeyboardInterrupt after Ctrl-C."""
        self.run(sockets=[self._socket])

    def end(self) -> None:
        """End ``serve_forever``, from any thread."""
        self.should_exit = True
        self._loop.call_soon_threadsafe(self._ended.set)

    def handle_exit(self, sig: int, frame: Any) -> None:
        super().handle_exit(sig, frame)
        self.end()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        await super().startup(sockets)

    async def main_loop(self) -> None:
        # uvicorn's own wakes ten times a second; a window that nobody uses costs nothing.
        if not self.should_exit:
            await self._ended.wait()


class _Impatient(H11Protocol):
    """A connection that ends when a browser neither sends nor reads for ``IDLE_S``."""

    _received = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch(None)

    def data_received(self, data: bytes) -> None:
        self._received += len(data)
        super().data_received(data)

    def _watch(self, before: tuple[int, int] | None) -> None:
        if self.transport.is_closing():
            return
        now = self._received, self.transport.get_write_buffer_size()
        # While we prepare an answer, the browser has nothing to send or read.
        ours = self.cycle is not None and not (self.cycle.response_complete or self.cycle.more_body or now[1])
        if now == before and not ours:
            self.transport.abort()
        else:
            self.loop.call_later(IDLE_S, self._watch, now)


class _Gate:
    """Lets only requests pass that know the token and come from our own pages; their path is then the rest."""

    def __init__(self, app: ASGIApp, token: str, port: int) -> None:
        self._app, self._token = app, token
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def framed(message: Any) -> None:
            if message["type"] == "http.response.start":
                sent = {name.decode().lower() for name, _ in message["headers"]}
                message["headers"] += [(k.encode(), v.encode()) for k, v in _HEADERS.items() if k not in sent]
            await send(message)

        headers, app = Headers(scope=scope), self._app
        path = self._path(scope["raw_path"], headers.get("host", ""))
        if path is None:
            app = PlainTextResponse("Not found", 404)
        elif scope["method"] not in ("GET", "HEAD") and headers.get("origin", "") not in {
            f"http://{host}" for host in self._hosts
        }:
            app = PlainTextResponse("Only the window itself may change something", 403)
        await app({**scope, "path": path or "/", "token": self._token}, receive, framed)

    def _path(self, raw: bytes, host: str) -> str | None:
        """The path behind the token; None without it, from another host's name, or with parts that no page links."""
        if host not in self._hosts:
            return None
        parts = raw.removeprefix(f"http://{host}".encode()).removeprefix(b"/").split(b"/")
        token, *names = [os.fsdecode(unquote_to_bytes(part)) for part in parts]
        if not hmac.compare_digest(os.fsencode(token), self._token.encode()) or not names:
            return None
        if any(name in (".", "..") or re.search(r"[/\\\0]", name) for name in names):
            return None
        return "/" + "/".join(names)


def file_response(folder: Path, requested: str, scope: Scope) -> Response:
    """A file of ``folder``, the page of a folder, or 404; links that lead out of ``folder`` are not followed.

    A folder's address without its slash leads to that with it, since pages link relative to their folder.
    """
    folder, file = folder.resolve(), None
    try:
        path = folder.joinpath(*filter(None, requested.split("/"))).resolve()
        page = (path / "index.html").resolve()
        held = page if path.is_dir() else path
        if held.is_file() and held.is_relative_to(folder) and (path.is_dir() or not requested.endswith("/")):
            file, about = held, held.stat()
            held.open("rb").close()
    except (OSError, RuntimeError):  # a name too long, a loop of links, no permission
        file = None
    if file is None:
        return PlainTextResponse("Not found", 404)
    if file != path and not requested.endswith("/"):
        there = "/".join(quote(os.fsencode(part)) for part in filter(None, scope["path"].split("/")))
        return Response(status_code=301, headers={"location": f"/{scope['token']}/{there}/"})
    given = _RANGE.fullmatch(Headers(scope=scope).get("range", "").strip())
    first, last = (given[1], given[2]) if given else ("", "")
    if given is None or scope["method"] == "HEAD" or (first and last and int(last) < int(first)):
        scope["headers"] = [pair for pair in scope["headers"] if pair[0] != b"range"]
    return FileResponse(file, stat_result=about)


class Folder:
    """An app that serves one folder's files, read only, without listings."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] not in ("GET", "HEAD"):
            return await PlainTextResponse("Read only", 405)(scope, receive, send)
        await file_response(self._folder, scope["path"], scope)(scope, receive, send)
        return None
