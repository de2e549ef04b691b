# SPDX-License-Identifier: Apache-2.0
"""The dataset of a run: the user's own, or a synthetic studio that is filmed first."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.dataset import Dataset
from studiorecon.studio.description import planned_dataset, read_description


@dataclasses.dataclass(frozen=True)
class ChosenDataset:
    """The ``dataset`` of a run; ``studio`` and ``description`` name the synthetic one and its file, else ""."""

    dataset: Dataset
    studio: str
    description: str


def resolve_path(path: str | Path, home: Path) -> str:
    """A path of the configuration: as given when it exists relative to the working folder, else below ``home``."""
    return str(path) if Path(path).is_file() else str(home / path)


def choose_dataset(config: Mapping[str, Any], home: Path) -> ChosenDataset:
    """The dataset that ``dataset`` names, its people as in ``survey.force``; UserError when it does not exist."""
    given = Path(config["dataset"])
    if given.suffix in (".yaml", ".yml"):
        description = Path(resolve_path(given, home))
        folder = Path("results/studio") / description.stem
        planned = planned_dataset(read_description(description), folder / "dataset", folder / "truth")
        chosen = ChosenDataset(planned, description.stem, str(description))
    else:
        capture_yaml = Path(config["capture_yaml"]) if config["capture_yaml"] else None
        chosen = ChosenDataset(open_dataset(given, capture_yaml), "", "")
    forced = config["survey"]["force"].get("people")
    if forced is None:
        return chosen
    return dataclasses.replace(chosen, dataset=dataclasses.replace(chosen.dataset, people=forced == "on"))
