# SPDX-License-Identifier: Apache-2.0
"""Upstream networks in the plan: which jobs a setting calls for, and what is refused before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from .conftest import ROOT, House
from .test_plan import dataset, on

__all__ = ["dataset"]


@pytest.mark.parametrize(
    ("sections", "jobs", "gone"),
    [
        ({"depth": {"source": "moge"}}, {"depth_network": 1, "depth_aligned": 3, "depth_refine": 3}, ()),
        ({"views": {"synthesizer": "gen3c"}}, {"views_request": 3, "views_generate": 3, "views_fitted": 3}, ("views_synthesize",)),
        ({"people": {"source": "comotion"}}, {"people_bodies": 3}, ("people_detections",)),
        ({"cameras": {"source": "pi3x"}}, {"cameras_network": 1, "cameras_calibration": 1, "people_sightings": 3}, ()),
    ],
    ids=["depth", "views", "people", "cameras"],
)
def test_a_networks_jobs_take_the_place_of_the_stages_own(
    house: House, dataset: Path, sections: dict, jobs: dict[str, int], gone: tuple[str, ...]
) -> None:
    plan = on(house, dataset).plan("--configfile", house.overlay(**sections))
    assert jobs.items() <= plan.items()
    assert not set(gone) & set(plan)


def test_the_papers_networks_are_one_preset(house: House, dataset: Path) -> None:
    preset = str(ROOT / "config/presets/networks.yaml")
    plan = on(house, dataset).plan("--configfile", str(ROOT / "config/presets/paper.yaml"), preset)
    assert {"people_bodies", "depth_network", "views_generate", "enhance_shot"} <= set(plan)
    listing = on(house, dataset).snakemake("--cores", "1", "weights_list", "--configfile", preset).stdout
    for title in ("CoMotion", "SAM 3", "MoGe-2", "GEN3C", "Difix3D+", "RAFT", "LPIPS"):
        assert title in listing
    refused = on(house, dataset).snakemake("--dry-run", "--configfile", preset, "--config", "licences=commercial", check=False)
    assert refused.returncode != 0
    assert "people.source is comotion, and CoMotion may not be used commercially" in refused.stdout


def test_what_was_to_be_brought_and_is_not_there_is_named(house: House, dataset: Path, tmp_path: Path) -> None:
    overlay = house.overlay(depth={"source": "precomputed", "precomputed": str(tmp_path)})
    refused = on(house, dataset).snakemake("--dry-run", "--configfile", overlay, check=False)
    assert refused.returncode != 0
    assert "has no left with one of the endings .exr, .npy, .npz, .png" in refused.stdout.replace("\n", " ")
