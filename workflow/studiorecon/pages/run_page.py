# SPDX-License-Identifier: Apache-2.0
"""The page of a live run: finished, running and remaining jobs, and results that can be opened already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from studiorecon.pages import html, skeleton

RELOAD_S = 4
# Results worth opening before the report is finished, in the order of their appearance: pattern and description.
_EARLY = (
    ("calibration/doctor.html", "the cameras"),
    ("plates/*.png", "the room without people"),
    ("depth/preview.mp4", "preview of the room, without people and before training"),
    ("cameras/refinement.png", "joints projected back into the cameras"),
    ("people/review.html", "identities"),
    ("depth/primitives.png", "detected furniture"),
    ("people/overlay/*.mp4", "skeletons over the footage"),
    ("render/*.mkv", "films, raw"),
    ("enhance/*.mp4", "films"),
)
_BODY = """
<h1>{{ scene }}</h1>
<p>{{ words }}</p>
{{ bar }}
<p class="soft">{{ note }}</p>
{% if failed %}
<p class="undetermined">Failed: {{ failed | join(", ") }}. See the terminal and the logs.</p>
{% endif %}
{% if running %}
<h2>Running</h2><ul>{% for job in running %}<li>{{ job }}</li>{% endfor %}</ul>
{% endif %}
<h2>Stages</h2>{{ stages }}
{% if pictures or links %}<h2>Results so far</h2>{{ pictures }}
<ul>{% for address, about in links %}<li><a href="{{ address }}">{{ address }}</a>: {{ about }}</li>{% endfor %}</ul>
{% endif %}
"""


@dataclass(frozen=True)
class Stage:
    """A stage's jobs."""

    name: str
    done: int
    total: int


def write_page(
    folder: Path,
    scene: str,
    words: str,
    note: str,
    stages: Sequence[Stage],
    running: Sequence[str],
    failed: Sequence[str],
    on: bool,
) -> str:
    """The page for ``folder`` (``results/<scene>``), in which it searches for pictures.

    It reloads itself while the run is ``on``, and forwards to the report once that exists.
    """
    done, total = sum(s.done for s in stages), sum(s.total for s in stages)
    rows = [[s.name, f"{s.done} of {s.total}", html.bar(s.done / s.total if s.total else 1.0)] for s in stages]
    found = early_results(folder)
    pictures = [html.figure(name, f"{name}: {about}") for name, about in found.items() if name.endswith(".png")]
    report = folder / "report/index.html"
    over = not on and report.is_file() and not failed
    body = skeleton.fill_template(
        _BODY,
        scene=scene,
        words=words,
        note=note,
        bar=skeleton.Markup(html.bar(done / total if total else 0.0)),
        failed=failed,
        running=running,
        stages=skeleton.Markup(html.table(["stage", "jobs", ""], rows, raw=(2,))),
        pictures=skeleton.Markup(html.row(pictures, 4)) if pictures else "",
        links=[(name, about) for name, about in found.items() if not name.endswith(".png")],
    )
    reload_s = RELOAD_S if on else 0 if over else None
    return skeleton.page(f"{scene}: {words}", [body], reload_s=reload_s, then="report/index.html" if over else "")


def early_results(folder: Path) -> Mapping[str, str]:
    """name → description of the results below ``folder`` that can be opened already."""
    found: dict[str, str] = {}
    for pattern, about in _EARLY:
        for path in sorted(folder.glob(pattern))[:8]:
            found[path.relative_to(folder).as_posix()] = about
    return found
