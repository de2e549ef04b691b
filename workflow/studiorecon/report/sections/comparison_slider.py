# SPDX-License-Identifier: Apache-2.0
"""A figure of two pictures of one moment with a slider that moves the line between them, by mouse, touch or keys."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from studiorecon.pages.html import escape

STYLE = """
.wipe { position: relative; --cut: 50%; margin: 12px 0 4px; }
.wipe img { width: 100%; border-radius: 8px; }
.wipe img + img { position: absolute; inset: 0; height: 100%; clip-path: inset(0 0 0 var(--cut)); }
.wipe i { position: absolute; top: 0; bottom: 0; left: var(--cut); width: 2px; background: #fff; box-shadow: 0 0 3px
#000; }
.controls { display: flex; flex-wrap: wrap; gap: 8px 14px; align-items: center; font-size: 14px; color: var(--soft); }
.controls input[type=range] { flex: 1 1 220px; accent-color: var(--mark); }
.controls select { font: inherit; color: var(--ink); background: var(--wash); border: 1px solid var(--line);
border-radius: 6px; }
@media print { .controls { display: none; } }
"""

# One function serves all sliders of the page: it searches the figure of the control that fired.
_SCRIPT = """
function wipe(control) {
  const figure = control.closest('figure'), shown = figure.querySelectorAll('.wipe img');
  const made = JSON.parse(figure.querySelector('script').textContent);
  const moment = made[figure.querySelector('.moment').value];
  figure.querySelectorAll('.version').forEach((choice, side) => {
    shown[side].src = moment.pictures[choice.value]; shown[side].alt = choice.value + ', ' + moment.caption;
  });
  figure.querySelector('.wipe').style.setProperty('--cut', figure.querySelector('input').value + '%');
}
"""


def slider(moments: Sequence[tuple[str, Mapping[str, str]]], left: str, right: str) -> str:
    """A figure that compares two versions of one moment; empty without moments.

    ``moments`` are (caption, version → picture's data address) with equal versions; ``left`` and ``right`` are shown
    first. Every picture is stored once, as JSON, and the two that are shown also work without a script.
    """
    if not moments:
        return ""
    caption, first = moments[0]
    if any(set(versions) != set(first) for _, versions in moments) or left not in first or right not in first:
        raise ValueError(f"every moment needs the same versions, {left} and {right} among them")
    # "</" would end the script element that holds the JSON; data addresses and captions need no other escaping.
    held = json.dumps([{"caption": c, "pictures": dict(v)} for c, v in moments], separators=(",", ":")).replace(
        "</", "<\\/"
    )
    times = "".join(f"<option value={k}>{escape(c)}</option>" for k, (c, _) in enumerate(moments))

    def versions(chosen: str, side: str) -> str:
        options = "".join(f"<option{' selected' if name == chosen else ''}>{escape(name)}</option>" for name in first)
        return f'<select class="version" aria-label="{side}" onchange="wipe(this)">{options}</select>'

    shown = "".join(f'<img src="{first[name]}" alt="{escape(name)}, {escape(caption)}">' for name in (left, right))
    moment = f'<select class="moment" aria-label="camera and frame" onchange="wipe(this)">{times}</select>'
    return (
        f"<script>{_SCRIPT}</script>"
        f'<figure class="comparison"><div class="wipe">{shown}<i></i></div>'
        f'<div class="controls">{versions(left, "left of the line")}'
        '<input type="range" min="0" max="100" value="50" aria-label="position of the line" oninput="wipe(this)">'
        f"{versions(right, 'right of the line')}{moment}</div>"
        f'<script type="application/json">{held}</script></figure>'
    )
