# SPDX-License-Identifier: Apache-2.0
"""Fault injection: a random 1 % of what training is given becomes NaN, infinite or 0; it ends, counts, and the rest is
as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.train import state
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.still import train_still as train
from studiorecon.splatting.train.targets import Target

from tests.made.splatting_settings import SETTINGS
from tests.made.splatting_training import lesson, psnr_db

__all__ = ["lesson"]

POISONS = {"NaN": np.nan, "inf": np.inf, "minus inf": -np.inf, "zero": 0.0}
SHORT = replace(SETTINGS, iterations=80)


def one_percent(shape: tuple[int, ...], seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random(shape) < 0.01


def controlled(densify: str) -> TrainingSettings:
    return replace(SHORT, densify=densify, densify_every=20, densify_from=20, densify_until=60)


@pytest.fixture(scope="module")
def clean_db(lesson: tuple[Gaussians, list[Target]]) -> dict[str, float]:
    """PSNR without faults by density control, dB."""
    begin, targets = lesson
    runs = {
        d: train(begin, targets, controlled(d), np.random.default_rng(0), extent_m=1.0, threads=1)
        for d in ("none", "gradient")
    }
    return {densify: psnr_db(run.gaussians, targets) for densify, run in runs.items()}


# Every field once. Density control reads positions and scales.
POISONED = [
    ("means_m", "gradient", "NaN"),
    ("log_scales", "gradient", "inf"),
    ("quaternions", "none", "zero"),
    ("logit_opacities", "none", "minus inf"),
    ("sh", "none", "inf"),
]


@pytest.mark.parametrize(("field", "densify", "poison"), POISONED)
def test_a_hundredth_of_the_gaussians_is_poisoned(
    lesson: tuple[Gaussians, list[Target]], clean_db: dict[str, float], field: str, poison: str, densify: str
) -> None:
    begin, targets = lesson
    values = getattr(begin, field).copy()
    hit = one_percent((begin.count,), 1)
    assert hit.sum() > 5
    values[hit] = POISONS[poison]
    trained = train(
        replace(begin, **{field: values}),
        targets,
        controlled(densify),
        np.random.default_rng(0),
        extent_m=1.0,
        threads=1,
    )
    assert trained.left_out == (0 if poison == "zero" else hit.sum())
    assert state.finite_mask(trained.gaussians).all()
    assert len(trained.source) == trained.gaussians.count
    if poison != "zero":
        assert not np.isin(np.flatnonzero(hit), trained.source).any(), "labels still belong to whom they belonged"
    assert psnr_db(trained.gaussians, targets) > clean_db[densify] - 1.5


@pytest.mark.parametrize(("what", "poison"), [("rgb", "NaN"), ("rgb", "zero"), ("weight", "inf")])
def test_a_hundredth_of_the_pixels_is_poisoned(
    lesson: tuple[Gaussians, list[Target]], clean_db: dict[str, float], what: str, poison: str
) -> None:
    begin, targets = lesson
    hits = [one_percent(t.camera.hw, i) for i, t in enumerate(targets)]
    whole = [replace(t, weight=np.ones(t.camera.hw, np.float32)) for t in targets]
    bad = []
    for target, hit in zip(whole, hits):
        values = getattr(target, what).copy()
        values[hit] = POISONS[poison]
        bad.append(replace(target, **{what: values}))
    trained = train(begin, bad, SHORT, np.random.default_rng(0), extent_m=1.0, threads=1)
    assert trained.masked == (sum(int(hit.sum()) for hit in hits) if poison != "zero" else 0)
    assert trained.refused == trained.left_out == 0
    assert np.isfinite(trained.psnr_db)
    assert state.finite_mask(trained.gaussians).all()
    # A black pixel in a hundred is a wrong picture that nobody can tell from a right one: it costs more than a masked
    # one.
    assert psnr_db(trained.gaussians, targets) > clean_db["none"] - (3.0 if poison == "zero" and what == "rgb" else 1.0)


def test_nothing_but_poison_is_refused(lesson: tuple[Gaussians, list[Target]]) -> None:
    begin, targets = lesson
    with pytest.raises(UserError, match="0 finite Gaussians"):
        train(
            replace(begin, means_m=np.full_like(begin.means_m, np.nan)),
            targets,
            SHORT,
            np.random.default_rng(0),
            extent_m=1.0,
        )
