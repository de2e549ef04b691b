# SPDX-License-Identifier: Apache-2.0
"""The kinds of films in ``render.shots``, each with its settings and their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.render.keyframes import Spline
from studiorecon.render.moves import DollyZoom, Follow, Oscillate
from studiorecon.render.orbit import Orbit
from studiorecon.render.path_file import GivenPath

# Settings of any film except heldout: replacing people is independent of the path (``render/replacement.py``).
EXTRA_OPTIONS = ("replace", "reference")


@dataclass(frozen=True)
class Heldout:
    """A ``heldout`` shot, which has no settings: every held-out camera at every frame."""

    kind: Literal["heldout"]


# The defaults of a film are written only in these dataclasses; schema and documentation are generated from them.
KINDS: Mapping[str, type] = {
    "orbit": Orbit,
    "heldout": Heldout,
    "dolly_zoom": DollyZoom,
    "oscillate": Oscillate,
    "follow": Follow,
    "spline": Spline,
    "path": GivenPath,
}


def read_film_settings(described: Mapping[str, Any], shot: str) -> Any:
    """The settings of the film ``shot``; raises UserError for an unknown kind or a value of the wrong type."""
    kind = described.get("kind")
    if kind is None or kind not in KINDS:
        raise UserError(f"shot {shot} is of kind {kind!r}; known kinds are {', '.join(KINDS)}")
    moves = {name: value for name, value in described.items() if name not in EXTRA_OPTIONS}
    return settings_module.load(KINDS[kind], moves, f"render.shots.{shot}")
