# SPDX-License-Identifier: Apache-2.0
"""A person whose Gaussians grow in number: each descends from one of the start, and carries what belongs to it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import Avatar, read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.humans import train
from studiorecon.splatting.train.optimiser import Adam

from tests.made.humans import WH, Made, body, made, score
from tests.made.scene import ring
from tests.made.steps import call

__all__ = ["body", "made"]

COUNT = 150


@pytest.fixture
def trained(made: Made, body: BodyModel, default_settings: Callable, tmp_path: Path) -> Callable[..., Avatar]:
    def run(name: str, densify: dict[str, Any], **temporal: Any) -> Avatar:
        section = copy.deepcopy(default_settings("humans", iterations=400, gaussians=COUNT))
        section["rates"]["pose_rad"] = 0.0
        section["temporal"] |= {"use": "never"} | temporal
        section["densify"] |= densify
        settings = settings_module.load(train.Settings, section, "humans")
        folder = tmp_path / name
        folder.mkdir()
        written = {"gaussians": folder / "p3.ply", "avatar": folder / "p3.npz", "working": folder / "working"}
        call(train.run, settings, **made.options, **written)
        return read_avatar(folder / "p3.ply", folder / "p3.npz", body)

    return run


def test_too_few_gaussians_grow_until_the_last_step_and_show_more(
    trained: Callable[..., Avatar], made: Made, body: BodyModel, tmp_path: Path
) -> None:
    plain = trained("plain", {"use": "none"})
    grown = trained("grown", {"use": "gradient", "every": 40, "until": 120})
    assert plain.gaussians.count == COUNT
    assert grown.gaussians.count > 1.3 * COUNT
    for own in (grown.bones, grown.weights, grown.provenance):
        assert len(own) == grown.gaussians.count
    between = ring([45, 200], "view", wh=WH)
    assert score(made, body, tmp_path / "grown", between) > score(made, body, tmp_path / "plain", between) + 0.2
    # A Gaussian lies where the body's bones that carry it are: the offspring of a foot is no hand.
    foot = grown.weights[np.arange(len(grown.bones)), 0] > 0.9
    foot &= np.isin(grown.bones[:, 0], [7, 8])
    assert foot.any()
    height = grown.gaussians.means_m[:, 1]
    assert height[foot].max() < np.quantile(height, 0.4)


def test_the_temporal_network_sees_those_that_were_added(trained: Callable[..., Avatar]) -> None:
    grown = {"use": "gradient", "every": 40, "until": 120}
    found = trained("always", grown, use="always", start=60, width=8, points=0)
    assert found.gaussians.count > COUNT
    assert found.network is not None
    with pytest.raises(UserError, match="set points to 0"):
        trained("points", grown, use="always", points=64)


def test_adam_keeps_what_stays_and_forgets_what_is_new() -> None:
    rng = np.random.default_rng(0)
    values = {"a": rng.normal(size=(4, 3)).astype(np.float32), "b": rng.normal(size=4).astype(np.float32)}
    adam = Adam(values, (0.9, 0.999), 1e-15)
    adam.step({name: rng.normal(size=v.shape).astype(np.float32) for name, v in values.items()}, {"a": 0.1, "b": 0.1})
    parent, fresh = np.array([3, 1, 1]), np.array([False, False, True])
    other = adam.regrown({name: value[parent] for name, value in values.items()}, parent, fresh)
    before, after = adam.arrays(), other.arrays()
    for name, shape in (("a", (-1, 3)), ("b", (-1, 1))):
        assert after[f"steps.{name}"] == before[f"steps.{name}"] == 1
        for kind in ("first", "second"):
            old, new = before[f"{kind}.{name}"].reshape(shape), after[f"{kind}.{name}"].reshape(shape)
            np.testing.assert_array_equal(new[:2], old[parent[:2]])
            assert old[1].all()
            assert not new[2].any()
