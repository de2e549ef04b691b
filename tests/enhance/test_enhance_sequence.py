# SPDX-License-Identifier: Apache-2.0
"""enhance: cuts, and clips that stand still."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.enhance.backends import Unchanged
from studiorecon.errors import UserError
from studiorecon.recursive.sequence import is_still
from studiorecon.scene.path import PathStep

from tests.made.enhance_sequence import VIEW, panning, played


def test_a_cut_starts_the_injection_anew(capsys: pytest.CaptureFixture) -> None:
    first, second = panning(5, 3), panning(5, 4)
    together, alone = played(first + second, Unchanged()), played(second, Unchanged())
    for a, b in zip(together[5:], alone, strict=True):
        np.testing.assert_array_equal(a, b)
    assert "picture 5 of segment a follows a cut" in "".join(capsys.readouterr())
    played(first, Unchanged())
    assert "cut" not in "".join(capsys.readouterr()), "panning is no cut"


def test_pictures_of_two_sizes_are_refused() -> None:
    pictures = [*panning(2), np.zeros((32, 48, 3), np.uint8)]
    with pytest.raises(UserError, match="picture 2 of segment a is 48x32 and the one before it 96x64"):
        played(pictures, Unchanged())


def test_only_clips_without_motion_stand_still() -> None:
    steps = [PathStep(VIEW, 0.0, "a")] * 2 + [PathStep(VIEW, 0.0, "b")] * 2
    a, b = np.full((64, 96, 3), 50, np.uint8), np.full((64, 96, 3), 90, np.uint8)
    assert is_still(steps, [a, a, b, b]), "another segment is another clip"
    assert not is_still(steps, [a, b, b, b])
    assert is_still(steps[:1], [a])
