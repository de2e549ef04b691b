# SPDX-License-Identifier: Apache-2.0
"""The call of the packaged Snakefile, with a preset and the options that a user gives."""

from __future__ import annotations

import difflib
import importlib.util
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from studiorecon.configuration.overlays import OVERLAY_OPTIONS, split_option
from studiorecon.errors import UserError
from studiorecon.home import PRESETS, SNAKEFILE


def preset_names() -> list[str]:
    """Names of the presets that come with the workflow."""
    return sorted(path.stem for path in PRESETS.glob("*.yaml"))


def preset_file(name: str) -> Path:
    """The overlay of a preset's name, or of a path; raises UserError with the nearest name when there is neither."""
    file = PRESETS / f"{name}.yaml"
    if file.is_file():
        return file
    if Path(name).is_file():
        return Path(name)
    near = difflib.get_close_matches(name, preset_names(), 1)
    raise UserError(
        f"there is no preset {name}; {f'did you mean {near[0]}?' if near else 'there are ' + ', '.join(preset_names())}"
    )


def snakemake_command(target: str, dataset: str, cores: str, preset: str | None, rest: Sequence[str]) -> list[str]:
    """The call of the packaged Snakefile; options in ``rest`` that Snakemake takes only once are merged with ours."""
    config, rest = split_option(rest, ("--config", "-C"))
    overlays, rest = split_option(rest, OVERLAY_OPTIONS)
    overlays = [*([str(preset_file(preset))] if preset else []), *overlays]
    command = [
        sys.executable,
        "-m",
        "snakemake",
        *([target] if target else []),
        "--snakefile",
        str(SNAKEFILE),
        "--cores",
        cores,
        *rest,
    ]
    # Snakemake reads 007 as a number and #1 as a comment, unless quoted, and removes quotes at the very ends.
    quoted = f"dataset= {json.dumps(dataset, ensure_ascii=False)} "
    # Last, since they take all words that follow.
    return [*command, *(["--configfile", *overlays] if overlays else []), "--config", quoted, *config]


def environment() -> dict[str, str]:
    """The environment of a call. Raises UserError without Snakemake.

    Rules call `python`: it must be this command's own, even if its environment is not activated.
    """
    if importlib.util.find_spec("snakemake") is None:
        raise UserError("Snakemake, which runs the steps, is not installed here: pip install 'studiorecon[run]'")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    there = next(folder for folder in (cache, *cache.parents) if folder.exists())
    # Snakemake needs a cache, also where the home folder is read-only, as in containers.
    own = {} if os.access(there, os.W_OK) else {"XDG_CACHE_HOME": str(Path(".snakemake/cache").absolute())}
    path = os.pathsep.join([os.path.dirname(sys.executable), os.environ.get("PATH", "")])
    return {**os.environ, **own, "PATH": path}
