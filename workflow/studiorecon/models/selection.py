# SPDX-License-Identifier: Apache-2.0
"""Which upstream networks a configuration asks for, and whether their licences are allowed by it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from studiorecon.errors import Refusal
from studiorecon.models.registry import MODELS

CHOICES = (
    "cameras.source",
    "people.source",
    "masks.source",
    "depth.source",
    "views.synthesizer",
    "enhance.enhancer",
    "enhance.flow",
)
"""Settings whose value may be the name of a network."""
_MEASURED, _NETS = "report.lpips.net", {"alex": "lpips_alex", "vgg": "lpips"}
_PERCEPTUAL = ("background.training.lpips.weight", "humans.losses.lpips.weight")


def selected(config: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(setting, model) for every setting of a whole configuration that calls for an upstream network, in the order data flows."""
    found = [(where, str(value)) for where in CHOICES if (value := at(config, where)) in MODELS]
    found += [(where, "lpips") for where in _PERCEPTUAL if (at(config, where) or 0) > 0]
    if (net := at(config, _MEASURED)) in _NETS:
        found.append((_MEASURED, _NETS[net]))
    # Only the bundled body and SMPL's are understood, so one that is not the bundled one is SMPL's.
    body = str(config.get("body", ""))
    if body and not body.endswith("body.npz"):
        found.append(("body", "smpl"))
    return found


def at(config: Mapping[str, Any], where: str) -> Any:
    """The value of a setting named with dots; None when there is none."""
    value: Any = config
    for key in where.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def check_licences(config: Mapping[str, Any]) -> None:
    """Raises Refusal when ``licences`` is "commercial" and a selected network may not be used so; names the alternative."""
    if config.get("licences") != "commercial":
        return
    for where, name in selected(config):
        terms = MODELS[name].terms
        if terms.commercial == "no":
            instead = terms.alternative or "the stage's own method"
            raise Refusal(
                f"{where} is {name}, and {MODELS[name].title} may not be used commercially ({terms.condition}); set it to {instead}, or "
                "set licences to any"
            )


def licence_rows(config: Mapping[str, Any]) -> list[dict[str, str]]:
    """For every selected network: where it is used, its title, licences of code and weights, commercial use, condition, alternative."""
    rows = []
    for where, name in selected(config):
        entry = MODELS[name]
        rows.append(
            {
                "setting": where,
                "model": name,
                "title": entry.title,
                "code": entry.terms.code,
                "weights": entry.terms.weights,
                "commercial": entry.terms.commercial,
                "condition": entry.terms.condition,
                "alternative": entry.terms.alternative,
                "follows": entry.runtime.commit,
            }
        )
    return rows
