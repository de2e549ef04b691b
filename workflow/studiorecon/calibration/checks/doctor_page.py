# SPDX-License-Identifier: Apache-2.0
"""The doctor's page: one self-contained HTML file, verdict first."""

from __future__ import annotations

import base64
from typing import Any

from studiorecon.calibration.checks.advice import HEADLINES, edge_agreement_note
from studiorecon.pages import skeleton

_COLOURS = {"good": "#1a7f37", "usable": "#9a6700", "check": "#9a6700", "cannot tell": "#9a6700", "wrong": "#cf222e"}
_STYLE = """
main { max-width: 1250px; }
.verdict { border-left: .5rem solid var(--c); padding: .5rem 1rem; background: var(--wash); }
.verdict b { color: var(--c); }
.bad { color: #cf222e; font-weight: 600; }
"""
_BODY = """
<h1>Cameras of {{ scene }}</h1>
<div class="verdict" style="--c:{{ colour }}"><b>{{ report.verdict.capitalize() }}.</b> {{ headline }}</div>
{% if report.sync.sentences %}
<h2>Clocks</h2><ul>{% for sentence in report.sync.sentences %}<li>{{ sentence }}</li>{% endfor %}</ul>
{% endif %}
<h2>What to check</h2><ul>{% for a in report.advice %}<li>{{ a }}</li>{% else %}<li>Nothing.</li>{% endfor %}</ul>
{% if report.notes %}
<h2>The folder</h2><ul>{% for note in report.notes %}<li>{{ note }}</li>{% endfor %}</ul>
{% endif %}
{% if edges %}
<h2>The room's straight edges</h2><p>{{ edges[:1].upper() }}{{ edges[1:] }}.</p>
{% endif %}
<p><img alt="every camera with people's joints projected back into it, and all cameras from above"
src="{{ sheet }}"></p>
<p class="soft">{{ caption }}</p>
<h2>Cameras</h2>
<div class="scroll"><table><tr>{% for h in head %}<th>{{ h }}</th>{% endfor %}</tr>
{% for row in cameras %}
<tr>{% for cell, bad in row %}
<td>{% if bad %}<span class="bad">{{ cell }}</span>{% else %}{{ cell }}{% endif %}</td>{% endfor %}</tr>
{% endfor %}
</table></div>
<p class="soft">Lag: the camera's remaining time offset from the others by people,
with its 95 % interval.</p>
<h2>Possible conventions of the calibration</h2>
<div class="scroll"><table>
<tr><th>reading</th><th>agreement of people's rays, 0 to 1</th><th>to use it</th></tr>
{% for r in readings %}
<tr><td>{% if r.best %}<b>{{ r.name }}</b>{% else %}{{ r.name }}{% endif %}</td><td>{{ r.score }}</td>
<td>{{ r.remedy }}</td></tr>
{% endfor %}
</table></div>
<h2>Coverage</h2>
<p>Share of the volume around the {{ "people" if report.people else "point the cameras face" }}
(radius {{ "%.1f" % report.reach_m }} m, 2.2 m high) that so many cameras see: {{ covered }}.</p>
<p>Sectors wider than 90° without a camera (counter-clockwise from x): {{ blind }}.</p>
"""
_HEAD = (
    *("camera", "px off", "lag, frames", "view", "height", "size", "fps", "frames", "rotation tag"),
    *("mean grey", "burnt out"),
)


def page(scene: str, report: dict[str, Any], sheet_png: bytes) -> str:
    """The page of ``report`` (see ``doctor.examine``) with the contact sheet (PNG)."""
    body = skeleton.fill_template(
        _BODY,
        scene=scene,
        report=report,
        colour=_COLOURS[report["verdict"]],
        headline=HEADLINES[report["verdict"]],
        sheet="data:image/png;base64," + base64.b64encode(sheet_png).decode("ascii"),
        edges=edge_agreement_note(report),
        caption=_caption(report),
        head=_HEAD,
        cameras=[_camera(report, name) for name in report["footage"]],
        readings=_readings(report),
        covered=", ".join(f"{n} or more: {v:.0%}" for n, v in report["coverage"].items()),
        blind=", ".join(f"{a:.0f}° to {b % 360:.0f}°" for a, b in report["blind_sectors_deg"]) or "none",
    )
    return skeleton.page(f"Doctor: {scene}", [body], _STYLE)


def _caption(report: dict[str, Any]) -> str:
    if report["shown_frame"] is None:
        return "No joints could be measured. From above: the cameras' calibrated positions and directions."
    return (
        f"Frame {report['shown_frame']} without lens distortion. Rings: the keypoints. Green dots: joints "
        "triangulated from all cameras and projected back. If rings miss the joints, the keypoints are of another "
        "size, frame or camera. If dots miss the rings, the calibration or a time offset is wrong. From above: the "
        "cameras' calibrated positions and directions, and the triangulated joints."
    )


def _camera(report: dict[str, Any], camera: str) -> list[tuple[str, bool]]:
    """A camera's cells, and whether each reports a problem."""
    a, facts = report["footage"][camera], report["facts"][camera]
    plain = (
        f"{facts['field_deg']:.0f}°",
        f"{facts['height_m']:.2f} m",
        f"{a['wh'][0]}×{a['wh'][1]}",
        f"{a['fps']:g}",
        str(a["video_frames"]),
        f"{a['rotation_deg']}°",
        f"{a['brightness']:.2f}",
        f"{a['burnt']:.1%}",
    )
    px = _number(report["px_per_camera"][camera], ".1f")
    lag = _lag(report["sync"]["lags_frames"].get(camera))
    return [(camera, False), (px, False), lag, *((cell, False) for cell in plain)]


def _readings(report: dict[str, Any]) -> list[dict[str, Any]]:
    best = max(row["score"] for row in report["hypotheses"])
    return [
        {
            "name": h["hypothesis"],
            "best": h["score"] == best > 0,
            "score": f"{h['score']:.3f}",
            "remedy": h["remedy"],
        }
        for h in report["hypotheses"]
    ]


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _lag(lag: dict[str, Any] | None) -> tuple[str, bool]:
    """A camera's lag in words, and whether it is wrong."""
    if lag is None:
        return "undetermined", False
    return f"{lag['frames']:+.1f} ({lag['low']:+.1f} to {lag['high']:+.1f})", not lag["low"] <= 0 <= lag["high"]
