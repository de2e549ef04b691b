# SPDX-License-Identifier: Apache-2.0
"""A browser without a window that reaches no host but this one, driven through a pipe by Chromium's own protocol."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BROWSER = next(
    (found for name in ("chromium-headless-shell", "chromium", "google-chrome") if (found := shutil.which(name))), None
)
NO_BROWSER = "no Chromium on this machine (apt-get install chromium-headless-shell)"
_QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]
SOFTWARE_GL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")


class Browser:
    """One page of a browser.

    Args:
        profile: a folder of its own.
        group: folder of a control group that it runs in.

    Attributes:
        logged: what the page logged or threw.
        asked: addresses it asked for.
    """

    def __init__(
        self, profile: Path, *options: str, size: tuple[int, int] = (480, 300), group: Path | None = None
    ) -> None:
        assert BROWSER is not None
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        # The browser reads descriptor 3 and writes 4.
        joined = f"echo $$ > {group}/cgroup.procs; " if group else ""
        script = f'{joined}exec "$@" 3<&{to_read} 4>&{to_write}'
        command = [BROWSER, *_QUIET, *options, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        command += ["--remote-debugging-pipe", "about:blank"]
        self._process = subprocess.Popen(
            ["bash", "-c", script, "bash", *command],
            pass_fds=(to_read, to_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._waiting, self._number, self._session = b"", 0, ""
        self.logged: list[str] = []
        self.requested: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *failure: object) -> None:
        os.close(self._write)
        self._process.kill()
        self._process.wait()
        os.close(self._read)

    def call(self, method: str, timeout_s: float = 120, **parameters: Any) -> dict[str, Any]:
        """One command of the protocol and its answer; RuntimeError with what the browser says against it."""
        self._number += 1
        number, until = self._number, time.monotonic() + timeout_s
        message = {"id": number, "method": method, "params": parameters}
        os.write(
            self._write, json.dumps(message | ({"sessionId": self._session} if self._session else {})).encode() + b"\0"
        )
        while time.monotonic() < until:
            answer = self._next()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
        raise TimeoutError(f"{method} took more than {timeout_s} s")

    def open(self, page: str) -> None:
        """Load an address and wait until it stands."""
        self.call("Page.navigate", url=page)
        self.wait("document.readyState === 'complete'")

    def run(self, script: str, timeout_s: float = 120) -> Any:
        """The value of an expression, which may be a promise, in the page."""
        answer = self.call(
            "Runtime.evaluate", timeout_s, expression=script, awaitPromise=True, returnByValue=True, userGesture=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"].get("exception", {}).get("description", str(answer)))
        return answer["result"].get("value")

    def wait(self, script: str, timeout_s: float = 60) -> None:
        """Wait until an expression is true."""
        until = time.monotonic() + timeout_s
        while not self.run(script):
            if time.monotonic() > until:
                raise TimeoutError(f"{script} was not true within {timeout_s} s; logged: {self.logged}")
            time.sleep(0.05)

    def screenshot(self) -> bytes:
        """The page as a PNG file."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._waiting:
            more = os.read(self._read, 1 << 20)
            if not more:
                raise RuntimeError("the browser ended")
            self._waiting += more
        raw, _, self._waiting = self._waiting.partition(b"\0")
        message = json.loads(raw)
        reported = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.logged.append(str(reported["exceptionDetails"].get("exception", {}).get("description", reported)))
        elif message.get("method") == "Runtime.consoleAPICalled":
            self.logged.append(" ".join(str(one.get("value", one.get("description"))) for one in reported["args"]))
        elif message.get("method") == "Log.entryAdded":
            self.logged.append(f"{reported['entry']['text']} {reported['entry'].get('url', '')}")
        elif message.get("method") == "Network.requestWillBeSent":
            self.requested.append(reported["request"]["url"])
        return message


def pixels(browser: Browser, script: str) -> np.ndarray:
    """(H, W, 3) uint8 of an expression that gives ``{width, height, pixels}``, four bytes a pixel."""
    found = browser.run(
        f"""(async () => {{
        const {{ width, height, pixels }} = await ({script});
        let text = "";
        for (let i = 0; i < pixels.length; i += 32768) text += String.fromCharCode(...pixels.subarray(i, i + 32768));
        return {{ width, height, text: btoa(text) }};
    }})()"""
    )
    raw = np.frombuffer(base64.b64decode(found["text"]), np.uint8)
    return raw.reshape(found["height"], found["width"], 4)[..., :3]


def software_gl(folder: Path, *options: str, size: tuple[int, int] = (480, 300)) -> Browser:
    """A browser whose WebGL2 is drawn by the processor."""
    return Browser(folder, *SOFTWARE_GL, *options, size=size)


def addresses_outside(requested: Sequence[str]) -> list[str]:
    """Of the addresses that a page asked for those that are no part of it."""
    return [one for one in requested if not one.startswith(("file:", "blob:", "data:", "about:"))]


@contextmanager
def memory_limited(most_bytes: int) -> Iterator[Path]:
    """Folder of a control group whose processes together get no more memory; skips where none can be made."""
    name = f"studiorecon-{os.getpid()}"
    for above, limit in (
        (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),
        (Path("/sys/fs/cgroup"), "memory.max"),
    ):
        folder = above / name
        try:
            folder.mkdir()
        except OSError:
            continue
        try:
            if not (folder / limit).exists():
                continue
            (folder / limit).write_text(str(most_bytes))
            yield folder
            return
        finally:
            _without_processes(folder)
    pytest.skip("no control group with a limit of memory can be made here (needs root)")


def _without_processes(group: Path) -> None:
    """Take a control group away once its processes are gone."""
    until = time.monotonic() + 20
    while True:
        try:
            group.rmdir()
            return
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)
