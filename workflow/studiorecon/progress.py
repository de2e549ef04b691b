# SPDX-License-Identifier: Apache-2.0
"""The messages of a step: one sentence per decision, a bar on a terminal, plain lines in a log.

All of it goes through the standard library's logger ``studiorecon``: sentences are INFO and shown, the progress of a
loop is DEBUG and only in the step's log file.
"""

from __future__ import annotations

import logging
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from studiorecon.errors import printable

T = TypeVar("T")

WARNING = "warning: "
"""First word of a line of a log that ``warn`` wrote."""
LOGGER = logging.getLogger("studiorecon")
LATEST = "latest.jpg"
"""The newest picture of a training that is on, in its working folder; it goes with the training's end."""
RUN = "STUDIORECON_RUN"
"""Environment variable of a run's steps: ``bar`` if the run draws its bar on this terminal, otherwise ``lines``. The
run lists the warnings at its end, so that its steps do not show them.
"""
CLEAR_LINE = "\r\x1b[K"
"""Terminal code that clears the line and returns to its start."""
_LOG_EVERY_S = 10.0


class _Shown(logging.Handler):
    """Standard output as it is at the time of a message, even if it has been replaced.

    While a run draws its bar, every sentence is one line of the terminal, in the bar's place; the log has the full
    text.
    """

    def emit(self, record: logging.LogRecord) -> None:
        beside = os.environ.get(RUN, "")
        if beside and str(record.msg).startswith(WARNING):
            return
        text = self.format(record)
        if beside == "bar" and sys.stdout.isatty():
            text = f"{CLEAR_LINE}{shorten(text, shutil.get_terminal_size().columns - 1)}"
        # One write with its line end: Python flushes after a carriage return, and the bar would be drawn in between.
        print(f"{text}\n", end="", flush=True)


def shorten(text: str, columns: int) -> str:
    """The text on one line of at most ``columns``, cut at its end."""
    line = " ".join(text.split())
    return line if len(line) <= columns else f"{line[: columns - 1]}…"


def wrap_on_terminal(text: str) -> str:
    """The text for standard error: on a terminal its long lines are wrapped between words, indented below their start;
    elsewhere it is unchanged."""
    if not sys.stderr.isatty():
        return text
    columns = shutil.get_terminal_size().columns - 1
    lines = []
    for line in text.split("\n"):
        indent = (len(line) - len(line.lstrip()) + 2) * " "
        lines += textwrap.wrap(
            line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return "\n".join(lines)


def _shown(step: str) -> logging.Handler:
    handler = _Shown(logging.INFO)
    handler.setFormatter(logging.Formatter(f"{step.replace('%', '%%')}: %(message)s"))
    return handler


class _StepLog(logging.FileHandler):
    """A step's log; after a failed write, as on a full disk, it warns once and then only shows messages."""

    def handleError(self, record: logging.LogRecord) -> None:
        if self.level <= logging.CRITICAL:
            self.setLevel(logging.CRITICAL + 1)
            print(f"the log {self.baseFilename} cannot be written ({sys.exc_info()[1]})", file=sys.stderr, flush=True)


LOGGER.setLevel(logging.DEBUG)
LOGGER.propagate = False
LOGGER.handlers = [_shown("studiorecon")]


@contextmanager
def log_to(step: str, log: Path | None) -> Iterator[None]:
    """Context in which sentences are shown with the step's name before them, and written to ``log`` without it."""
    before, LOGGER.handlers = LOGGER.handlers, [_shown(step)]
    if log is not None:
        log.parent.mkdir(parents=True, exist_ok=True)
        LOGGER.addHandler(_StepLog(log, "w", encoding="utf-8"))
    try:
        yield
    finally:
        for handler in LOGGER.handlers:
            handler.close()
        LOGGER.handlers = before


def say(sentence: str) -> None:
    """Print one sentence, and write it to the log of the running step."""
    LOGGER.info(printable(sentence))


def warn(sentence: str) -> None:
    """Print a fact that a user needs before trusting the result; the page lists every such line of a run's logs."""
    say(f"{WARNING}{sentence}")


def fail(text: str) -> None:
    """Print the reason why a step ends without a result to standard error, and write it to its log."""
    print_error(text)
    LOGGER.debug(text)


def print_error(text: str) -> None:
    """Print to standard error, in the place of a run's bar if there is one."""
    beside_bar = os.environ.get(RUN) == "bar" and sys.stderr.isatty()
    print(f"{CLEAR_LINE if beside_bar else ''}{wrap_on_terminal(text)}\n", end="", file=sys.stderr, flush=True)


def progress(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """The items, one by one, with a progress bar on a terminal.

    The run's own bar replaces it; the log gets a plain line every ten seconds.
    """
    if total is None and isinstance(items, Sized):
        total = len(items)
    if sys.stderr.isatty() and RUN not in os.environ:
        # Imported late: it takes half as long as numpy, at the start of every step.
        from tqdm import tqdm

        items = tqdm(items, desc=what, total=total, leave=False, file=sys.stderr)
    logged_s = time.monotonic()
    for done, item in enumerate(items, start=1):
        yield item
        if time.monotonic() - logged_s > _LOG_EVERY_S:
            logged_s = time.monotonic()
            LOGGER.debug(f"{what}: {done} of {total}" if total else f"{what}: {done}")
