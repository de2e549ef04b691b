# SPDX-License-Identifier: Apache-2.0
"""Settings that several steps of the stage share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from studiorecon.configuration.setting import setting
from studiorecon.render.kinds import KINDS
from studiorecon.splatting.device import DRAWN_FROM_M

# A film must have a kind; its other settings are in the schema's $defs, kind by kind.
_FILMS = {
    "type": "object",
    "propertyNames": {
        "pattern": "^[a-z][a-z0-9_-]*$",
        "not": {"const": "train"},
        "description": "Names of films are lower-case letters, digits, - and _; train is reserved.",
    },
    "additionalProperties": {
        "description": "A film; its kind decides the other options.",
        "type": "object",
        "required": ["kind"],
        "properties": {"kind": {"enum": list(KINDS), "description": "Kind of camera path."}},
        "allOf": [
            {
                "if": {"required": ["kind"], "properties": {"kind": {"const": kind}}},
                "then": {"$ref": f"#/$defs/{kind}"},
            }
            for kind in KINDS
        ],
    },
}


@dataclass(frozen=True)
class DrawSettings:
    """The films, and the near limit of depth in metres for drawing Gaussians (G01)."""

    shots: dict[str, Any] = setting(
        {"orbit": {"kind": "orbit"}, "heldout": {"kind": "heldout"}},
        "Films by name. orbit circles inside the ring of training cameras; heldout is every "
        "held-out camera, for the metrics. Training cameras are always rendered.",
        shape=_FILMS,
        paper="4 held-out cameras at 45 degrees",
    )
    near_m: float = DRAWN_FROM_M
