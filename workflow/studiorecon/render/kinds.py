# SPDX-License-Identifier: Apache-2.0
"""The kinds of films that ``render.shots`` may hold, each with what may be said of it and what holds where nothing is
said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.render.given import GivenPath
from studiorecon.render.keyframes import Spline
from studiorecon.render.moves import DollyZoom, Follow, Oscillate
from studiorecon.render.orbit import Orbit

# What any film but heldout may say besides: who is in the picture is none of the path's business
# (``render/replacement.py``).
BESIDES = ("replace", "reference")


@dataclass(frozen=True)
class Heldout:
    """Settings of a ``heldout`` shot, of which there are none: every held-out camera at every frame."""

    kind: Literal["heldout"]


# The defaults of these dataclasses are the only place where a film's are written; the schema and the prose follow them.
KINDS: Mapping[str, type] = {
    "orbit": Orbit,
    "heldout": Heldout,
    "dolly_zoom": DollyZoom,
    "oscillate": Oscillate,
    "follow": Follow,
    "spline": Spline,
    "path": GivenPath,
}


def film(described: Mapping[str, Any], shot: str) -> Any:
    """The settings of the film ``shot``, of its kind's type; raises UserError for an unknown kind and for values of the
    wrong type."""
    kind = described.get("kind")
    if kind is None or kind not in KINDS:
        raise UserError(f"shot {shot} is of kind {kind!r}; known kinds are {', '.join(KINDS)}")
    moves = {name: value for name, value in described.items() if name not in BESIDES}
    return settings_module.load(KINDS[kind], moves, f"render.shots.{shot}")
