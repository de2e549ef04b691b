# SPDX-License-Identifier: Apache-2.0
"""The doctor's page: one self-contained HTML file, verdict first."""

from __future__ import annotations

import base64
import html
from typing import Any

from studiorecon.cameras.advice import CLEAR_MARGIN, HEADLINES
from studiorecon.cameras.hypotheses import MOST_MARGIN

_COLOURS = {"good": "#1a7f37", "usable": "#9a6700", "check": "#9a6700", "cannot tell": "#9a6700", "wrong": "#cf222e"}
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1250px;padding:0 1rem;color:#222}img{max-width:100%;display:block}"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}"
    "td,th{padding:.25rem .8rem;border-bottom:1px solid #ddd;text-align:left}"
    ".verdict{border-left:.5rem solid var(--c);padding:.5rem 1rem;background:#f6f8fa}.verdict b{color:var(--c)}"
    ".bad{color:#cf222e;font-weight:600}.note{color:#555}"
)


def page(scene: str, report: dict[str, Any], sheet_png: bytes) -> str:
    """The page of ``report`` (see ``doctor.examined``) with the contact sheet (PNG)."""
    items = "".join(f"<li>{html.escape(a)}</li>" for a in report["advice"]) or "<li>Nothing.</li>"
    picture = base64.b64encode(sheet_png).decode("ascii")
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Doctor: {html.escape(scene)}</title><style>{_STYLE}</style>'
        f'<h1>Cameras of {html.escape(scene)}</h1><div class="verdict" style="--c:{_COLOURS[report["verdict"]]}">'
        f"<b>{report['verdict'].capitalize()}.</b> {html.escape(HEADLINES[report['verdict']])}</div>"
        f"{_clocks(report)}<h2>What to check</h2><ul>{items}</ul>"
        '<p><img alt="every camera with people\'s joints projected back into it, and all cameras from above" '
        f'src="data:image/png;base64,{picture}"></p>'
        f'<p class="note">{_caption(report)}</p>'
        f"<h2>Cameras</h2>{_cameras(report)}{_readings(report)}{_volume(report)}</html>\n"
    )


def _clocks(report: dict[str, Any]) -> str:
    """When every camera was started, first of all: nothing else can be right when that is wrong."""
    told = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in report["sync"]["sentences"])
    return f"<h2>Clocks</h2><ul>{told}</ul>" if told else ""


def _caption(report: dict[str, Any]) -> str:
    if report["shown_frame"] is None:
        return "No joints could be measured. From above: where the calibration says the cameras stand and look."
    return (
        f"Frame {report['shown_frame']} without lens distortion. Rings: the keypoints that were given. Green dots: joints measured by all "
        "cameras together and projected back. Rings off the joints: keypoints of another size, frame or camera. Dots off the rings: "
        "the calibration or a clock is off. From above: where the calibration says the cameras stand and look, and the measured joints."
    )


def _cameras(report: dict[str, Any]) -> str:
    head = (
        "camera",
        "px off",
        "margin",
        "lag, frames",
        "view",
        "height",
        "size",
        "fps",
        "frames",
        "rotation tag",
        "mean grey",
        "burnt out",
    )
    rows = []
    for camera, a in report["footage"].items():
        margin, facts = report["margin"][camera], report["facts"][camera]
        clear = margin is not None and margin >= CLEAR_MARGIN
        shown = "–" if margin is None else f"≥ {MOST_MARGIN:g}" if margin >= MOST_MARGIN else f"{margin:.1f}"
        cells = [
            html.escape(camera),
            _number(report["px_per_camera"][camera], ".1f"),
            shown if clear or not report["people"] or camera in report["without_keypoints"] else f'<span class="bad">{shown}</span>',
            _lag(report["lags_frames"].get(camera)),
            f"{facts['field_deg']:.0f}°",
            f"{facts['height_m']:.2f} m",
            f"{a['wh'][0]}×{a['wh'][1]}",
            f"{a['fps']:g}",
            str(a["video_frames"]),
            f"{a['rotation_deg']}°",
            f"{a['brightness']:.2f}",
            f"{a['burnt']:.1%}",
        ]
        rows.append("<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>")
    return (
        "<table><tr>" + "".join(f"<th>{h}</th>" for h in head) + f"</tr>{''.join(rows)}</table>"
        f'<p class="note">Margin: how many times better this camera fits the people as read than under the best other reading of its pose; '
        f"from {CLEAR_MARGIN} on it is clear. Lag: how much later than the others its people still come "
        "with these clocks, with the interval that fits as well.</p>"
    )


def _readings(report: dict[str, Any]) -> str:
    best = max(row["score"] for row in report["hypotheses"])
    px = {"as read": report["median_px"], **{h["hypothesis"]: h["median_px"] for h in report["hypotheses"] if "median_px" in h}}
    rows = "".join(
        f"<tr><td>{'<b>' if h['score'] == best > 0 else ''}{html.escape(h['hypothesis'])}{'</b>' if h['score'] == best > 0 else ''}</td>"
        f"<td>{h['score']:.3f}</td><td>{_number(px.get(h['hypothesis']), '.1f')}</td><td>{html.escape(h['remedy'])}</td></tr>"
        for h in report["hypotheses"]
    )
    return (
        "<h2>How the calibration could be read</h2><table><tr><th>reading</th><th>agreement of people's rays, 0 to 1</th>"
        f"<th>px off</th><th>if this is the right one</th></tr>{rows}</table>"
    )


def _volume(report: dict[str, Any]) -> str:
    covered = ", ".join(f"{n} or more: {v:.0%}" for n, v in report["coverage"].items())
    blind = ", ".join(f"{a:.0f}° to {b % 360:.0f}°" for a, b in report["blind_sectors_deg"]) or "none"
    return (
        f"<h2>Coverage</h2><p>Share of the volume around the {'people' if report['people'] else 'place the cameras look at'} "
        f"(radius {report['reach_m']:.1f} m, 2.2 m high) that so many cameras see: {covered}.</p>"
        f"<p>Sectors wider than 90° without a camera (counter-clockwise from x): {blind}.</p>"
    )


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _lag(lag: dict[str, Any] | None) -> str:
    if lag is None or not lag["valid"]:
        return "undetermined"
    text = f"{lag['frames']:+.1f} ({lag['low']:+.1f} to {lag['high']:+.1f})"
    return text if lag["low"] <= 0 <= lag["high"] else f'<span class="bad">{text}</span>'
