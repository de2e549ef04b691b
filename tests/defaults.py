# SPDX-License-Identifier: Apache-2.0
"""The settings a run has when nobody changes them, for tests and benches."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from studiorecon import settings as settings_module

ROOT = Path(__file__).parents[1]


@cache
def _config() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "config/config.yaml").read_text(encoding="utf-8"))


def default_settings(stage: str, **changes: Any) -> dict[str, Any]:
    """A section of config/config.yaml with some values replaced; of a group of settings only those that are named."""
    values: dict[str, Any] = copy.deepcopy(_config()[stage])
    assert set(changes) <= set(values), f"config section {stage} has no {set(changes) - set(values)}"
    for name, value in changes.items():
        values[name] = {**values[name], **value} if isinstance(value, dict) and isinstance(values[name], dict) else value
    return values


def loaded(kind: type, **changes: Any) -> Any:
    """The ``Settings`` of a step, from its stage's section of config/config.yaml with ``changes``."""
    stage = kind.__module__.split(".")[1]
    return settings_module.load(kind, default_settings(stage, **changes), stage)
