# SPDX-License-Identifier: Apache-2.0
"""Effects of a trained scene: holes, flicker and what nobody saw are found where they are planted, and only there."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration.settings import load
from studiorecon.report import audit as step
from studiorecon.report.metrics.rendered_effects import (
    appearance,
    decide_refinement,
    density_px,
    thin_share,
)
from studiorecon.scene.decisions import Decision, read_decisions, write_decisions
from studiorecon.scene.effects import ENHANCEMENT, INJECTION
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.splatting.discs import discs

from tests.made.studio_world import looking

SEEDS = 20


class TestRefinement:
    @pytest.mark.parametrize(("hole", "verdict"), [(0.05, "on"), (0.0, "off")])
    def test_holes_are_found(self, hole: float, verdict: str) -> None:
        for seed in range(SEEDS):
            rng = np.random.default_rng(seed)
            alpha = np.where(rng.random((2, 80, 120)) < hole, 0.5, 0.99)
            assert decide_refinement(thin_share(alpha, np.ones_like(alpha)), 0.02).verdict == verdict

    def test_a_floor_that_few_gaussians_cover_is_thin(self) -> None:
        rng = np.random.default_rng(0)
        even = rng.uniform((0, 0), (120, 160), (80000, 2))
        thinned = even[(even[:, 1] < 140) | (rng.random(len(even)) < 0.1)]
        alpha = np.ones((1, 160, 120))
        found = [
            decide_refinement(thin_share(alpha, density_px(p, (160, 120))[None]), 0.02).verdict for p in (even, thinned)
        ]
        assert found == ["off", "on"]

    def test_without_views_nothing_is_said(self) -> None:
        nothing = np.full((1, 80, 120), np.nan)
        assert decide_refinement(thin_share(nothing, nothing), 0.02).verdict == "undetermined"

    def test_density_counts_what_is_in_the_picture(self) -> None:
        pixels = np.array([[4.0, 4.0], [4.5, 4.0], [12.0, 4.0], [-3.0, 4.0], [np.nan, np.nan]])
        found = density_px(pixels, (10, 20))
        assert found.shape == (10, 20)
        assert found[0, 0] * 64 == pytest.approx(2)
        assert found[0, 9] * 64 == pytest.approx(1)
        assert found[9].sum() == 0


def test_who_drifts_most_speaks_for_all_and_who_was_not_asked_for_nobody() -> None:
    drift = Decision("temporal_appearance", "s", 0.3, (0.25, 0.35), 0.1, "on", "p1's shirt")
    still = replace(drift, value=0.02, interval=(0.01, 0.03), verdict="off", reason="p0 is of stone")
    found = appearance({"p0": still, "p1": drift, "p2": None}, 0.1)
    assert (found.verdict, found.reason, set(found.detail)) == ("on", "p1's shirt", {"p0", "p1"})
    assert appearance({"p0": still}, 0.1).verdict == "off"
    assert appearance({"p0": replace(still, verdict="on")}, 0.1).verdict == "on", "what training did, not once more"
    assert found.obeyed_by
    assert appearance({"p0": None}, 0.1).verdict == "undetermined"
    assert appearance({}, 0.1).verdict == "undetermined"


def test_the_step_decides_and_can_be_forced(tmp_path: Path, default_settings) -> None:
    camera = looking("c0", np.array([3.0, 0, 1.5]), np.array([0, 0, 0.8]), (64, 48), 50.0)
    write_model(tmp_path / "cameras", [camera])
    # A floor without walls: most of what cameras 15 % higher and lower see is empty.
    x, y = np.meshgrid(np.arange(-1, 1, 0.1), np.arange(-1, 1, 0.1))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1)
    write_ply(
        tmp_path / "scene.ply",
        discs(points, np.tile([0, 0, 1.0], (len(points), 1)), np.full((len(points), 3), 0.5), 0.08, 0.1, 0.9, 0),
    )
    drift = Decision("temporal_appearance", "s", 0.3, (0.25, 0.35), 0.1, "on", "why")
    write_npz(tmp_path / "p0.npz", {"decision": json.dumps(asdict(drift))})
    calm = INJECTION.decide(0.01, (0.0, 0.02), "calm")
    told = {"orbit": [ENHANCEMENT.decide(0.3, (0.2, 0.4), "gains"), calm], "still": [calm], "elsewhere": []}
    for film, decisions in told.items():
        write_decisions(tmp_path / f"{film}.json", decisions)
    settings = load(step.Settings, default_settings("survey"), "survey")
    files = {
        "model": tmp_path / "cameras/images.txt",
        "background": tmp_path / "scene.ply",
        "avatars": [tmp_path / "p0.npz"],
        "films": [tmp_path / f"{film}.json" for film in told],
        "decisions": tmp_path / "report/audit.json",
    }
    step.run(settings, **files)
    found = {effect: d.verdict for effect, d in read_decisions(files["decisions"]).items()}
    assert found == {"refinement": "on", "temporal_appearance": "on", "enhancement": "on", "injection": "off"}
    step.run(replace(settings, force={"temporal_appearance": "off"}), **{**files, "films": []})
    made = read_decisions(files["decisions"])
    assert (made["temporal_appearance"].verdict, made["temporal_appearance"].forced) == ("off", True)
    assert (made["enhancement"].verdict, made["injection"].verdict) == ("undetermined", "undetermined")
