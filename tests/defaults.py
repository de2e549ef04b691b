# SPDX-License-Identifier: Apache-2.0
"""The settings a run has when nobody changes them, for tests and benches."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import pkgutil
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from studiorecon.configuration import settings as settings_module
from studiorecon.configuration.step_settings import find_section
from studiorecon.detector.network_files import DetectorFiles

ROOT = Path(__file__).parents[1]
UNSEARCHED: Any = ([], DetectorFiles([]), [])
"""The last arguments of ``clocks.moments`` where the detector searches no film."""


# Settings that several steps share, and one of these.
_STEPS_OF = {"keypoints.detections": "detect.keypoints"}
_MODULES = {step: module for module, step in _STEPS_OF.items()}


@cache
def _config() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "config/config.yaml").read_text(encoding="utf-8"))


def default_settings(step: str, **changes: Any) -> dict[str, Any]:
    """What config/config.yaml has for a step, or for all steps of a stage, with some values replaced, also such that
    are no settings but constants of the step's; of a group only those that are named."""
    values: dict[str, Any] = copy.deepcopy(find_section(step, _config()))
    stage = step.partition(".")[0]
    unknown = set(changes) - set(values)
    assert unknown <= _constants(step), f"config section {stage} has no {unknown}"
    for name, value in changes.items():
        old = values.get(name)
        values[name] = {**old, **value} if isinstance(value, dict) and isinstance(old, dict) else value
    return values


@cache
def _constants(step: str) -> frozenset[str]:
    """Names of a step's constants, or of all steps of a stage: only tests change them."""
    names = [_MODULES.get(step, step)]
    if "." not in step:
        package = importlib.import_module(f"studiorecon.{step}")
        names = [f"{step}.{module.name}" for module in pkgutil.iter_modules(package.__path__)]
    kinds = [getattr(importlib.import_module(f"studiorecon.{name}"), "Settings", None) for name in names]
    return frozenset(field.name for kind in kinds if kind for field in dataclasses.fields(kind))


def loaded(kind: type, **changes: Any) -> Any:
    """The ``Settings`` of a step, from its stage's section of config/config.yaml with ``changes``."""
    step = kind.__module__.partition(".")[2]
    step = _STEPS_OF.get(step, step)
    return settings_module.load(kind, default_settings(step, **changes), step.partition(".")[0])
