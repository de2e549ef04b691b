# SPDX-License-Identifier: Apache-2.0
"""A hub of weights on this machine, as its ordinary client knows it: files at commits, gates, checksums, and
connections that break."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

LARGE = 1000
"""Files from this size on carry their SHA-256, smaller ones git's name of their content."""


@dataclass
class Hub:
    """Files by (repository, name), the same at every commit; ``asked`` has (file, commit, range) of what was served.

    ``gated`` repositories answer that their terms have not been agreed to. ``breaks_at`` cuts every answer after so
    many bytes. ``stated`` replaces the checksum of a file.
    """

    files: dict[tuple[str, str], bytes]
    gated: set[str] = field(default_factory=set)
    breaks_at: int | None = None
    stated: dict[str, str] = field(default_factory=dict)
    asked: list[tuple[str, str, str]] = field(default_factory=list)
    address: str = ""

    def checksum(self, name: str, content: bytes) -> str:
        if name in self.stated:
            return self.stated[name]
        if len(content) >= LARGE:
            return hashlib.sha256(content).hexdigest()
        return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()

    def about(self, repository: str, commit: str) -> dict:
        """What the hub says of a repository at a commit."""
        own = {name: content for (place, name), content in self.files.items() if place == repository}
        siblings = []
        for name, content in own.items():
            entry = {"rfilename": name, "size": len(content), "blobId": self.checksum(name, content)}
            if len(content) >= LARGE:
                entry["lfs"] = {"sha256": self.checksum(name, content), "size": len(content), "pointerSize": 130}
            siblings.append(entry)
        return {
            "id": repository,
            "modelId": repository,
            "sha": commit,
            "siblings": siblings,
            "private": False,
            "tags": [],
        }

    def tree(self, repository: str) -> list[dict]:
        """The files of a repository, as the hub lists folders."""
        about = self.about(repository, "")["siblings"]
        return [{"type": "file", "path": e["rfilename"], "size": e["size"], "oid": e["blobId"]} for e in about]


@contextmanager
def serving(hub: Hub) -> Iterator[Hub]:
    """Meanwhile ``hub`` answers at its ``address``, on the loopback of this machine."""

    class Answers(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            pass

        def _json(self, content: object, status: int = 200, headers: dict[str, str] | None = None) -> None:
            body = json.dumps(content).encode()
            self.send_response(status)
            for name, value in {"Content-Type": "application/json", **(headers or {})}.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body)

        def do_HEAD(self) -> None:
            self.do_GET()

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            if found := re.fullmatch(r"/api/models/(.+?)/(revision|tree)/(\w+)/?", path):
                repository, what, commit = found.groups()
                self._json(hub.about(repository, commit) if what == "revision" else hub.tree(repository))
                return
            found = re.fullmatch(r"/(.+?)/resolve/(\w+)/(.+)", path)
            repository, commit, name = found.groups() if found else ("", "", path)
            if repository in hub.gated:
                said = "Access to this model is restricted: agree to its terms on its page."
                self._json({"error": said}, 403, {"X-Error-Code": "GatedRepo", "X-Error-Message": said})
                return
            content = hub.files.get((repository, name))
            if content is None:
                self._json({"error": "Entry not found"}, 404, {"X-Error-Code": "EntryNotFound"})
                return
            self._content(commit, name, content)

        def _content(self, commit: str, name: str, content: bytes) -> None:
            wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
            first = int(wanted.group(1)) if wanted else 0
            part = content[first : int(wanted.group(2)) + 1 if wanted and wanted.group(2) else None]
            self.send_response(206 if wanted else 200)
            self.send_header("ETag", f'"{hub.checksum(name, content)}"')
            self.send_header("X-Repo-Commit", commit)
            self.send_header("Accept-Ranges", "bytes")
            self.send_header("Content-Length", str(len(part)))
            if wanted:
                self.send_header("Content-Range", f"bytes {first}-{first + len(part) - 1}/{len(content)}")
            self.end_headers()
            if self.command == "HEAD":
                return
            hub.asked.append((name, commit, self.headers.get("Range", "")))
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
