# SPDX-License-Identifier: Apache-2.0
"""What a machine refuses becomes a sentence, and nothing else does."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.machine.resource_errors import describe_resource_error, is_memory_error, lacks_thread


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (errno.ENOSPC, "the disk is full (a/b.npz: No space left on device); make room"),
        (errno.EDQUOT, "the disk is full (a/b.npz: "),
        (errno.EROFS, "this may not be read or written (a/b.npz: Read-only file system)"),
        (errno.EACCES, "this may not be read or written (a/b.npz: Permission denied)"),
        (errno.EIO, "the disk or its network does not answer (a/b.npz: "),
        (errno.ESTALE, "the disk or its network does not answer (a/b.npz: "),
        (errno.ENAMETOOLONG, "a/b.npz: File name too long: this name leads to no file"),
        (errno.ELOOP, "a/b.npz: Too many levels of symbolic links: this name leads to no file"),
        (errno.EMFILE, "too many files are open (a/b.npz: "),
        (errno.ENOMEM, "there is not enough memory ("),
    ],
)
def test_what_the_system_refuses_is_said_with_the_file(number: int, says: str) -> None:
    sentence = describe_resource_error(OSError(number, os.strerror(number), "a/b.npz"))
    assert sentence is not None
    assert sentence.startswith(says)
    assert sentence.endswith(("finished results are kept", "name another one"))


def test_memory_that_is_missing_is_known_from_the_error() -> None:
    with pytest.raises(MemoryError) as requested:
        np.zeros(2**60, np.uint8)
    assert "there is not enough memory (Unable to allocate 1.00 EiB" in str(describe_resource_error(requested.value))
    with pytest.raises(cv2.error) as asked_by_opencv:
        cv2.copyMakeBorder(np.zeros((1, 1, 3), np.float64), 2**30, 2**30, 2**30, 2**30, cv2.BORDER_REPLICATE)
    assert is_memory_error(asked_by_opencv.value) == (asked_by_opencv.value.code == -4)
    for words in ("can't start new thread", "x.so: failed to map segment from shared object", "std::bad_alloc"):
        assert is_memory_error(RuntimeError(words))
        assert "there is not enough memory" in str(describe_resource_error(ImportError(words)))


def test_a_damaged_film_that_asks_for_any_amount_is_not_the_machine_s_fault() -> None:
    assert lacks_thread(BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"))
    assert not lacks_thread(OSError(errno.ENOMEM, "Cannot allocate memory"))


@pytest.mark.parametrize(
    "error", [ValueError("bad"), OSError(errno.ENOENT, "No such file"), KeyError("x"), OSError("no number"), EOFError()]
)
def test_a_fault_of_the_program_stays_one(error: Exception) -> None:
    assert describe_resource_error(error) is None


def test_compiled_files_that_a_full_disk_cut_short_are_named(tmp_path: Path) -> None:
    """Python 3.11 keeps what a full disk let it write of them, and would fail for ever after."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"PYTHONPYCACHEPREFIX": str(tmp_path)}
    command = [sys.executable, "-m", "studiorecon", "calibration.files", "--help"]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    damaged = next(path for path in tmp_path.rglob("*.pyc") if "calibration/files." in path.as_posix())
    damaged.write_bytes(damaged.read_bytes()[:200])
    done = subprocess.run(command, env=environment, text=True, capture_output=True)
    assert done.returncode == 1
    assert "calibration.files: Python's compiled files were cut short" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_step_whose_memory_is_limited_says_that_this_may_be_why() -> None:
    for limit, messages in ((2**28, "this process may use 268 MB of memory (ulimit -v)"), (2**44, "None")):
        script = f"""if True:
            import resource
            from studiorecon.machine import resource_errors as machine
            bytearray(2**28)
            resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))
            print(machine.memory_note())
        """
        done = subprocess.run([sys.executable, "-c", script], text=True, capture_output=True)
        assert done.stdout.startswith(messages), done.stderr
