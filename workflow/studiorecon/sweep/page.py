# SPDX-License-Identifier: Apache-2.0
"""``sweep.page``: writes one page and one CSV on the cost of accuracy, from the records of one or several scenes."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import log10
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.pages import html
from studiorecon.progress import say
from studiorecon.report.metrics.bootstrap import Bootstrap, difference_interval
from studiorecon.report.sections.cost import pareto_front
from studiorecon.report.sections.tables import duration
from studiorecon.scene.files import read_json, write_text
from studiorecon.signature import Written

Record = Mapping[str, Any]
# Measure → heading, unit, digits.
MEASURES = {
    "psnr": ("PSNR ↑", "dB", 2),
    "ssim": ("SSIM ↑", "", 4),
    "lpips": ("LPIPS ↓", "", 4),
    "flip": ("ꟻLIP ↓", "", 4),
    "psnr_people": ("PSNR of people ↑", "dB", 2),
    "psnr_background": ("PSNR of the room ↑", "dB", 2),
    "psnr_unseen": ("PSNR of unseen surfaces ↑", "dB", 2),
    "warp_rms": ("Warp-RMS ↓", "", 5),
    "joints_mm": ("joint error ↓", "mm", 1),
    "jitter_mm_f2": ("jitter ↓", "mm/frame²", 2),
}
# Pixels of the chart: its size and margins.
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 1000, 420, 70, 24, 16, 46
_TIMES_S = (1, 3, 10, 30, 60, 120, 300, 600, 1200, 3600, 7200, 18000, 36000, 86400)
_BUDGETS_MIN = (1, 2, 5, 15, 60, 240)
_BOOTSTRAP = Bootstrap(1000, 0)


def run(records: list[Path], page: Written, table: Written) -> None:
    """Write the page, and ``table`` with all runs; refuses records of different machines, whose seconds differ."""
    if not records:
        raise UserError("name the records to show: --records results/SCENE/sweep/TABLE/ROW.json …")
    read = [read_json(path) for path in records]
    for path, record in zip(records, read):
        if record["machine"] != read[0]["machine"]:
            raise UserError(f"{path} was measured on another machine than {records[0]}: their seconds do not compare")
    scenes = {name: [r for r in read if r["scene"] == name] for name in dict.fromkeys(r["scene"] for r in read)}
    body = [f"<h1>What accuracy costs: {html.escape(', '.join(scenes))}</h1>"]
    for name, rows in scenes.items():
        body.append(scene_section(name, rows))
    if len(scenes) > 1:
        body.append(_mean_effects(scenes))
    machine = ", ".join(f"{key} {value}" for key, value in read[0]["machine"].items())
    body.append(f'<p class="soft">{html.escape(machine)}. Scoring and filming a synthetic studio are not counted.</p>')
    write_text(page, html.page("What accuracy costs", body))
    write_text(table, as_csv(read))
    say(f"the page needs no network: {page}")


def scene_section(scene: str, records: Sequence[Record]) -> str:
    """One scene: quality over time, the price of each step along the front, budgets, parameters, failures."""
    done = [record for record in records if not record["failed"]]
    parts = [html.heading(scene, f"{len(records)} configurations, {len(records) - len(done)} failed")]
    if done:
        names = [r["name"] for r in done]
        seconds, psnr = [r["from_nothing_s"] for r in done], [r["metrics"]["psnr"] for r in done]
        parts += [chart(names, seconds, psnr, "PSNR at held-out cameras, dB ↑"), _prices(done), _budgets(done)]
        parts += [_effects(records[0], done), _all(done)]
    if failures := [[r["name"], duration(r["wall_s"]), r["failed"]] for r in records if r["failed"]]:
        parts.append("<h3>Failed runs</h3>" + html.table(["configuration", "after", "reason"], failures, numeric=(1,)))
    return "".join(parts)


def parameter_effects(base: Record, records: Sequence[Record]) -> list[tuple[Record, float, list[float] | None, float]]:
    """Per run that changes one parameter: record, change of PSNR (dB), its interval, change of seconds; largest first.

    The 95 % interval is over blocks of frames; None when there are too few.
    """
    found = []
    for record in records:
        if not base["failed"] and record["parameter"] and not record["failed"]:
            interval = difference_interval(base["frames"], record["frames"], _BOOTSTRAP)
            gain_db = record["metrics"]["psnr"] - base["metrics"]["psnr"]
            found.append((record, gain_db, interval, record["from_nothing_s"] - base["from_nothing_s"]))
    return sorted(found, key=lambda entry: (-abs(entry[1]), entry[0]["name"]))


def mean_effects(scenes: Mapping[str, Sequence[Record]]) -> list[dict[str, Any]]:
    """Per configuration that finished in every scene: mean change of each measure, PSNR's range, and seconds.

    Changes are relative to the scene's base, its first record (paper, section 4.3).
    """
    found = []
    for name in dict.fromkeys(r["name"] for rows in scenes.values() for r in rows[1:]):
        pairs = [(rows[0], r) for rows in scenes.values() for r in rows if r["name"] == name and not r["failed"]]
        if len(pairs) < len(scenes) or any(base["failed"] for base, _ in pairs):
            continue
        changes: dict[str, float] = {}
        for measure in MEASURES:
            values = [(base["metrics"].get(measure), r["metrics"].get(measure)) for base, r in pairs]
            if all(before is not None and after is not None for before, after in values):
                changes[measure] = sum(after - before for before, after in values) / len(values)
        decibels = [r["metrics"]["psnr"] - base["metrics"]["psnr"] for base, r in pairs]
        seconds = sum(r["from_nothing_s"] - base["from_nothing_s"] for base, r in pairs) / len(pairs)
        span = [min(decibels), max(decibels)]
        found.append({"name": name, "changes": changes, "psnr_span_db": span, "seconds": seconds})
    return found


def as_csv(records: Sequence[Record]) -> str:
    """All runs as CSV; values that were not measured are empty."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    costs = ("from_nothing_s", "ran_s", "processor_s", "wall_s", "peak_memory_mb")
    writer.writerow(["scene", "name", "parameter", "preset", "failed", *MEASURES, *costs, "settings"])
    for r in records:
        values = [r.get("metrics", {}).get(measure) for measure in MEASURES] + [r.get(cost) for cost in costs]
        settings = "; ".join(f"{key}={value}" for key, value in r["settings"].items())
        writer.writerow([r["scene"], r["name"], r["parameter"], r["preset"], r["failed"], *values, settings])
    return file.getvalue()


def _prices(done: Sequence[Record]) -> str:
    runs = [done[i] for i in pareto_front([r["from_nothing_s"] for r in done], [r["metrics"]["psnr"] for r in done])]
    rows = []
    for cheaper, dearer in pairwise(runs):
        gain_db = dearer["metrics"]["psnr"] - cheaper["metrics"]["psnr"]
        step_s = dearer["from_nothing_s"] - cheaper["from_nothing_s"]
        before, after = cheaper["settings"], dearer["settings"]
        keys = [key for key in {**before, **after} if before.get(key) != after.get(key)]
        change = "; ".join(f"{key}: {before.get(key, 'as given')} → {after.get(key, 'as given')}" for key in keys)
        rows.append([f"{cheaper['name']} → {dearer['name']}", f"{gain_db:+.2f} dB", f"+{duration(step_s)}", change])
    return "<h3>Price list</h3>" + html.table(["step along the front", "PSNR", "time", "change"], rows, numeric=(1, 2))


def _budgets(done: Sequence[Record]) -> str:
    rows = []
    for minutes in _BUDGETS_MIN:
        if affordable := [r for r in done if r["from_nothing_s"] <= 60 * minutes]:
            best = max(affordable, key=lambda r: r["metrics"]["psnr"])
            rows.append([f"{minutes} min", best["name"], f"{best['metrics']['psnr']:.2f} dB"])
    return "<h3>Budgets</h3>" + html.table(["for", "choose", "PSNR"], rows, numeric=(2,))


def _effects(base: Record, done: Sequence[Record]) -> str:
    rows = []
    for record, gain_db, interval, step_s in parameter_effects(base, done):
        span = "too few frames" if interval is None else f"{interval[0]:+.2f} … {interval[1]:+.2f} dB"
        effect = "?" if interval is None else "no" if interval[0] <= 0 <= interval[1] else "yes"
        rows.append([record["parameter"], record["name"], f"{gain_db:+.2f} dB", span, effect, f"{step_s:+.0f} s"])
    header = ["parameter", "value", "PSNR", "95 % interval", "measurable", "time"]
    return f"<h3>Parameters, one at a time compared with {html.escape(base['name'])}</h3>" + html.table(
        header, rows, (2, 3, 5)
    )


def _all(done: Sequence[Record]) -> str:
    shown = [name for name in MEASURES if any(r["metrics"].get(name) is not None for r in done)]
    header = ["configuration", *(MEASURES[name][0] for name in shown), "time", "processor", "largest job"]
    rows = []
    for r in done:
        values = [r["metrics"].get(name) for name in shown]
        cells = ["–" if v is None else f"{v:.{MEASURES[n][2]}f} {MEASURES[n][1]}" for n, v in zip(shown, values)]
        costs = [duration(r["from_nothing_s"]), duration(r["processor_s"]), f"{r['peak_memory_mb']:.0f} MB"]
        rows.append([r["name"], *cells, *costs])
    return "<details><summary>All runs</summary>" + html.table(header, rows, range(1, len(header))) + "</details>"


def _mean_effects(scenes: Mapping[str, Sequence[Record]]) -> str:
    rows = []
    for entry in mean_effects(scenes):
        low, high = entry["psnr_span_db"]
        psnr = f"{entry['changes']['psnr']:+.2f} dB ({low:+.2f} … {high:+.2f})"
        others = [n for n in MEASURES if n != "psnr" and n in entry["changes"]]
        rest = "; ".join(f"{MEASURES[n][0]} {entry['changes'][n]:+.{MEASURES[n][2]}f}" for n in others)
        rows.append([entry["name"], psnr, f"{entry['seconds']:+.0f} s", rest])
    header = ["configuration", "PSNR: mean (least … greatest)", "time", "other measures"]
    return f"<h2>Mean over {len(scenes)} scenes</h2>" + html.table(header, rows, numeric=(1, 2))


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
        tip = f"<title>{html.escape(f'{name}: {qualities[i]:.2f}, {duration(seconds[i])}')}</title>"
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
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" style="fill:var(--soft)">{html.escape(content)}</text>'
    )
