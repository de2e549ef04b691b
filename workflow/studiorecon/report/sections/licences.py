# SPDX-License-Identifier: Apache-2.0
"""The page's section on licences: the networks in use, their terms, and whether the result may be used commercially."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studiorecon.models.catalogue.checksums import read_pins
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.selection import CHOICES, licence_rows, setting_at
from studiorecon.pages import html

_ORDER = ("yes", "with conditions", "unknown", "no")
_VERDICTS = {
    "yes": "Nothing that this run used forbids commercial use.",
    "with conditions": "Commercial use is allowed under the conditions named below.",
    "unknown": "Some files of a network are your own; check whether their terms allow commercial use.",
    "no": "At least one network that this run used may not be used commercially, nor what was made with it.",
}


def verdict(configuration: Mapping[str, Any]) -> str:
    """The strictest of "yes", "with conditions", "unknown", "no" over everything that a whole configuration uses."""
    found = [row["commercial"] for row in licence_rows(configuration)]
    found += ["unknown" for where in CHOICES if setting_at(configuration, where) == "precomputed"]
    return max(found, key=_ORDER.index, default="yes")


def checksums(name: str, weights: Path) -> str:
    """First digits of the SHA-256 of the model's verified files; a word when none was verified."""
    pins = read_pins(weights) if weights.is_dir() else {}
    found = [
        f"{Path(file.path).name} {pins[file.path]['sha256'][:12]}" for file in MODELS[name].weights if file.path in pins
    ]
    return ", ".join(found) or "not verified"


def licences(configuration: Mapping[str, Any], folder: Path) -> str:
    """Table of the networks in use, the verdict, and the texts of the licences of the results' contents."""
    parts = [html.heading("Licences", "This project's code is under Apache-2.0. " + _VERDICTS[verdict(configuration)])]
    rows = [
        (
            row["setting"],
            row["title"],
            row["code"],
            row["weights"],
            row["commercial"] + (f": {row['condition']}" if row["condition"] else ""),
            row["follows"],
            checksums(row["model"], Path(str(configuration.get("weights", "")))),
        )
        for row in licence_rows(configuration)
    ]
    brought = [
        (where, "files brought by the user", "", "unknown", "unknown", "", "")
        for where in CHOICES
        if setting_at(configuration, where) == "precomputed"
    ]
    if rows or brought:
        header = ("setting", "network", "code", "weights", "commercial use", "upstream", "SHA-256 of weights")
        parts.append(html.table(header, [*rows, *brought]))
    else:
        parts.append(
            "<p>No upstream network was used; every stage used its built-in method, and the body is the bundled "
            "one.</p>"
        )
    parts += [
        html.details(p.name, p.read_text(encoding="utf-8", errors="replace"))
        for p in sorted(folder.iterdir())
        if p.is_file()
    ]
    return "".join(parts)
