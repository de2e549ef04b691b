# SPDX-License-Identifier: Apache-2.0
"""Threads that run at once give what one thread gives that does their shares one after another."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.splatting.several_threads import checksums


def test_threads_at_once_give_the_bytes_of_one_that_does_all_shares(root: Path) -> None:
    # Workers of this run have one thread each (tests/conftest.py); these are those that every step takes (__main__).
    done = subprocess.run(
        [sys.executable, "-m", "tests.splatting.several_threads"],
        cwd=root,
        env=os.environ | {"NUMBA_NUM_THREADS": "3", "NUMBA_THREADING_LAYER": "workqueue"},
        text=True,
        stdout=subprocess.PIPE,
        check=True,
    )
    told = json.loads(done.stdout)
    assert told["threads"] == 3
    assert told["checksums"] == [checksums(n) for n in (1, 2, 3)]
    assert told["checksums"][0] != told["checksums"][2], "the shares make no difference here"
