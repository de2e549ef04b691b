# SPDX-License-Identifier: Apache-2.0
"""The list of upstream networks: the modules with an adapter, and their cards.

A module has ``CARDS``, one per network, and ``ADAPTER``, the class that runs them, if stages load it by name
(``models.loading``; LPIPS and SMPL are read from folders of their own). Such a module imports upstream only when it
runs, so cards can be read everywhere.
"""

from __future__ import annotations

import importlib

from studiorecon.models.catalogue.card import Card, Kind

MODULES = (
    "adapters.pi3",
    "adapters.moge",
    "adapters.onnx_depth",
    "adapters.sam3",
    "adapters.comotion",
    "smpl",
    "adapters.gen3c",
    "adapters.difix",
    "adapters.fixer",
    "adapters.raft",
    "adapters.lpips",
    "adapters.lhm",
    "points",
)
"""Modules below ``studiorecon.models``, in the order of tables. A new adapter is a line here."""

# Imported by name: a step's imports are part of its code's digest, and only the chosen adapter should count there
# (``selection.adapter_modules``).
_MODULE_OF: dict[str, str] = {}
MODELS: dict[str, Card] = {}
"""Name in settings → card."""
for _module in MODULES:
    for _card in importlib.import_module(f"studiorecon.models.{_module}").CARDS:
        MODELS[_card.name], _MODULE_OF[_card.name] = _card, f"models.{_module}"


def find_card(name: str) -> Card:
    """The card of ``name``; raises KeyError with the known names for an unknown one."""
    if name not in MODELS:
        raise KeyError(f"no model is called {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name]


def cards_of_kind(*kinds: Kind) -> list[Card]:
    """All models of these kinds, kind after kind, in the order of the list."""
    return [card for kind in kinds for card in MODELS.values() if card.kind == kind]


def adapter_module(name: str) -> str:
    """The module, below ``studiorecon``, of the adapter of model ``name``; raises KeyError as ``find_card``."""
    return _MODULE_OF[find_card(name).name]
