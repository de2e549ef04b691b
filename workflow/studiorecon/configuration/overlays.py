# SPDX-License-Identifier: Apache-2.0
"""Opens the files of settings that users lay over the defaults, before Snakemake reads them as YAML 1.1."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_yaml


def check_overlay(path: Path) -> None:
    """Raises UserError unless a file is a readable mapping of settings, each once, without numbers like 010."""
    held = read_yaml(path, yaml.SafeLoader)
    if held is not None and not isinstance(held, Mapping):
        raise UserError(f"{path} holds no settings; write lines such as capture: {{width: 960}}")
