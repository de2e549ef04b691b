# SPDX-License-Identifier: Apache-2.0
"""The page's section on what accuracy costs, made of a sweep's records."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from studiorecon.pages import html
from studiorecon.report.sections.charts import Effect, Point, plane, stacked, tornado
from studiorecon.report.sections.tables import MISSING, duration, shown
from studiorecon.sweep.records import OK, Record
from studiorecon.sweep.runs_csv import as_csv, in_order
from studiorecon.sweep.tradeoff import (
    MEASURES,
    across,
    agreement,
    budgets,
    changes,
    idle_parameters,
    measured,
    on_front,
    quality,
    spread_over_seeds,
    steps,
    times_to_gain,
)

_SHOWN_STAGES = 8
# Below this, what else runs on the machine hardly moves seconds.
_QUIET_CORES = 0.2


def single(metrics: Mapping[str, Any], spent: Mapping[str, Any], budget: Mapping[str, Any]) -> str:
    """What this one run cost and reached, in one sentence and three numbers; what was predicted where a ``budget``
    chose its preset (``plan.budget.Choice.as_json``)."""
    if spent["reason"]:
        return html.heading("What accuracy costs") + f"<p>{MISSING}: {html.text(spent['reason'])}.</p>"
    seconds = {stage: entry["seconds"] or 0.0 for stage, entry in spent["stages"].items()}
    dearest = sorted(seconds, key=seconds.__getitem__, reverse=True)[:3]
    share = sum(seconds[stage] for stage in dearest) / (sum(seconds.values()) or 1.0)
    final = metrics["pictures"].get("enhanced", metrics["pictures"].get("raw", {})).get("psnr", {})
    reached = shown(final.get("value"), 2, "dB")
    parts = ", ".join(f"{stage} {duration(seconds[stage])}" for stage in dearest)
    took = duration(spent["total"]["seconds"])
    sentence = f"On this machine: {took} → {reached} at held-out cameras; {100 * share:.0f} % of it is {parts}."
    tiles = [
        (reached, "PSNR at held-out cameras"),
        (duration(spent["total"]["seconds"]), "all jobs, one after the other"),
        (shown(spent["total"]["peak_memory_mb"], 0, "MB"), "memory of the largest job"),
    ]
    lead = (
        "One run is one point. snakemake sweep runs others on the same scene and adds the "
        "front, prices and which settings matter."
    )
    told = f"<p>{html.text(_bought(budget, spent))}</p>" if budget else ""
    return html.heading("What accuracy costs", lead) + f"<p><b>{html.text(sentence)}</b></p>" + html.tiles(tiles) + told


def _bought(budget: Mapping[str, Any], spent: Mapping[str, Any]) -> str:
    predicted = duration(budget["predicted_s"])
    ends = f"{duration(budget['low_s'])} to {duration(budget['high_s'])}"
    took = spent["total"]["cpu_seconds"]
    return (
        f"A budget of {budget['minutes']:g} min chose {budget['preset'] or 'the defaults'}: predicted {predicted} from "
        f"nothing ({ends}). Its jobs were predicted to take {duration(budget['work_s'])} of processor time and took "
        f"{duration(took) if took else MISSING}. {budget['more'][:1].upper()}{budget['more'][1:]}."
    )


def section(table: str, records: Sequence[Record]) -> str:
    """Everything about one sweep of one scene."""
    good = [record for record in records if record.verdict == OK]
    if not good:
        return html.heading(
            "What other settings cost", f"None of the {len(records)} configurations of {table} finished."
        ) + _failures(records)
    parts = [
        _head(table, records),
        _planes(records),
        _prices(records),
        _stages(records),
        _effects(records),
        _worst(records),
    ]
    return "".join([*parts, _failures(records), _all(records), _colophon(records)])


def scenes_section(scenes: Mapping[str, Sequence[Record]]) -> str:
    """The fronts of several scenes side by side, and whether they order the configurations alike."""
    if len(scenes) < 2:
        return ""
    figures = [_plane(records, "psnr", f"{scene}: PSNR over time") for scene, records in scenes.items()]
    rows = [
        [a, b, "no order to compare" if tau is None else f"{tau:+.2f}", str(count)]
        for a, b, tau, count in agreement(scenes, "psnr")
    ]
    lead = (
        "Kendall's tau: +1 when two scenes put the configurations into the same order by "
        "PSNR, 0 when one says nothing about the other."
    )
    table = html.table(["scene", "scene", "tau", "configurations in both"], rows, numeric=(2, 3))
    return html.heading("Does it depend on the scene?", lead) + html.row(figures, 2) + table + _across(scenes)


def _across(scenes: Mapping[str, Sequence[Record]]) -> str:
    found = across(scenes)
    shown_measures = [entry for entry in MEASURES if any(entry[0] in change.gains for change in found)]
    rows = []
    for change in found:
        # Differences as the field prints them: with the measure's own sign.
        told = [
            f"{sign * change.gains[name] + 0.0:+.{digits}f}" if name in change.gains else MISSING
            for name, _, _, digits, sign in shown_measures
        ]
        span = f"{change.psnr_span[0]:+.2f} … {change.psnr_span[1]:+.2f}"
        rows.append([change.name, f"{change.scenes} of {len(scenes)}", *told, span, f"{change.seconds:+.0f} s"])
    lead = (
        "Every configuration minus the base (the first run of each scene), mean over the scenes where both finished; "
        "in one scene: the least and the greatest change of PSNR."
    )
    headings = [f"{heading} {'↑' if sign > 0 else '↓'}" for _, heading, _, _, sign in shown_measures]
    header = ["configuration", "scenes", *headings, "in one scene, dB", "time from nothing"]
    return f'<h3>Every change, over all scenes</h3><p class="soft">{html.text(lead)}</p>' + html.table(
        header, rows, numeric=range(1, len(header))
    )


def _head(table: str, records: Sequence[Record]) -> str:
    runs = on_front(records, "psnr")
    knee = next((record for share, record in times_to_gain(records, "psnr") if share == 0.95), None) or runs[0]
    picked = list(dict.fromkeys([runs[0].name, knee.name, runs[-1].name]))
    three = [next(r for r in records if r.name == name) for name in picked]
    sentence = "; ".join(f"{r.name}: {duration(r.total_s)} → {shown(quality(r, 'psnr'), 2, 'dB')}" for r in three)
    lead = (
        f"{len(records)} configurations of {table}, scored at the held-out cameras. "
        "Seconds are what each needs from nothing."
    )
    said = ("cheapest", "95 % of the gain", "best") if len(three) == 3 else [""] * len(three)
    tiles = [
        (f"{quality(r, 'psnr'):.2f} dB", f"{s + ': ' if s else ''}{r.name}, {duration(r.total_s)}")
        for r, s in zip(three, said)
    ]
    return (
        html.heading("What other settings cost", lead)
        + f"<p><b>On this machine: {html.text(sentence)}.</b></p>"
        + html.tiles(tiles)
    )


def _plane(records: Sequence[Record], measure: str, title: str) -> str:
    _, heading, unit, digits, sign = next(entry for entry in MEASURES if entry[0] == measure)
    runs, spread = on_front(records, measure), spread_over_seeds(records) if measure == "psnr" else {}
    # Quality is turned so that up is better; the axis says when that turned the sign.
    points: list[Point] = []
    index: dict[str, int] = {}
    for record in records:
        value = quality(record, measure)
        if value is None or not record.total_s:
            continue
        index[record.name] = len(points)
        best = record in runs
        label = record.name if best or record.preset or record is records[0] else ""
        told = f"{record.name}: {shown(sign * value, digits, unit)}, {duration(record.total_s)}"
        points.append(Point(record.total_s, value, label, told, best, spread.get(record.name, {}).get("half_range")))
    crosses = [(max(r.total_s or 0.1, 0.1), f"{r.name}: {r.sentence}") for r in records if r.verdict != OK]
    interval = runs[-1].intervals.get(measure) if runs else None
    band = sorted(sign * v for v in interval) if interval else None
    axis = f"{heading} {unit}".strip() + (" ↑" if sign > 0 else ", minus sign: up is better ↑")
    return plane(title, axis, points, [index[run.name] for run in runs], crosses, band)


def _planes(records: Sequence[Record]) -> str:
    legend = (
        "Filled: no other run is both cheaper and better. Hollow: some run is. Crosses on the axis: runs that failed. "
    )
    legend += "Band: 95 % interval of the best run."
    parts = [f'<p class="soft">{html.text(legend)}</p>', _plane(records, "psnr", "PSNR over time")]
    for name, heading, *_ in MEASURES:
        if name != "psnr" and name in measured(records):
            chart = _plane(records, name, f"{heading} over time")
            parts.append(f"<details><summary>The same for {html.text(heading)}</summary>{chart}</details>")
    missing = [heading for name, heading, *_ in MEASURES if name not in measured(records)]
    if missing:
        parts.append(f'<p class="soft">Not measured in any run: {html.text(", ".join(missing))}.</p>')
    return "".join(parts)


def _prices(records: Sequence[Record]) -> str:
    rows = [
        [f"{s.cheaper.name} → {s.dearer.name}", f"{s.gain:+.2f} dB", f"+{duration(s.seconds)}", s.changed]
        for s in steps(records, "psnr")
    ]
    parts = ["<h3>Price list</h3>"]
    if rows:
        parts.append(html.table(["step along the front", "PSNR", "time", "by changing"], rows, numeric=(1, 2)))
    else:
        parts.append("<p>One run is the cheapest and the best: nothing more can be bought with these parameters.</p>")
    reached = [
        [f"{100 * share:.0f} % of the gain", run.name if run else "–", duration(run.total_s) if run else "–"]
        for share, run in times_to_gain(records, "psnr")
    ]
    parts.append(html.table(["to reach", "take", "time"], reached, numeric=(2,)))
    affordable = [
        [
            f"{minutes} min",
            run.name if run else "nothing is that cheap",
            shown(quality(run, "psnr"), 2, "dB") if run else "–",
            duration(run.total_s) if run else "–",
        ]
        for minutes, run in budgets(records, "psnr")
    ]
    parts.append(
        "<h3>What a budget buys</h3>" + html.table(["for", "choose", "PSNR", "it takes"], affordable, numeric=(2, 3))
    )
    return "".join(parts)


def _stages(records: Sequence[Record]) -> str:
    picked = [records[0], *(r for r in records if r.preset), *on_front(records, "psnr")]
    rows = {
        r.name: (r.name, {s: r.stages[s] for s in in_order(r.stages)}, r.ran_stages) for r in picked if r.verdict == OK
    }
    legend = "Hatched: taken over from an earlier run of this sweep, and charged all the same."
    return f'<h3>Where the time goes</h3><p class="soft">{legend}</p>' + stacked(
        "Seconds per stage", list(rows.values())[: _SHOWN_STAGES + 4]
    )


def _effects(records: Sequence[Record]) -> str:
    found = changes(records)
    if not found:
        return ""
    bars = [
        Effect(f"{c.record.parameter}: {c.record.name}", c.quality, c.interval, c.seconds, c.measurable is not False)
        for c in found
    ]
    lead = (
        f"One parameter at a time, beside {records[0].name}. Line: 95 % interval "
        "over frames. Pale: no measurable effect."
    )
    chance = spread_over_seeds(records).get(records[0].name)
    if chance:
        half = (
            f"± {chance['half_range']:.2f} dB over {chance['seeds']} seeds"
            if chance["half_range"] is not None
            else "two seeds only"
        )
        lead += f" Chance alone: {half}."
    idle = idle_parameters(found)
    said = f"<p>No measurable effect here: {html.text(', '.join(idle))}.</p>" if idle else ""
    if any(c.measurable is None for c in found):
        said += "<p>The clip is too short for intervals over frames: what is real here cannot be told.</p>"
    return (
        f'<h3>Which parameters matter</h3><p class="soft">{html.text(lead)}</p>'
        + tornado("Effect of every parameter", "change of PSNR, dB", bars)
        + said
    )


def _worst(records: Sequence[Record]) -> str:
    rows = [
        [
            r.name,
            shown(quality(r, "psnr"), 2, "dB"),
            f"{r.worst['camera']}: {r.worst['camera_psnr']:.2f} dB",
            f"{r.worst['frame_camera']}, frame {r.worst['frame']}: {r.worst['frame_psnr']:.2f} dB",
            shown(r.metrics.get("joints_mm"), 1, "mm"),
            shown(r.metrics.get("people_missed"), 0),
        ]
        for r in on_front(records, "psnr")
        if r.worst
    ]
    lead = (
        '<h3>Not only the mean</h3><p class="soft">A cheap run may win on average and '
        "lose a camera, a moment or a person.</p>"
    )
    header = ["on the front", "mean", "worst camera", "worst frame", "joints", "people missed"]
    return lead + html.table(header, rows, numeric=(1, 4, 5))


def _failures(records: Sequence[Record]) -> str:
    rows = [[r.name, duration(r.seconds.get("wall")), r.sentence] for r in records if r.verdict != OK]
    return "<h3>What failed</h3>" + html.table(["configuration", "after", "why"], rows, numeric=(1,)) if rows else ""


def _all(records: Sequence[Record]) -> str:
    names = measured(records)
    digits = {name: digits for name, _, _, digits, _ in MEASURES}
    header = [
        "configuration",
        *(heading for name, heading, *_ in MEASURES if name in names),
        "from nothing",
        "processor",
        "marginal",
        "largest job",
    ]
    rows = []
    for r in records:
        values = [shown(r.metrics.get(n), digits[n]) if r.verdict == OK else r.verdict for n in names]
        spent = [duration(r.seconds.get(name)) for name in ("from_nothing", "cpu", "marginal")]
        rows.append([r.name, *values, *spent, shown(r.peak_memory_mb, 0, "MB")])
    address = "data:text/csv;base64," + base64.b64encode(as_csv(records).encode()).decode()
    link = f'<p><a download="sweep.csv" href="{address}">All runs as CSV</a></p>'
    return (
        "<details><summary>All runs</summary>"
        + html.table(header, rows, numeric=range(1, len(header)))
        + "</details>"
        + link
    )


def _colophon(records: Sequence[Record]) -> str:
    first = records[0]
    machine = ", ".join(str(first.machine[key]) for key in ("processor", "system") if key in first.machine)
    cores, memory = first.machine.get("cores"), first.machine.get("memory_gb")
    versions = ", ".join(f"{name} {version}" for name, version in first.versions.items())
    seeds = ", ".join(f"{key} {value}" for key, value in first.seeds.items()) or MISSING
    ran = sum(r.seconds.get("wall") or 0.0 for r in records)
    shared = sum(r.seconds.get("ran") or 0.0 for r in records), sum(r.total_s or 0.0 for r in records)
    said = (
        f"{machine}, {cores} cores, {memory} GB. {versions}. Seeds: {seeds}. The sweep "
        f"took {duration(ran)} by the clock; its jobs "
        f"{duration(shared[0])}, where every run on its own would have taken "
        f"{duration(shared[1])}. Filming a synthetic studio and scoring "
        f"are not charged. {len(records)} runs, {sum(r.verdict != OK for r in records)} failed, none left out."
    )
    busiest = max(r.others_cores for r in records)
    if busiest > _QUIET_CORES:
        said += (
            f" Something else kept up to {busiest:.1f} cores busy meanwhile: trust "
            "processor seconds more than the clock."
        )
    return f'<p class="soft">{html.text(said)}</p>'
