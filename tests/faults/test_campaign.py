# SPDX-License-Identifier: Apache-2.0
"""The campaign's own measure of memory sees what a reader holds meanwhile, and lets go of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.faults.campaign import most_held_mb


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux tells")
def test_memory_that_is_held_for_a_moment_is_seen() -> None:
    before = most_held_mb(anew=True)
    np.ones(20_000_000, np.float64).sum()
    assert most_held_mb() - before > 140
    assert most_held_mb(anew=True) - before < 60
