# SPDX-License-Identifier: Apache-2.0
"""Checks the files of settings that users lay over the defaults, before Snakemake reads them as YAML 1.1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_yaml

OVERLAY_OPTIONS = ("--configfile", "--configfiles")


def check_overlay(path: Path) -> None:
    """Raises UserError unless a file is a readable mapping of settings, each once, without numbers like 010."""
    if not isinstance(read_yaml(path, yaml.SafeLoader), Mapping):
        raise UserError(f"{path} holds no settings; write lines such as capture: {{width: 960}}")


def split_option(words: Sequence[str], names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Values of an option that takes several words, and the words without it."""
    values: list[str] = []
    others: list[str] = []
    inside = False
    for word in words:
        name, equals, value = word.partition("=")
        if name in names:
            inside = not equals
            values += [value] if equals else []
        elif inside and not word.startswith("-"):
            values.append(word)
        else:
            inside = False
            others.append(word)
    return values, others
