# SPDX-License-Identifier: Apache-2.0
"""Where the workflow's own files lie: Snakefile, rules, configuration, presets, bundled body and studios.

In a checkout that is the repository's root, in an installed package a folder of its own; it is laid out the same in
both.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
_INSTALLED = _PACKAGE / "_workflow"

HOME: Path = _INSTALLED if (_INSTALLED / "Snakefile").is_file() else _PACKAGE.parents[1]
SNAKEFILE: Path = HOME / "Snakefile"
CONFIGURATION: Path = HOME / "config" / "config.yaml"
PRESETS: Path = HOME / "config" / "presets"
SCHEMA: Path = HOME / "workflow" / "schemas" / "config.schema.yaml"
RESOURCES: Path = HOME / "resources"
