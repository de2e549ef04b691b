# SPDX-License-Identifier: Apache-2.0
"""The decisions of human training for all persons, combined into one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from studiorecon.scene.decisions import Decision
from studiorecon.scene.effects import TEMPORAL_APPEARANCE

if TYPE_CHECKING:
    pass


def appearance(found: Mapping[str, Decision | None], threshold: float) -> Decision:
    """One decision from the people's own (name → decision of human training, None without one): that of the strongest
    case.

    ``threshold`` is reported when no person has a decision.
    """
    asked = {name: (d.value, d) for name, d in found.items() if d is not None and d.value is not None}
    if not asked:
        why = (
            "no person was trained"
            if not found
            else f"human training did not ask, or followed too little of {', '.join(found)}"
        )
        return TEMPORAL_APPEARANCE.decide(None, None, f"not measured here: {why}", threshold=threshold)
    _, most = max(asked.values(), key=lambda pair: (pair[1].called_for, pair[0]))
    detail = {name: {"value": value, "verdict": d.verdict} for name, (value, d) in asked.items()}
    return replace(most, obeyed_by=TEMPORAL_APPEARANCE.obeyed_by, detail=detail)
