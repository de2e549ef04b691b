# SPDX-License-Identifier: Apache-2.0
"""How many gaps between cameras will get new views, before anything has looked at the scene: what is forced, what an
earlier run decided, and what is open, for which the fewest and the most are told beside the likeliest.

What other open verdicts ask for has no price: they are off in most scenes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studiorecon.plan.decisions import Plan
from studiorecon.scene.decisions import Decision, read_decisions
from studiorecon.scene.effects import COVERED_DEG

_EFFECT = "view_synthesis"


@dataclass(frozen=True)
class Gaps:
    """The fewest, the likeliest and the most gaps that get new views."""

    fewest: int
    likely: int
    most: int


def foreseen(plan: Plan, config: Mapping[str, Any]) -> Gaps:
    """What ``survey.force`` says, then what the run that ``survey.earlier`` names has decided, then what is usual: all
    of them where cameras stand as far apart as the survey finds too far, none where they stand closer.

    What the scene's own run decides meanwhile does not count: a run planned again is planned alike.
    """
    every = max(len(plan.segments) - (plan.forced.get("closed_path") == "off"), 0)
    if not config["background"]["views_share"]:
        return Gaps(0, 0, 0)
    if _EFFECT in plan.forced:
        known = every if plan.forced[_EFFECT] == "on" else 0
        return Gaps(known, known, known)
    if (told := _told(config["survey"]["earlier"])) is not None:
        parts = told.detail.get("parts", {})
        known = sum(part["verdict"] == "on" for part in parts.values()) if parts else every * told.called_for
        return Gaps(known, known, known)
    apart = 360.0 / max(len(plan.training), 1) > COVERED_DEG
    return Gaps(0, every if apart else 0, every)


def _told(earlier: str) -> Decision | None:
    """What that run measured; what was forced there is open here."""
    path = Path(earlier) / "survey" / "decisions.json"
    if not earlier or not path.is_file():
        return None
    found = read_decisions(path).get(_EFFECT)
    return None if found is None or found.forced or found.value is None else found
