# SPDX-License-Identifier: Apache-2.0
"""The latest picture of a training: there while it is on, at most 2 % of its time, and gone at its end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.progress import LATEST
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.train import previews
from studiorecon.splatting.train.previews import Feedback
from studiorecon.splatting.train.still import train_still
from studiorecon.splatting.train.targets import Target

from tests.made.splatting_settings import SETTINGS
from tests.made.splatting_training import FIELDS, lesson

__all__ = ["lesson"]


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


def test_pictures_change_nothing_of_the_result(
    lesson: tuple[Gaussians, list[Target]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin, targets = lesson
    settings, seen = replace(SETTINGS, iterations=12), []
    write = Feedback.show_latest
    monkeypatch.setattr(previews, "_MIN_EVERY_S", 0.0)
    monkeypatch.setattr(previews, "_SHARE", 0.0)

    def watched(self: Feedback, draw: object) -> None:
        write(self, draw)
        seen.append((tmp_path / LATEST).is_file())

    plain = train_still(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, threads=1)
    monkeypatch.setattr(Feedback, "show_latest", watched)
    shown = train_still(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, threads=1, previews=tmp_path)
    assert all(seen)
    assert len(seen) == 12
    for field in FIELDS:
        assert np.array_equal(getattr(plain.gaussians, field), getattr(shown.gaussians, field))
    assert not (tmp_path / LATEST).exists()
