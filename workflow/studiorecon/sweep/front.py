# SPDX-License-Identifier: Apache-2.0
"""The Pareto front of cost and quality, and its picture as SVG: sharp in print, dark or light as the page is."""

from __future__ import annotations

from collections.abc import Sequence
from math import log10

from studiorecon.pages.html import text
from studiorecon.report.sections.cost import pareto_front
from studiorecon.report.sections.tables import duration

_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 1000, 420, 70, 24, 16, 46
_TIMES_S = (1, 3, 10, 30, 60, 120, 300, 600, 1200, 3600, 7200, 18000, 36000, 86400)


def chart(names: Sequence[str], seconds: Sequence[float], qualities: Sequence[float], axis: str) -> str:
    """Quality over seconds (log axis): filled and labelled on the front, hollow with a tooltip elsewhere."""
    front = pareto_front(seconds, qualities)
    low_s, high_s = max(min(seconds), 0.1) / 1.15, max(*seconds, 1.0) * 1.15
    spread = max(qualities) - min(qualities) or 1.0
    low, high = min(qualities) - 0.08 * spread, max(qualities) + 0.08 * spread

    def x(value_s: float) -> float:
        return _LEFT + log10(max(value_s, 0.1) / low_s) / log10(high_s / low_s) * (_WIDTH - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return _TOP + (high - value) / (high - low) * (_HEIGHT - _TOP - _BOTTOM)

    parts = []
    for tick in (t for t in _TIMES_S if low_s <= t <= high_s):
        parts.append(_text(x(tick), _HEIGHT - _BOTTOM + 20, duration(tick), "middle"))
    for number in range(5):
        value = low + (high - low) * (number + 0.5) / 5
        parts.append(f'<path d="M{_LEFT},{y(value):.1f}H{_WIDTH - _RIGHT}" style="stroke:var(--line)"/>')
        parts.append(_text(_LEFT - 8, y(value) + 4, f"{value:.2f}", "end"))
    steps = "".join(f"H{x(seconds[i]):.1f}V{y(qualities[i]):.1f}" for i in front[1:])
    path = f"M{x(seconds[front[0]]):.1f},{y(qualities[front[0]]):.1f}{steps}H{_WIDTH - _RIGHT}"
    parts.append(f'<path d="{path}" style="fill:none;stroke:var(--mark);stroke-width:2"/>')
    for i, name in enumerate(names):
        look = "fill:var(--mark)" if i in front else "fill:var(--paper);stroke:var(--soft)"
        tip = f"<title>{text(f'{name}: {qualities[i]:.2f}, {duration(seconds[i])}')}</title>"
        parts.append(f'<circle cx="{x(seconds[i]):.1f}" cy="{y(qualities[i]):.1f}" r="5" style="{look}">{tip}</circle>')
        if i in front:
            left = x(seconds[i]) > 0.8 * _WIDTH
            beside, anchor = (-9, "end") if left else (9, "start")
            parts.append(_text(x(seconds[i]) + beside, y(qualities[i]) - 7, name, anchor))
    parts.append(_text(_LEFT, _HEIGHT - 6, "time from nothing to the film, jobs one after the other (log)", "start"))
    parts.append(_text(_WIDTH - _RIGHT, _HEIGHT - 6, axis, "end"))
    look = 'style="width:100%;min-width:680px;height:auto;display:block;font:13px system-ui,sans-serif"'
    svg = f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" {look}>{"".join(parts)}</svg>'
    return f'<figure class="scroll">{svg}</figure>'


def _text(x: float, y: float, content: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" style="fill:var(--soft)">{text(content)}</text>'
