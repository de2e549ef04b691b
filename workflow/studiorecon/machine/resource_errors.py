# SPDX-License-Identifier: Apache-2.0
"""Explains the machine's refusals in a sentence: disks that are full, closed or failing, memory, open files."""

from __future__ import annotations

import errno
import re
import resource
from pathlib import Path

_KEPT = "finished results are kept"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS)
_FAILING = (errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.ENODEV, errno.ENOTCONN)
_NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP)
_OPEN = (errno.EMFILE, errno.ENFILE)
# A thread that cannot be started gives EAGAIN ("try again").
_NO_MEMORY = (errno.ENOMEM, errno.EAGAIN)
_STARVED = (
    "failed to map segment",
    "annot allocate memory",
    "start new thread",
    "bad_alloc",
    "Failed to allocate memory",
    "Available memory of",
    "process pool was terminated abruptly",
)
# Share of the memory limit from which a failure is attributed to it: the size of the failed allocation is unknown.
_MAX = 0.8


def lacks_thread(error: BaseException) -> bool:
    """Whether a decoder could not start a thread, because memory or processes are limited.

    Lack of memory does not count: a damaged file may request any amount.
    """
    return isinstance(error, OSError) and error.errno == errno.EAGAIN


def is_memory_error(error: BaseException) -> bool:
    """Whether ``error`` is a sign of too little memory, of Python or one of the libraries, or a killed process."""
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _NO_MEMORY):
        return True
    if type(error).__module__ == "cv2":
        # OpenCV's code for a failed allocation.
        return getattr(error, "code", None) == -4
    # Some libraries name the missing shared object in their own message, which follows the system's.
    text = f"{error} {error.__context__}"
    return any(words in text for words in _STARVED)


def describe_resource_error(error: BaseException) -> str | None:
    """The machine's refusal and a remedy, if ``error`` is one; None for any other error."""
    if is_memory_error(error):
        return (
            f"there is not enough memory ({_first_line(error) or 'it did not say for what'}); run fewer jobs at once "
            f"(--cores 1), or make pictures smaller (capture.width); {_KEPT}"
        )
    number = error.errno if isinstance(error, OSError) else None
    where = f"{error.filename}: " if isinstance(error, OSError) and error.filename else ""
    why = f"{where}{getattr(error, 'strerror', None) or _first_line(error)}"
    if number in _FULL:
        return f"the disk is full ({why}); make room and run again: {_KEPT}"
    if number in _CLOSED:
        return f"this may not be read or written ({why}); change its permissions and run again: {_KEPT}"
    if number in _FAILING:
        return f"the disk or its network does not answer ({why}); when it does, run again: {_KEPT}"
    if number in _NO_NAME:
        return f"{_shorten(why)}: this name leads to no file; name another one"
    if number in _OPEN:
        return f"too many files are open ({why}); allow more (ulimit -n 4096), and run again: {_KEPT}"
    if isinstance(error, EOFError | ValueError) and _cuts_byte_code(error):
        return (
            "Python's compiled files were cut short, which a full disk does; make room, delete every __pycache__ of "
            f"the environment and the folder .snakemake/bytecode, and run again: {_KEPT}"
        )
    return None


def memory_note() -> str | None:
    """A hint for any error in a process that has used most of its memory limit (ulimit -v); None without a limit."""
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    try:
        found = re.search(r"^VmPeak:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="utf-8"), re.M)
    except OSError:  # no Linux
        return None
    if allowed == resource.RLIM_INFINITY or found is None or int(found.group(1)) * 1024 < _MAX * allowed:
        return None
    return f"this process may use {allowed / 1e6:.0f} MB of memory (ulimit -v) and has used nearly all of it"


def _cuts_byte_code(error: BaseException) -> bool:
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    return at is not None and at.tb_frame.f_code.co_filename == "<frozen importlib._bootstrap_external>"


def _shorten(text: str) -> str:
    """The ends of a long text: names may have thousands of characters."""
    return text if len(text) < 200 else f"{text[:60]} … {text[-80:]}"


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), "")
