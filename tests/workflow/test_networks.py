# SPDX-License-Identifier: Apache-2.0
"""Upstream networks in the plan: which jobs a setting calls for, and what is refused before anything runs."""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.selection import select_networks

from tests.made.plan import dataset, on
from tests.workflow.conftest import ROOT, House

__all__ = ["dataset"]


def test_networks_jobs_take_the_place_of_the_stages_own(house: House, dataset: Path) -> None:
    sections = {
        "calibration": {"source": "pi3x"},
        "detect": {"source": "comotion"},
        "depth": {"source": "moge"},
        "views": {"synthesizer": "gen3c"},
        "survey": {"force": {"view_synthesis": "on", "closed_path": "on"}},
    }
    plan = on(house, dataset).plan("--configfile", house.overlay(**sections))
    assert {
        "calibration_network": 1,
        "calibration_files": 1,
        "detect_keypoints": 3,
        "tracks_bodies": 3,
    }.items() <= plan.items()
    assert {"depth_network": 1, "depth_refine": 3}.items() <= plan.items()
    assert {"views_request": 3, "views_generate": 3, "views_fitted": 3}.items() <= plan.items()
    assert not {"tracks_keypoints", "views_synthesize"} & set(plan)


def test_an_enhancer_that_is_a_network_repairs_views_of_the_half_trained_room(house: House, dataset: Path) -> None:
    def planned(enhancer: str, views: int) -> dict[str, int]:
        sections = {"enhance": {"enhancer": enhancer}, "background": {"refinement": {"views": views}}}
        return on(house, dataset).plan("--configfile", house.overlay(**sections))

    assert {"background_half": 1, "background_refined": 1, "background_train": 1}.items() <= planned(
        "difix", 12
    ).items()
    plan = planned("difix", 0)
    assert plan["background_train"] == 1
    assert not {"background_half", "background_refined"} & set(plan)
    sections = {"enhance": {"enhancer": "residual"}, "background": {"refinement": {"views": 12}}}
    refused = on(house, dataset).snakemake("--dry-run", "--configfile", house.overlay(**sections), check=False)
    assert "enhance.enhancer is residual: set that to difix or fixer, or the views to 0" in refused.stdout


def test_a_network_enhances_every_held_out_camera_in_a_job_of_its_own(
    house: House, dataset: Path, tmp_path: Path
) -> None:
    taken = shutil.copytree(dataset, tmp_path / "two")
    for camera in ("door", "window"):
        (taken / "videos" / f"{camera}.mp4").touch()
    (taken / "capture.yaml").write_text("held_out: [door, window]\n")
    for enhancer, segments in (("difix", 2), ("residual", 0)):
        settings = house.overlay(enhance={"enhancer": enhancer}, device="cuda")
        text = on(house, taken).snakemake("--dry-run", "--configfile", settings).stdout
        assert text.count("Enhance camera") == segments


def test_a_laptops_networks_are_one_preset_and_need_no_gpu() -> None:
    preset = yaml.safe_load((ROOT / "config/presets/laptop.yaml").read_text())
    chosen = [name for _, name in select_networks(preset)]
    assert chosen == ["rtmpose", "moge_vits"]
    assert all(MODELS[name].memory.gpu_gb is None and MODELS[name].terms.commercial == "yes" for name in chosen)


def test_a_depth_network_of_ones_own_is_planned_and_a_missing_one_refused(
    house: House, dataset: Path, tmp_path: Path
) -> None:
    own = tmp_path / "mine.onnx"
    settings = "--configfile", house.overlay(depth={"source": "onnx", "network": str(own)})
    refused = on(house, dataset).snakemake("--dry-run", *settings, check=False)
    assert f"depth.network is '{own}', which is no file" in refused.stdout
    own.write_bytes(b"a network")
    assert {"depth_network": 1, "depth_refine": 3}.items() <= on(house, dataset).plan(*settings).items()
