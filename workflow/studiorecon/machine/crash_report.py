# SPDX-License-Identifier: Apache-2.0
"""Describes a fault of the program in one sentence: its place, the file that was being read, and how to report it."""

from __future__ import annotations

import os
import traceback
from pathlib import Path
from types import FrameType

_FORM = ".github/ISSUE_TEMPLATE/wrong.yml"
_PACKAGE = Path(__file__).parents[1]
FAULTS = Path("logs/fault.log")
"""File for the trace of a fault outside a step's log."""


def fault_sentence(error: BaseException, log: Path | None) -> str:
    """The sentence for a user about ``error``, which is no ``UserError``; ``log`` is the file that holds its trace."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    lines = [line for _, line in traceback.walk_tb(error.__traceback__)]
    ours = [k for k, frame in enumerate(frames) if Path(frame.f_code.co_filename).is_relative_to(_PACKAGE)]
    what = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    place = ""
    if ours:
        file = Path(frames[ours[-1]].f_code.co_filename).relative_to(_PACKAGE)
        place = f" in {file.as_posix()}, line {lines[ours[-1]]}"
    read = _file_at_hand(frames)
    return (
        f"a fault of the program, not of your files ({what}{place}{f', while reading {read}' if read else ''}); please "
        f"report it by the form {_FORM}{f', with {log}, which has the whole trace' if log else ''}"
    )


def keep_trace(error: BaseException) -> Path | None:
    """``FAULTS`` with the trace of ``error`` added; None where it cannot be written."""
    try:
        FAULTS.parent.mkdir(exist_ok=True)
        with FAULTS.open("a", encoding="utf-8") as file:
            file.write("".join(traceback.format_exception(error)) + "\n")
    except OSError:
        return None
    return FAULTS


def _file_at_hand(frames: list[FrameType]) -> Path | None:
    """The file that the innermost function with a file argument was working on."""
    for frame in reversed(frames):
        for value in reversed(list(frame.f_locals.values())):
            if isinstance(value, Path) and not value.is_relative_to(_PACKAGE) and os.path.exists(value):
                return value
    return None
