# SPDX-License-Identifier: Apache-2.0
"""Files of settings that users lay over the defaults, before Snakemake reads them as YAML 1.1."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from studiorecon.errors import UserError
from studiorecon.scene.outside import read_yaml


def check_overlay(path: Path) -> None:
    """Raises UserError for a file that is missing, no text, no mapping of settings, names one twice, or holds a number
    that reads differently in YAML 1.1 and 1.2 (010 is 8 in one of them)."""
    held = read_yaml(path)
    if held is not None and not isinstance(held, Mapping):
        raise UserError(f"{path} holds no settings; its lines look like capture: {{width: 960}}")
    _compare(held, read_yaml(path, yaml.SafeLoader), path, "")


def _compare(plain: Any, old: Any, path: Path, name: str) -> None:
    if isinstance(plain, Mapping) and isinstance(old, Mapping):
        for (key, inner), other in zip(plain.items(), old.values()):
            _compare(inner, other, path, f"{name}.{key}".lstrip("."))
    elif isinstance(plain, list) and isinstance(old, list):
        for number, (inner, other) in enumerate(zip(plain, old)):
            _compare(inner, other, path, f"{name}[{number}]")
    elif isinstance(plain, str) and isinstance(old, (int, float)) and not isinstance(old, bool):
        raise UserError(f"{path}: {name} is {plain}, which YAML reads as {old}; write plain decimal digits")
