# SPDX-License-Identifier: Apache-2.0
"""Makes the plan of a configuration: decides each part, combines them, and refuses what cannot be run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.plan.dataset import choose_dataset, resolve_path
from studiorecon.plan.decisions import Plan
from studiorecon.plan.networks import choose_networks
from studiorecon.plan.person_sources import choose_person_sources
from studiorecon.plan.plan_checks import check_plan
from studiorecon.scene.names import check_name, compose_unicode, segment_name

_TAKEN = ("studio", "body")
"""Folders of results that belong to no scene."""


def make_plan(config: Mapping[str, Any], home: Path) -> Plan:
    """The plan of a complete, valid configuration; UserError when the dataset does not exist or cannot be run.

    ``home`` is the workflow's folder.
    """
    chosen = choose_dataset(config, home)
    dataset, networks = chosen.dataset, choose_networks(config, home)
    sources = choose_person_sources(dataset, config)
    scene = compose_unicode(str(config["scene"]) or chosen.studio or dataset.folder.resolve().name)
    check_name(scene, "the scene", "name it with --config scene=NAME")
    for shot in config["render"]["shots"]:
        check_name(shot, "the film", "rename it in render.shots")
    if scene in _TAKEN:
        raise UserError(
            f"the scene is called {scene!r}, and results/{scene}/ holds what all scenes share; name it otherwise with "
            "--config scene=NAME"
        )
    given_body = resolve_path(config["body"], home)
    source = config["calibration"]["source"]
    written = [f"results/{scene}/calibration/network/{name}.txt" for name in ("cameras", "images")]
    plan = Plan(
        dataset=dataset,
        studio=chosen.studio,
        description=chosen.description,
        scene=scene,
        given_body=given_body,
        # SMPL's own pickle is first converted to plain arrays.
        body=f"results/body/{Path(given_body).stem}.npz" if given_body.endswith(".pkl") else given_body,
        # A file named in the configuration takes precedence over the dataset's.
        identities=str(config["people"]["identities"] or dataset.identities or ""),
        person_sources=sources,
        networks=networks,
        lifts_pelvises=dataset.people and config["people"]["association"]["position"] == "scene",
        from_people=source == "people" or (source == "auto" and not dataset.calibration and bool(sources.cameras)),
        calibration=written if networks.cameras else [str(file) for file in dataset.calibration],
        segments=[segment_name(number) for number in range(len(dataset.training))],
        films=[shot for shot in config["render"]["shots"] if shot != "heldout" or dataset.held_out],
        forced_effects=config["survey"]["force"],
    )
    check_plan(plan, config)
    return plan
