# SPDX-License-Identifier: Apache-2.0
"""Paths flown in the player, as shots in a file of settings beside the project's folder."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from studiorecon.configuration.schema import mistakes
from studiorecon.errors import UserError
from studiorecon.home import CONFIGURATION, SCHEMA
from studiorecon.scene.files import write_text
from studiorecon.window.projects import find_project

_HEAD = "# Films along paths that were flown in the player.\nrender:\n  shots:\n"


def shots_file(name: str) -> Path:
    """The settings file with a project's shots."""
    return Path(f"{name}.shots.yaml")


def save_shot(name: str, shot: str, text: str) -> str:
    """The file to which a shot was added; ``text`` is the player's, ``render: shots: SHOT: …``.

    Raises UserError for a name that is taken or no film can have, and for keys that are no shot.
    """
    find_project(name)
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", shot):
        raise UserError(f"{shot!r} is no name for a film; use letters, digits, - and _")
    config = yaml.safe_load(CONFIGURATION.read_text(encoding="utf-8"))
    file = shots_file(name)
    before = file.read_text(encoding="utf-8") if file.is_file() else _HEAD
    entry = "".join(line for line in text.splitlines(keepends=True) if line.startswith("    "))
    together = f"{before.rstrip()}\n{entry}"
    try:
        given, held = yaml.safe_load(text)["render"]["shots"][shot], yaml.safe_load(before)["render"]["shots"] or {}
        read_again = yaml.safe_load(together) == {"render": {"shots": {**held, shot: given}}}
    except (yaml.YAMLError, KeyError, TypeError):
        read_again, held, given = False, {}, {}
    if shot in held or shot in config["render"]["shots"]:
        raise UserError(f"there is a film {shot} already; give this one another name")
    if not read_again:
        raise UserError(f"the path cannot be added to {file}; does it hold other settings than render.shots?")
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    config["render"]["shots"][shot] = given
    if wrong := mistakes(config, schema):
        raise UserError(f"the path is no shot: {wrong[0]}")
    write_text(file, together)
    return file.as_posix()
