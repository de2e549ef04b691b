# SPDX-License-Identifier: Apache-2.0
"""What a step tells the world while it works: one sentence per decision, a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TextIO, TypeVar

from tqdm import tqdm

T = TypeVar("T")

WARNING = "warning: "
"""How a line of a log begins that ``warn`` wrote."""
_LOG_EVERY_S = 10.0


class Voice:
    """Where sentences go: standard output always, and the step's log file when the command line opened one."""

    def __init__(self) -> None:
        self.log: TextIO | None = None
        self.step = "studiorecon"

    def say(self, sentence: str) -> None:
        print(f"{self.step}: {sentence}", flush=True)
        if self.log is not None:
            print(sentence, file=self.log, flush=True)


VOICE = Voice()


def say(sentence: str) -> None:
    """Print one sentence, and write it to the log of the step that is running."""
    VOICE.say(sentence)


def warn(sentence: str) -> None:
    """Say what a user should know before trusting the result; the page lists every such line of a run's logs."""
    say(f"{WARNING}{sentence}")


def progress(items: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """The items, one by one, with a bar on a terminal and a plain line in the log every ten seconds."""
    if total is None and hasattr(items, "__len__"):
        total = len(items)
    bar = tqdm(items, desc=f"{VOICE.step}: {what}", total=total, leave=False, disable=not sys.stderr.isatty(), file=sys.stderr)
    told = time.monotonic()
    for done, item in enumerate(bar, start=1):
        yield item
        if VOICE.log is not None and time.monotonic() - told > _LOG_EVERY_S:
            told = time.monotonic()
            of = f" of {total}" if total else ""
            print(f"{what}: {done}{of}", file=VOICE.log, flush=True)
