# SPDX-License-Identifier: Apache-2.0
"""The page's section on effects: every statistic against its threshold, and the steps that use the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from studiorecon.pages import html
from studiorecon.scene.decisions import Decision

_WIDTH, _HEIGHT = 120, 14
# Stages that exist for one effect only.
_STAGES = {"people": ("people", "masks", "humans"), "view_synthesis": ("views",), "enhancement": ("enhance",)}


def decisions_table(found: Sequence[Mapping[str, Decision]], spent: Mapping[str, Any]) -> str:
    """A row for every effect, in the order of the first file; a later file's decision replaces an earlier one.

    ``spent`` is the run's cost by stage: the cost of an effect's own jobs is the saving of leaving it out.
    """
    merged: dict[str, Decision] = {}
    for survey in found:
        merged |= survey
    rows = []
    for decision in merged.values():
        word = f'<span class="{decision.verdict}">{decision.verdict}{" (forced)" if decision.forced else ""}</span>'
        took = [spent.get("stages", {}).get(stage, {}).get("seconds") for stage in _STAGES.get(decision.effect, ())]
        acts = (decision.used_by or "only reported") + (
            f" ({sum(t for t in took if t):.0f} s in this run)" if any(took) else ""
        )
        rows.append([decision.effect.replace("_", " "), word, gauge(decision), decision.reason, acts])
    lead = (
        "Only effects that this scene calls for are simulated. The bar shows the measurement with its interval; "
        "the tick in its middle is the threshold. Thresholds are uncalibrated: they come from synthetic scenes. "
        "Verdicts that a step uses can be forced (survey.force)."
    )
    header = ["effect", "verdict", "measured, threshold", "why", "when on"]
    return html.heading("Decisions", lead) + html.table(header, rows, raw=(1, 2))


def gauge(decision: Decision) -> str:
    """A small picture of interval and value on a scale to twice the threshold; words without a measurement."""
    if decision.value is None or decision.interval is None or not decision.threshold:
        return "not measured"
    measured = (decision.interval[0], decision.value, decision.interval[1])
    low, at, high = (_WIDTH * float(np.clip(v / decision.threshold / 2, 0, 1)) for v in measured)
    middle = _HEIGHT / 2
    words = html.escape(f"{_brief(decision.value, decision.unit)} against {_brief(decision.threshold, decision.unit)}")
    return (
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" role="img" aria-label="{words}">'
        f'<line x1="0" x2="{_WIDTH}" y1="{middle}" y2="{middle}" stroke="var(--line)"/>'
        f'<line x1="{low:.1f}" x2="{high:.1f}" y1="{middle}" y2="{middle}" stroke="var(--mark)" stroke-width="5"/>'
        f'<line x1="{_WIDTH / 2}" x2="{_WIDTH / 2}" y1="0" y2="{_HEIGHT}" stroke="currentColor"/>'
        f'<circle cx="{at:.1f}" cy="{middle}" r="4" fill="var(--mark)" '
        f'stroke="var(--paper)"/></svg><br><span class="soft">{words}</span>'
    )


def _brief(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.3g}{' ' + unit if unit else ''}"
