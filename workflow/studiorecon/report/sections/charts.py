# SPDX-License-Identifier: Apache-2.0
"""Charts of what accuracy costs, as SVG inside the page: sharp in print, dark or light as the page is, and without a
script.

Nothing is told by colour alone: points on the front are filled, the others hollow, failed runs crosses; taken-over work
is hatched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

from studiorecon.pages.html import text

WIDTH = 1000
# Okabe and Ito's colours, which colour-blind readers tell apart, then greys of the same lightness steps.
_COLOURS = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#d55e00",
    "#f0e442",
    "#8c8c8c",
    "#5a4fcf",
    "#b0a060",
    "#444444",
)
# Marks of a clock's log axis, seconds.
_TIMES = (0.1, 0.3, 1, 3, 10, 30, 60, 120, 300, 600, 1200, 3600, 7200, 18000, 36000, 86400)
_LEFT, _RIGHT, _TOP, _BOTTOM = 70, 24, 16, 46


@dataclass(frozen=True)
class Point:
    """One run in the plane of seconds and quality: ``label`` is written beside it (empty: none), ``told`` is its
    tooltip."""

    seconds: float
    quality: float
    label: str
    told: str
    on_front: bool
    error: float | None = None


def plane(
    title: str,
    axis: str,
    points: Sequence[Point],
    front: Sequence[int],
    crosses: Sequence[tuple[float, str]],
    band: Sequence[float] | None,
) -> str:
    """Quality over seconds (log axis), greater always higher. ``front`` indexes ``points``, cheapest first, drawn as
    steps, since between two runs nothing was measured; ``crosses`` are failed runs (seconds, tooltip) on the axis;
    ``band`` is the best run's interval."""
    height = 430
    x = _log_scale([p.seconds for p in points] + [s for s, _ in crosses], _LEFT, WIDTH - _RIGHT)
    spread = [p.quality for p in points] + list(band or [])
    y = _linear_scale(spread, height - _BOTTOM, _TOP)
    parts = []
    if band:
        parts.append(
            _rect(
                _LEFT,
                y.at(band[1]),
                WIDTH - _LEFT - _RIGHT,
                y.at(band[0]) - y.at(band[1]),
                "fill:var(--mark);opacity:.10",
            )
        )
    for tick in y.ticks:
        parts.append(_line(_LEFT, y.at(tick), WIDTH - _RIGHT, y.at(tick), "stroke:var(--line)"))
        parts.append(_text(_LEFT - 8, y.at(tick) + 4, y.shown(tick), "end"))
    for tick in x.ticks:
        parts.append(_line(x.at(tick), height - _BOTTOM, x.at(tick), height - _BOTTOM + 5, "stroke:var(--soft)"))
        parts.append(_text(x.at(tick), height - _BOTTOM + 20, _seconds(tick), "middle"))
    parts.append(_text(_LEFT, height - 6, "time from nothing to the film, all jobs one after the other (log)", "start"))
    parts.append(_text(WIDTH - _RIGHT, height - 6, axis, "end"))
    steps = [points[i] for i in front]
    if steps:
        path = f"M{x.at(steps[0].seconds):.1f},{y.at(steps[0].quality):.1f}"
        path += "".join(f"H{x.at(p.seconds):.1f}V{y.at(p.quality):.1f}" for p in steps[1:])
        parts.append(f'<path d="{path}H{WIDTH - _RIGHT}" style="fill:none;stroke:var(--mark);stroke-width:2"/>')
    for point in sorted(points, key=lambda p: p.on_front):
        parts.append(_dot(x.at(point.seconds), y, point))
    for seconds, told in crosses:
        parts.append(_cross(x.at(seconds), height - _BOTTOM, told))
    parts += _labels([(x.at(p.seconds), y.at(p.quality), p.label) for p in points if p.label])
    return _svg(title, height, parts)


def stacked(title: str, rows: Sequence[tuple[str, Mapping[str, float], Mapping[str, float]]]) -> str:
    """Horizontal bars of seconds per stage: (name, stage → seconds, stage → seconds of it that were newly run); the
    rest is hatched."""
    stages = list(dict.fromkeys(stage for _, spent, _ in rows for stage in spent))
    colour = {stage: _COLOURS[i % len(_COLOURS)] for i, stage in enumerate(stages)}
    longest = max((sum(spent.values()) for _, spent, _ in rows), default=0.0) or 1.0
    left, step = 210, 30
    legend_rows = ceil(len(stages) / 7)
    height = step * len(rows) + 30 + 22 * legend_rows
    parts = []
    for number, (name, spent, ran) in enumerate(rows):
        top, at = number * step + 4, float(left)
        parts.append(_text(left - 8, top + 15, name, "end"))
        for stage, seconds in spent.items():
            width = seconds / longest * (WIDTH - left - 80)
            new = min(ran.get(stage, 0.0), seconds) / longest * (WIDTH - left - 80)
            told = f"{name}: {stage} {_seconds(seconds)}" + (
                ", of which newly run " + _seconds(ran.get(stage, 0.0)) if new < width else ""
            )
            parts.append(_rect(at, top, width, 20, f"fill:{colour[stage]};stroke:var(--paper);stroke-width:.5", told))
            if width - new > 0.5:
                parts.append(_rect(at + new, top, width - new, 20, "fill:url(#taken)"))
            at += width
        parts.append(_text(at + 6, top + 15, _seconds(sum(spent.values())), "start"))
    for number, stage in enumerate(stages):
        across, down = number % 7, number // 7
        top = step * len(rows) + 14 + 22 * down
        parts.append(_rect(20 + 138 * across, top, 14, 14, f"fill:{colour[stage]}"))
        parts.append(_text(40 + 138 * across, top + 12, stage, "start"))
    hatch = (
        '<defs><pattern id="taken" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    )
    hatch += '<rect width="3" height="6" style="fill:var(--paper);opacity:.65"/></pattern></defs>'
    return _svg(title, height, [hatch, *parts])


@dataclass(frozen=True)
class Effect:
    """What one change does: to the measure (with its interval, if known) and to the time; ``measurable`` False is drawn
    pale."""

    label: str
    quality: float
    interval: Sequence[float] | None
    seconds: float
    measurable: bool


def tornado(title: str, axis: str, effects: Sequence[Effect]) -> str:
    """Two columns of bars from a middle line: change of quality with its interval, and change of seconds."""
    step, height = 26, 26 * len(effects) + 44
    reach = max((abs(v) for e in effects for v in (e.quality, *(e.interval or ()))), default=0.0) or 1.0
    longest = max((abs(e.seconds) for e in effects), default=0.0) or 1.0
    middle, half = (460, 150), (820, 110)
    parts = [_text(middle[0], 14, axis, "middle"), _text(half[0], 14, "change of seconds", "middle")]
    for centre, _ in (middle, half):
        parts.append(_line(centre, 22, centre, height - 10, "stroke:var(--soft)"))
    for number, effect in enumerate(effects):
        top = 28 + number * step
        faded = "" if effect.measurable else ";opacity:.35"
        width = effect.quality / reach * middle[1]
        parts.append(_text(290, top + 13, effect.label, "end"))
        parts.append(
            _rect(
                middle[0] + min(width, 0),
                top,
                abs(width),
                16,
                "fill:var(--mark)" + faded,
                f"{effect.label}: {effect.quality:+.3f}",
            )
        )
        if effect.interval:
            low, high = (middle[0] + v / reach * middle[1] for v in effect.interval)
            parts.append(_line(low, top + 8, high, top + 8, "stroke:var(--ink);stroke-width:1.5"))
        parts.append(_text(middle[0] + middle[1] + 12, top + 13, f"{effect.quality:+.2f}", "start"))
        spent = effect.seconds / longest * half[1]
        parts.append(_rect(half[0] + min(spent, 0), top, abs(spent), 16, "fill:var(--warn)"))
        parts.append(_text(half[0] + half[1] + 8, top + 13, f"{effect.seconds:+.0f} s", "start"))
    return _svg(title, height, parts)


@dataclass(frozen=True)
class _Scale:
    low: float
    high: float
    start: float
    end: float
    logarithmic: bool
    ticks: tuple[float, ...]
    digits: int = 0

    def at(self, value: float) -> float:
        low, high, value = (
            (log10(v) for v in (self.low, self.high, value)) if self.logarithmic else (self.low, self.high, value)
        )
        return self.start + (value - low) / (high - low) * (self.end - self.start)

    def shown(self, value: float) -> str:
        return f"{value:.{self.digits}f}"


def _log_scale(values: Sequence[float], start: float, end: float) -> _Scale:
    # A run that failed at once took no time that was measured; a log axis begins at a tenth of a second.
    low, high = max(min(values, default=1.0), 0.1) / 1.15, max(*values, 1.0) * 1.15 if values else 10.0
    ticks = tuple(m for m in _TIMES if low <= m <= high)
    if len(ticks) < 4:  # times that are close together: even steps of whole seconds or minutes
        unit = next(
            u for u in (0.1, 0.5, 1, 5, 10, 30, 60, 300, 600, 1800, 3600, 18000) if (high - low) / u <= 8 or u == 18000
        )
        ticks = tuple(i * unit for i in range(ceil(low / unit), floor(high / unit) + 1))
    return _Scale(low, high, start, end, True, ticks)


def _linear_scale(values: Sequence[float], start: float, end: float) -> _Scale:
    low, high = min(values, default=0.0), max(values, default=1.0)
    room = (high - low) * 0.08 or max(abs(high) * 0.01, 1e-6)
    low, high = low - room, high + room
    rough = (high - low) / 6
    unit = 10.0 ** floor(log10(rough))
    step = next(m * unit for m in (1, 2, 5, 10) if m * unit >= rough)
    ticks = tuple(i * step for i in range(ceil(low / step), floor(high / step) + 1))
    return _Scale(low, high, start, end, False, ticks, max(0, -floor(log10(step))))


def _dot(at: float, y: _Scale, point: Point) -> str:
    look = "fill:var(--mark)" if point.on_front else "fill:var(--paper);stroke:var(--soft);opacity:.75"
    whisker = ""
    if point.error:
        low, high = y.at(point.quality - point.error), y.at(point.quality + point.error)
        whisker = _line(at, low, at, high, "stroke:var(--ink)")
    dot = (
        f'<circle cx="{at:.1f}" cy="{y.at(point.quality):.1f}" r="5.5" '
        f'style="{look}"><title>{text(point.told)}</title></circle>'
    )
    return whisker + dot


def _cross(x: float, y: float, told: str) -> str:
    path = f"M{x - 5:.1f},{y - 5:.1f}l10,10m0,-10l-10,10"
    return f'<path d="{path}" style="stroke:var(--warn);stroke-width:2.5;fill:none"><title>{text(told)}</title></path>'


def _labels(wanted: Sequence[tuple[float, float, str]]) -> list[str]:
    """Labels beside their points, moved down until they lie on no other; left of points near the right edge."""
    placed: list[tuple[float, float, float]] = []
    parts = []
    for x, y, label in sorted(wanted, key=lambda w: w[1]):
        width = 7.2 * len(label)
        left, anchor = (x - 10 - width, "end") if x + 10 + width > WIDTH - _RIGHT else (x + 10, "start")
        down = y - 6
        while any(abs(down - other) < 14 and left < edge and begin < left + width for begin, edge, other in placed):
            down += 3
        placed.append((left, left + width, down))
        parts.append(_text(x - 10 if anchor == "end" else x + 10, down, label, anchor, "fill:var(--ink)"))
    return parts


def _svg(title: str, height: float, parts: Sequence[str]) -> str:
    # On a phone the chart is scrolled rather than shrunk until nobody can read it.
    look = 'style="width:100%;min-width:680px;height:auto;display:block;font:13px system-ui,sans-serif"'
    svg = (
        f'<svg viewBox="0 0 {WIDTH} {height:.0f}" role="img" {look}><title>{text(title)}</title>{"".join(parts)}</svg>'
    )
    return f'<figure class="scroll" style="min-width:0">{svg}</figure>'


def _text(x: float, y: float, content: str, anchor: str, look: str = "fill:var(--soft)") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" style="{look}">{text(content)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, look: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" style="{look}"/>'


def _rect(x: float, y: float, width: float, height: float, look: str, told: str = "") -> str:
    inner = f"<title>{text(told)}</title>" if told else ""
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(width, 0):.1f}" '
        f'height="{max(height, 0):.1f}" style="{look}">{inner}</rect>'
    )


def _seconds(value: float) -> str:
    """A time in its natural unit, with a decimal only where it says something."""
    number, unit = (value, "s") if value < 60 else (value / 60, "min") if value < 5400 else (value / 3600, "h")
    return f"{number:.1f}".removesuffix(".0") + f" {unit}" if number < 10 or unit != "s" else f"{number:.0f} s"
