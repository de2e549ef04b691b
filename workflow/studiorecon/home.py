# SPDX-License-Identifier: Apache-2.0
"""The place of the workflow's own files: Snakefile, rules, configuration, presets, bundled body and studios.

In a checkout it is the repository's root, in an installed package a folder of its own, with the same layout.
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
