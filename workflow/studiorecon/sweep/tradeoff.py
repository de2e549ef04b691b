# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs, read from a sweep's records: the front, what each step along it costs, what a budget buys, which
parameters matter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from studiorecon.report.metrics.bootstrap import Bootstrap, over_seeds, paired_difference
from studiorecon.sweep.pareto import best_within, cheapest_reaching, front, kendall_tau, usable
from studiorecon.sweep.records import OK, Record

# measure, heading, unit, digits, sign: +1 where more is better.
MEASURES = (
    ("psnr", "PSNR", "dB", 2, 1),
    ("ssim", "SSIM", "", 4, 1),
    ("lpips", "LPIPS", "", 4, -1),
    ("flip", "ꟻLIP", "", 4, -1),
    ("psnr_people", "PSNR of people", "dB", 2, 1),
    ("psnr_background", "PSNR of the room", "dB", 2, 1),
    ("psnr_unseen", "PSNR of unseen surfaces", "dB", 2, 1),
    ("warp_rms", "Warp-RMS", "", 5, -1),
    ("joints_mm", "joint error", "mm", 1, -1),
    ("jitter_mm_f2", "jitter", "mm/frame²", 2, -1),
)
# Rows whose parameter is called so differ from the base in seeds only.
CHANCE = "seed"
BUDGETS_MIN = (1, 2, 5, 15, 60, 240)
_GAINS = (0.90, 0.95, 0.99)
_BOOTSTRAP = Bootstrap(1000, 0)


@dataclass(frozen=True)
class TradeoffStep:
    """From one run of the front to the next dearer one: what was gained, what it cost, and what was changed."""

    cheaper: Record
    dearer: Record
    gain: float
    seconds: float
    changed: str


@dataclass(frozen=True)
class Change:
    """One run beside the base: difference of the measure (+ is better), its interval over frames, of the seconds, and
    whether it shows.

    ``measurable`` is None when nothing can be said: too few frames for an interval.
    """

    record: Record
    quality: float
    interval: tuple[float, float] | None
    seconds: float
    measurable: bool | None


@dataclass(frozen=True)
class Across:
    """One configuration beside the base over several scenes.

    ``scenes`` counts those where both finished; ``gains`` per measure the mean over these scenes of the change, + is
    better; ``psnr_span`` the least and the greatest change of PSNR in one scene, dB; ``seconds`` the mean change of the
    time from nothing.
    """

    name: str
    scenes: int
    gains: Mapping[str, float]
    psnr_span: tuple[float, float]
    seconds: float


def quality(record: Record, measure: str) -> float | None:
    """The measure with greater = better, None for a failed run or one that was not measured."""
    sign = next(sign for name, *_, sign in MEASURES if name == measure)
    value = record.metrics.get(measure)
    return None if record.verdict != OK or value is None else sign * value


def measured(records: Sequence[Record]) -> list[str]:
    """The measures that at least one run has."""
    return [name for name, *_ in MEASURES if any(quality(record, name) is not None for record in records)]


def on_front(records: Sequence[Record], measure: str) -> list[Record]:
    """The runs that no other run dominates, cheapest first."""
    return [records[i] for i in front(*_plane(records, measure))]


def steps(records: Sequence[Record], measure: str) -> list[TradeoffStep]:
    """What each step along the Pareto front costs and gains."""
    runs = on_front(records, measure)
    return [
        TradeoffStep(a, b, quality(b, measure) - quality(a, measure), b.total_s - a.total_s, difference(a, b))  # type: ignore[operator]
        for a, b in pairwise(runs)
    ]


def difference(first: Record, second: Record) -> str:
    """The settings in which two runs differ, in words."""
    if first.preset != second.preset:
        return f"{_origin(first)} → {_origin(second)}"
    keys = [key for key in {**first.settings, **second.settings} if first.settings.get(key) != second.settings.get(key)]
    return "; ".join(f"{key}: {_told(first, key)} → {_told(second, key)}" for key in keys) or "nothing but chance"


def budgets(records: Sequence[Record], measure: str) -> list[tuple[float, Record | None]]:
    """The best run for each number of minutes; None where nothing is that cheap."""
    plane = _plane(records, measure)
    found = [(minutes, best_within(*plane, 60.0 * minutes)) for minutes in BUDGETS_MIN]
    return [(minutes, None if i is None else records[i]) for minutes, i in found]


def times_to_gain(records: Sequence[Record], measure: str) -> list[tuple[float, Record | None]]:
    """The cheapest run that reaches 90, 95, 99 % of the way from the cheapest run of the front to the best one."""
    runs = on_front(records, measure)
    if not runs:
        return []
    least, most = quality(runs[0], measure), quality(runs[-1], measure)
    plane = _plane(records, measure)
    found = [(share, cheapest_reaching(*plane, least + share * (most - least))) for share in _GAINS]  # type: ignore[operator]
    return [(share, None if i is None else records[i]) for share, i in found]


def spread_over_seeds(records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """Name of the first run of each group that differs in seeds only → mean, half range and number of PSNR over its
    seeds."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        if record.verdict == OK:
            told = {key: value for key, value in record.settings.items() if not key.endswith("seed")}
            groups.setdefault(repr((record.preset, sorted(told.items(), key=str))), []).append(record)
    found = {
        group[0].name: over_seeds([quality(r, "psnr") for r in group]) for group in groups.values() if len(group) > 1
    }
    return {name: spread for name, spread in found.items() if spread["seeds"] > 1}


def changes(records: Sequence[Record]) -> list[Change]:
    """Every run that turns one parameter, beside the base, by PSNR, greatest effect first.

    A change shows when its 95 % interval, over blocks of frames of the same cameras, leaves out 0, and it is larger
    than what seeds alone do to the base.
    """
    base = records[0]
    if quality(base, "psnr") is None or base.total_s is None:
        return []
    chance = spread_over_seeds(records).get(base.name, {}).get("half_range") or 0.0
    found = []
    for record in records[1:]:
        value = quality(record, "psnr")
        if record.parameter in ("", CHANCE) or not usable(record.total_s, value):
            continue
        paired = paired_difference({record.scene: (base.frames, record.frames)}, _BOOTSTRAP)
        shows = (
            None
            if paired["significant"] is None
            else bool(paired["significant"] and abs(paired["difference"]) > chance)
        )
        interval = None if paired["interval"] is None else (paired["interval"][0], paired["interval"][1])
        found.append(Change(record, value - quality(base, "psnr"), interval, record.total_s - base.total_s, shows))  # type: ignore[operator]
    return sorted(found, key=lambda change: (-abs(change.quality), change.record.name))


def idle_parameters(found: Sequence[Change]) -> list[str]:
    """Parameters none of whose levels shows an effect."""
    parameters = list(dict.fromkeys(change.record.parameter for change in found))
    return [
        parameter
        for parameter in parameters
        if all(c.measurable is False for c in found if c.record.parameter == parameter)
    ]


def across(scenes: Mapping[str, Sequence[Record]]) -> list[Across]:
    """Every configuration beside its scene's base (the first record), over the scenes where both finished, in the
    order of the first scene: a table of ablations (paper, section 4.3)."""
    found = []
    for name in dict.fromkeys(record.name for records in scenes.values() for record in records[1:]):
        pairs = [(records[0], r) for records in scenes.values() for r in records[1:] if r.name == name]
        seconds = [r.total_s - base.total_s for base, r in pairs if None not in (base.total_s, r.total_s)]  # type: ignore[operator]
        changed = {measure: [_gain(base, r, measure) for base, r in pairs] for measure, *_ in MEASURES}
        decibels = [value for value in changed["psnr"] if value is not None]
        if not seconds or not decibels:
            continue
        gains = {measure: [value for value in values if value is not None] for measure, values in changed.items()}
        mean = {measure: sum(v) / len(v) for measure, v in gains.items() if len(v) == len(decibels)}
        span = min(decibels), max(decibels)
        found.append(Across(name, len(decibels), mean, span, sum(seconds) / len(seconds)))
    return found


def agreement(scenes: Mapping[str, Sequence[Record]], measure: str) -> list[tuple[str, str, float | None, int]]:
    """Per pair of scenes: Kendall's tau of the order of the configurations that both ran, and how many those are."""
    values = {
        scene: {r.name: q for r in records if (q := quality(r, measure)) is not None and usable(r.total_s, q)}
        for scene, records in scenes.items()
    }
    names = list(values)
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    result = []
    for a, b in pairs:
        common = [name for name in values[a] if name in values[b]]
        result.append((a, b, kendall_tau([values[a][n] for n in common], [values[b][n] for n in common]), len(common)))
    return result


def _gain(base: Record, record: Record, measure: str) -> float | None:
    before, after = quality(base, measure), quality(record, measure)
    return None if before is None or after is None else after - before


def _plane(records: Sequence[Record], measure: str) -> tuple[list[float | None], list[float | None]]:
    return [record.total_s if record.verdict == OK else None for record in records], [
        quality(record, measure) for record in records
    ]


def _origin(record: Record) -> str:
    return f"preset {record.preset}" if record.preset else record.name


def _told(record: Record, key: str) -> str:
    return str(record.settings[key]) if key in record.settings else "as given"
