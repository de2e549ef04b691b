# SPDX-License-Identifier: Apache-2.0
"""``studiorecon view``: what it answers over a socket, to browsers and to whoever else is on the machine."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from studiorecon.errors import UserError
from studiorecon.window import serving as module
from studiorecon.window.serving import Folder, LocalServer

from tests.made.serving import served

FILM = bytes(range(256)) * 1000
PAGE = b"<p>the page</p>"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "results/take"
    for name, content in (("report/index.html", PAGE), ("enhance/a b+é.mp4", FILM), ("empty.txt", b"")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    (tmp_path / "secret.txt").write_text("not part of the scene")
    return folder


@pytest.fixture
def viewer(scene: Path, capfd: pytest.CaptureFixture) -> Iterator[LocalServer]:
    with served(Folder(scene)) as server:
        yield server
    assert capfd.readouterr() == ("", ""), "no stack, no log"


def connection(viewer: LocalServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", viewer.port), timeout=20)


def answered(viewer: LocalServer, target: str, *headers: str, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
    """Status, headers and content of one request, whose line goes out as it is given; TOKEN is the viewer's."""
    with connection(viewer) as plug:
        lines = [f"{method} {target} HTTP/1.1", f"Host: 127.0.0.1:{viewer.port}", "Connection: close", *headers]
        request = "\r\n".join([*lines, "", ""]).replace("TOKEN", viewer.token)
        plug.sendall(request.encode("latin-1"))
        raw = b"".join(iter(lambda: plug.recv(1 << 16), b""))
    head, _, content = raw.partition(b"\r\n\r\n")
    first, *rest = head.decode("latin-1").split("\r\n")
    fields = (line.split(": ", 1) for line in rest)
    return int(first.split()[1]), {name.title(): value for name, value in fields}, content


def test_it_is_there_for_this_machine_alone_on_a_port_of_its_own(viewer: LocalServer) -> None:
    ours = [one.laddr for one in psutil.Process().net_connections("tcp") if one.laddr.port == viewer.port]
    assert {place.ip for place in ours} == {"127.0.0.1"}
    with pytest.raises(UserError, match=f"port {viewer.port} of 127.0.0.1 cannot be opened .*--port 0"):
        LocalServer(Folder(Path(".")), viewer.port)


@pytest.mark.parametrize(
    "target",
    [
        "/TOKEN/report/index.html",
        "/TOKEN/report/",
        "/TOKEN//report//index.html",
        "/TOKEN/report/index.html?frame=1#top",
        "/TOKEN/%72eport/index.html",
        "http://127.0.0.1:PORT/TOKEN/report/index.html",
    ],
)
def test_a_page_is_served(viewer: LocalServer, target: str) -> None:
    status, headers, content = answered(viewer, target.replace("PORT", str(viewer.port)))
    assert (status, content) == (200, PAGE)
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert headers["Referrer-Policy"] == "no-referrer"


# Addresses that lead out of the folder, to nothing, or to no file.
ELSEWHERE = r"""
/ // * /TOKEN /TOKEN/ /TOKEN/other /TOKEN/enhance /TOKEN/enhance/ /TOKEN/report/index.html/ /TOKEN/%00
/TOKEN/report/index.html%00 /%00/report/index.html /TOKEN/../../secret.txt /TOKEN/%2e%2e/%2e%2e/secret.txt
/TOKEN/..%2f..%2fsecret.txt /TOKEN/..\..\secret.txt /TOKEN/..%5c..%5csecret.txt
/TOKEN/report/../report/index.html /TOKEN//etc/passwd /TOKEN/%2fetc/passwd /TOKEN/%ff%fe /TOKEN/%
/TOKENx/report/index.html /xTOKEN/report/index.html /report/index.html
http://127.0.0.1:1/TOKEN/report/index.html http://[/TOKEN/report/index.html //host/%2e%2e //TOKEN.host/%2e%2e
/TOKEN//host/%2e%2e /TOKEN/dangling /TOKEN/loop /TOKEN/pipe /TOKEN/secret /TOKEN/above/secret.txt
/TOKEN/outside
"""


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_nothing_else_is(viewer: LocalServer, scene: Path, method: str) -> None:
    (scene / "dangling").symlink_to("nothing")
    (scene / "loop").symlink_to("loop")
    (scene / "secret").symlink_to(scene.parents[1] / "secret.txt")
    (scene / "above").symlink_to(scene.parents[1])
    outside = scene.parents[1] / "site/index.html"
    outside.parent.mkdir()
    outside.write_text("another site")
    (scene / "outside").symlink_to(outside.parent)
    os.mkfifo(scene / "pipe")
    for target in [*ELSEWHERE.split(), "/TOKEN/" + "x" * 5000]:
        status, headers, content = answered(viewer, target, method=method)
        assert (status, "Location" in headers, bool(content)) == (404, False, method == "GET"), target
        assert viewer.token.encode() not in content


def test_links_within_the_folder_are_followed(viewer: LocalServer, scene: Path) -> None:
    (scene / "again.html").symlink_to(scene / "report/index.html")
    assert answered(viewer, "/TOKEN/again.html")[2] == PAGE


def test_a_folder_s_address_leads_to_its_page_behind_the_token(viewer: LocalServer) -> None:
    status, headers, _ = answered(viewer, "/TOKEN/report?x")
    assert (status, headers["Location"]) == (301, f"/{viewer.token}/report/")


def test_every_start_has_its_own_token_and_nobody_writes(viewer: LocalServer, scene: Path) -> None:
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert answered(viewer, "/TOKEN/report/index.html", "Content-Length: 0", method=method)[0] in (403, 405)
        here = f"Origin: http://127.0.0.1:{viewer.port}"
        assert answered(viewer, "/TOKEN/report/index.html", here, "Content-Length: 0", method=method)[0] == 405
    assert (scene / "report/index.html").read_bytes() == PAGE
    with served(Folder(scene)) as other:
        assert other.token != viewer.token


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1:1", "127.0.0.1"])
def test_a_name_that_leads_here_from_elsewhere_opens_nothing(viewer: LocalServer, host: str) -> None:
    with connection(viewer) as plug:
        plug.sendall(f"GET /{viewer.token}/report/ HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        assert b" 404 " in b"".join(iter(lambda: plug.recv(1 << 16), b""))


END = len(FILM)


@pytest.mark.parametrize(
    ("requested", "status", "part"),
    [
        ("bytes=0-", 206, (0, END)),
        ("bytes=0-0", 206, (0, 1)),
        ("bytes=1000-1999", 206, (1000, 2000)),
        (f"bytes={END - 1}-", 206, (END - 1, END)),
        (f"bytes=5-{10 * END}", 206, (5, END)),
        ("bytes=-300", 206, (END - 300, END)),
        (f"bytes=-{10 * END}", 206, (0, END)),
        (f"bytes={END}-", 416, (0, 0)),
        ("bytes=-0", 416, (0, 0)),
        ("bytes=0-1,5-9", 200, (0, END)),
        ("bytes=9-5", 200, (0, END)),
        ("bytes=-", 200, (0, END)),
        ("bytes=x-", 200, (0, END)),
        ("bytes=-1-2", 200, (0, END)),
        ("bytes=²-", 200, (0, END)),
        ("frames=0-5", 200, (0, END)),
        ("bytes=" + "9" * 5000 + "-", 200, (0, END)),
        ("", 200, (0, END)),
    ],
)
def test_a_film_is_sought_by_ranges(viewer: LocalServer, requested: str, status: int, part: tuple[int, int]) -> None:
    found, headers, content = answered(viewer, "/TOKEN/enhance/a%20b+%c3%a9.mp4", f"Range: {requested}")
    assert found == status
    assert content == FILM[slice(*part)]
    assert int(headers["Content-Length"]) == len(content)
    reported = {206: f"bytes {part[0]}-{part[1] - 1}/{END}", 416: f"bytes */{END}", 200: None}[status]
    assert headers.get("Content-Range") == reported
    if status != 416:
        assert (headers["Accept-Ranges"], headers["Content-Type"]) == ("bytes", "video/mp4")


def test_ranges_are_of_this_version_and_of_content(viewer: LocalServer) -> None:
    film = "/TOKEN/enhance/a%20b+%C3%A9.mp4"
    assert answered(viewer, film, "Range: bytes=5-9", 'If-Range: "x"')[0] == 200
    status, headers, content = answered(viewer, film, "Range: bytes=5-9", method="HEAD")
    assert (status, headers["Content-Length"], content) == (200, str(END), b"")
    assert answered(viewer, "/TOKEN/empty.txt")[::2] == (200, b"")
    assert answered(viewer, "/TOKEN/empty.txt", "Range: bytes=0-")[0] == 416


def test_a_browser_that_breaks_off_is_no_fault(viewer: LocalServer, scene: Path) -> None:
    with (scene / "long.mkv").open("wb") as file:
        file.truncate(50_000_000)
    for sent in (
        f"GET /{viewer.token}/long.mkv HTTP/1.1\r\nHost: 127.0.0.1:{viewer.port}\r\n\r\n",
        f"GET /{viewer.token}/lo",
        "",
    ):
        plug = connection(viewer)
        plug.sendall(sent.encode())
        time.sleep(0.2)
        # Closing so resets the connection, as a browser does that no longer wants a film.
        plug.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        plug.close()
    assert answered(viewer, "/TOKEN/report/")[2] == PAGE


@pytest.mark.parametrize("sent", [b"", b"GET /", b"GET / HTTP/1.1\r\nHost: x\r\n", "all of it and no reading"])
def test_who_says_or_reads_nothing_is_let_go(
    viewer: LocalServer, scene: Path, monkeypatch: pytest.MonkeyPatch, sent: bytes | str
) -> None:
    monkeypatch.setattr(module, "IDLE_S", 0.3)
    with (scene / "long.mkv").open("wb") as file:
        file.truncate(50_000_000)
    with connection(viewer) as plug:
        whole = f"GET /{viewer.token}/long.mkv HTTP/1.1\r\nHost: 127.0.0.1:{viewer.port}\r\n\r\n"
        plug.sendall(whole.encode() if isinstance(sent, str) else sent)
        until = time.monotonic() + 10
        while not viewer.server_state.connections:
            time.sleep(0.01)
        while viewer.server_state.connections:
            assert time.monotonic() < until, "its connection is still there"
            time.sleep(0.05)
    assert answered(viewer, "/TOKEN/report/")[2] == PAGE


@pytest.mark.parametrize("sent", [b"\r\n\r\n", b"\0\0\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/x\r\n\r\n", b"x" * 70000])
def test_what_is_no_request_is_answered_or_dropped_without_a_stack(viewer: LocalServer, sent: bytes) -> None:
    with connection(viewer) as plug:
        plug.sendall(sent)
        plug.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionError):
            assert b"root:" not in b"".join(iter(lambda: plug.recv(1 << 16), b""))
    assert answered(viewer, "/TOKEN/report/")[2] == PAGE
