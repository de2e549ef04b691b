# SPDX-License-Identifier: Apache-2.0
"""Files of settings that users lay over the defaults, before Snakemake reads them as YAML 1.1."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from studiorecon.errors import UserError
from studiorecon.scene.outside import read_yaml


def check_overlay(path: Path) -> None:
    """Raises UserError for a file that is missing, no text, no mapping of settings, names one twice, or holds a number
    that YAML 1.1 takes for another (010 for 8)."""
    held = read_yaml(path, yaml.SafeLoader)
    if held is not None and not isinstance(held, Mapping):
        raise UserError(f"{path} holds no settings; its lines look like capture: {{width: 960}}")
