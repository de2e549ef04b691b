# SPDX-License-Identifier: Apache-2.0
"""What the survey will call for, before anything has looked at the scene: what is forced, and what is open, for which
the least and the most are told beside the likeliest.

Of gaps between cameras that get new views it is how many; loose things and the shadows of people either cost their jobs
or not. What enhancement costs where it gains has no price; other verdicts cost little.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from studiorecon.plan.decisions import Plan
from studiorecon.scene.effects import COVERED_DEG

_EFFECT = "view_synthesis"
JOBS = {"dynamic_objects": ("objects_find",), "moving_shadows": ("render_light", "render_shade")}
"""Effect that somebody there must make → the rules that it calls for."""


@dataclass(frozen=True)
class Gaps:
    """The fewest, the likeliest and the most gaps that get new views."""

    fewest: int
    likely: int
    most: int


def foreseen(plan: Plan, config: Mapping[str, Any]) -> Gaps:
    """What ``survey.force`` says, then what is usual: all of them where cameras stand as far apart as the survey finds
    too far, none where they stand closer.

    What the scene's own run decides meanwhile does not count: a run planned again is planned alike.
    """
    every = max(len(plan.segments) - (plan.forced.get("closed_path") == "off"), 0)
    if not config["background"]["views_share"]:
        return Gaps(0, 0, 0)
    if _EFFECT in plan.forced:
        known = every if plan.forced[_EFFECT] == "on" else 0
        return Gaps(known, known, known)
    apart = 360.0 / max(len(plan.training), 1) > COVERED_DEG
    return Gaps(0, every if apart else 0, every)


def called_for(plan: Plan) -> tuple[frozenset[str], frozenset[str]]:
    """The rules of ``JOBS`` that surely run, because they are forced, and those that may: with what is open, which is
    likely not called for."""
    surely, possibly = set[str](), set[str]()
    for effect, rules in JOBS.items():
        verdict = plan.forced.get(effect)
        if verdict == "on":
            surely.update(rules)
        if verdict != "off":
            possibly.update(rules)
    return frozenset(surely), frozenset(possibly)
