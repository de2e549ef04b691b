# SPDX-License-Identifier: Apache-2.0
"""The latest picture of a training: there while it is on, at most 2 % of its time, and gone at its end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.progress import LATEST
from studiorecon.splatting.train import previews
from studiorecon.splatting.train.previews import Feedback


def test_a_slow_picture_comes_seldom_and_the_last_one_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, drawn_s, drawing_s = 0.0, [], 0.5

    class Clock:
        @staticmethod
        def monotonic() -> float:
            return now_s

    def draw() -> np.ndarray:
        nonlocal now_s
        drawn_s.append(now_s)
        now_s += drawing_s
        return np.full((4, 6, 3), 0.5, np.float32)

    monkeypatch.setattr(previews, "time", Clock)
    feedback = Feedback("room", 0, 1000, tmp_path)
    for _ in range(1000):
        feedback.show_latest(draw)
        now_s += 0.1
    assert drawn_s[0] == pytest.approx(3.0, abs=0.2), "somebody who waits sees something soon"
    assert len(drawn_s) * drawing_s < 0.025 * now_s
    assert (tmp_path / LATEST).read_bytes().startswith(b"\xff\xd8")
    feedback.end()
    assert list(tmp_path.iterdir()) == []
    Feedback("room", 0, 10, None).show_latest(draw)
