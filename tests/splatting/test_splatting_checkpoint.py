# SPDX-License-Identifier: Apache-2.0
"""A killed training ends with the bytes of one that was not; a stale, foreign or broken checkpoint is left aside with a
sentence."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.progress import log_to
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.train.blocked_set import BlockedSet
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint
from studiorecon.splatting.train.still import TrainedGaussians
from studiorecon.splatting.train.still import train_still as train
from studiorecon.splatting.train.targets import Target
from studiorecon.splatting.train.terms import PlaneView

from tests.made.splatting_settings import SETTINGS
from tests.made.splatting_training import FIELDS, lesson

__all__ = ["lesson"]

ALWAYS = 1e-9  # seconds: a checkpoint after every step
VARIANTS = {"fixed number": {}, "gradient": {"densify": "gradient", "densify_every": 8, "densify_from": 8}}


class Killed(Exception):
    """Stands for the signal."""


def interrupted(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """The next training stops dead in the middle of its ``after``-th step."""
    step, done = BlockedSet.step, []

    def dying(run: BlockedSet, iteration: int, view: PlaneView, loss: float) -> tuple[float, float]:
        done.append(iteration)
        if len(done) == after:
            run.state.blocked.parameters[:] = 7.0  # half-done work must not be taken up
            raise Killed
        return step(run, iteration, view, loss)

    monkeypatch.setattr(BlockedSet, "step", dying)


def same(a: TrainedGaussians, b: TrainedGaussians) -> None:
    for name in FIELDS:
        assert getattr(a.gaussians, name).tobytes() == getattr(b.gaussians, name).tobytes(), name
    assert a.source.tobytes() == b.source.tobytes()
    assert (a.psnr_db, a.refused) == (b.psnr_db, b.refused)


@pytest.mark.parametrize("changes", [pytest.param(v, id=k) for k, v in VARIANTS.items()])
@pytest.mark.parametrize("after", [2, 14])
def test_a_run_taken_up_ends_with_the_same_bytes(
    lesson: tuple[Gaussians, list[Target]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, changes: dict, after: int
) -> None:
    begin, targets = lesson
    settings = replace(SETTINGS, iterations=30, **changes)

    def run(checkpoint: Checkpoint | None) -> TrainedGaussians:
        return train(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, threads=2, checkpoint=checkpoint)

    whole = run(None)
    with monkeypatch.context() as patch:
        interrupted(patch, after)
        with pytest.raises(Killed):
            run(Checkpoint(tmp_path / "state.npz", "mark", ALWAYS))
    steps: list[int] = []
    step = BlockedSet.step
    monkeypatch.setattr(BlockedSet, "step", lambda run, i, *more: (steps.append(i), step(run, i, *more))[1])
    same(run(Checkpoint(tmp_path / "state.npz", "mark", ALWAYS)), whole)
    assert steps == list(range(after - 1, 30)), "it went on where the checkpoint was"


def broken(path: Path, how: str) -> None:
    content = path.read_bytes()
    if how == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "one bit":
        middle = len(content) // 2
        path.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
    else:
        np.savez(path, something=np.zeros(3))


@pytest.mark.parametrize("how", ["truncated", "empty", "one bit", "another file"])
def test_a_broken_checkpoint_is_left_aside_with_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture, how: str
) -> None:
    path = tmp_path / "state.npz"
    checkpoint = Checkpoint(path, "mark", ALWAYS)
    checkpoint.save({"values": np.arange(10000.0)}, {"iteration": 3})
    arrays, facts = checkpoint.load()
    assert facts == {"iteration": 3}
    np.testing.assert_array_equal(arrays["values"], np.arange(10000.0))
    broken(path, how)
    assert checkpoint.load() is None
    assert "cannot be read" in capsys.readouterr().out


def test_other_settings_inputs_or_code_are_another_run(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    file = tmp_path / "input"
    file.write_bytes(b"one")
    mark = fingerprint(SETTINGS, [file], "code", 2)
    assert mark == fingerprint(SETTINGS, [file], "code", 2)
    others = [
        fingerprint(replace(SETTINGS, sh_lr=1e-3), [file], "code", 2),
        fingerprint(SETTINGS, [file], "edited", 2),
        fingerprint(SETTINGS, [file], "code", 1),
    ]
    file.write_bytes(b"two")
    others.append(fingerprint(SETTINGS, [file], "code", 2))
    assert len({mark, *others}) == 5
    Checkpoint(tmp_path / "state.npz", mark, ALWAYS).save({}, {"iteration": 1})
    assert Checkpoint(tmp_path / "state.npz", others[0], ALWAYS).load() is None
    assert "belongs to other settings" in capsys.readouterr().out


def test_a_checkpoint_is_due_by_time_and_removed_with_its_folder(tmp_path: Path) -> None:
    assert not Checkpoint(tmp_path / "a.npz", "mark", 0.0).due()
    assert not Checkpoint(tmp_path / "a.npz", "mark", 3600.0).due()
    first, second = (Checkpoint(tmp_path / ".checkpoint" / f"{name}.npz", "mark", ALWAYS) for name in "ab")
    first.save({}, {})
    second.save({}, {})
    first.remove()
    assert os.listdir(tmp_path / ".checkpoint") == ["b.npz"]
    second.remove()
    assert not (tmp_path / ".checkpoint").exists()
    second.remove()


def test_feedback_says_how_it_goes_and_paints_it(
    lesson: tuple[Gaussians, list[Target]], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    begin, targets = lesson
    settings = replace(SETTINGS, iterations=40)
    log, previews = tmp_path / "train.log", tmp_path / "previews"
    previews.mkdir()
    with log_to("train", log):
        train(begin, targets, settings, np.random.default_rng(0), extent_m=1.0, threads=1, previews=previews)
    lines = [line for line in log.read_text().splitlines() if " of 40" in line]
    assert len(lines) == 10, "every tenth is in the log"
    for word in ("40 of 40", "loss", "PSNR", "training view 0", "1200 Gaussians"):
        assert word in lines[-1]
    shown = [line for line in capsys.readouterr().out.splitlines() if " of 40" in line]
    assert shown == [f"train: {lines[-1]}"], "only how it ended is shown"
    pictures = sorted(previews.iterdir())
    assert [p.name for p in pictures] == [f"preview_{percent:03d}.png" for percent in range(10, 101, 10)]
    wanted, shown = np.split(cv2.imread(str(pictures[-1])).astype(float), 2, axis=1)
    early = np.split(cv2.imread(str(pictures[0])).astype(float), 2, axis=1)[1]
    assert np.abs(shown - wanted).mean() < np.abs(early - wanted).mean()
