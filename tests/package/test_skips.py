# SPDX-License-Identifier: Apache-2.0
"""A skipped test is told, and fails where nobody allowed it."""

from __future__ import annotations

import pytest

from tests import skips


@pytest.mark.parametrize(
    ("name", "reason", "fine"),
    [
        ("tests/gpu/test_a.py", "Skipped: no CUDA device", True),
        ("tests/gpu/test_a.py::test_b[x]", "Skipped: no CUDA device", True),
        ("tests/gpu/test_a.py", "Skipped: it was red", False),
        ("tests/other/test_a.py", "Skipped: no CUDA device", False),
    ],
)
def test_a_skip_needs_its_test_and_its_reason(name: str, reason: str, fine: bool) -> None:
    allowed = skips.allowed_skips(["# comment", "", "tests/gpu/* | no CUDA device", "tests/other/* |"])
    found, refused = skips.sorted_out([(name, reason)], allowed)
    assert bool(found) == fine
    assert bool(refused) != fine
