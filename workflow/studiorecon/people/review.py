# SPDX-License-Identifier: Apache-2.0
"""``people.review``: one page of all identities, doubtful tracks first, so that a user can correct identities.tsv by
eye."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.footage.video import read_frames
from studiorecon.images.encoded import jpeg
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.pages import skeleton
from studiorecon.people.pictures.change import sample_frames
from studiorecon.progress import progress
from studiorecon.scene.files import write_text
from studiorecon.scene.people import Detections, people_rows, read_detections, read_identities, split_tracks, track_text
from studiorecon.scene.reports import read_association
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Distinguishable for colour-blind readers; one per person, repeated after eight.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6bb1", "#4d4d4d")
_NOBODY = "#999999"
# Per person and camera, large enough to recognise a person: a picture takes about 5 kB.
_PICTURES = 6
# Rejected tracks that are shown, the longest first.
_MAX_REJECTED = 40
_SOURCES = {
    "keypoints": "associated by keypoints",
    "corrected": "corrected by hand",
}
_STYLE = """
main { max-width: 76rem; }
.strip { display: flex; flex-wrap: wrap; gap: 4px; } .strip figure { margin: 0; }
.strip img { width: auto; border-bottom: 4px solid var(--c); border-radius: 0; }
table { width: auto; } th, td { border: 0; } th { white-space: nowrap; }
.who { color: var(--c); font-weight: 700; } pre { max-height: 16rem; }
.doubt { border-left: 4px solid var(--warn); padding: .5rem .8rem; background: var(--wash); }
"""
_STRIP = """{% if figures %}<div class="strip">{% for figure in figures -%}
<figure><img src="{{ figure.address }}" style="--c:{{ colour }}" alt="{{ where }}, frame {{ figure.frame }}">
<figcaption>{{ figure.frame }}: track {{ figure.track }}</figcaption></figure>
{%- endfor %}</div>{% else %}<span class="soft">not seen</span>{% endif %}"""
_BODY = """
{% macro cameras_of(name) %}
<table>
{% for camera in cameras %}
<tr><th>{{ camera }}</th><td>{{ shown[name ~ " " ~ camera] }}</td></tr>
{% endfor %}
</table>
{% endmacro %}
{% macro track(t) %}
{% set where = t.camera ~ "/" ~ track_text(t.track) %}
<div{% if t.person %} class="doubt"{% endif %} style="--c:{{ colour_of(t.person) }}">
<p>{% if t.person %}<span class="who">{{ t.person }}</span>, {% endif %}<b>{{ where }}</b>,
frames {{ t.first }}–{{ t.last }}
({{ t.detections }} detections): <span class="soft">{{ t.reason }}</span></p>{{ shown[where] }}</div>
{% endmacro %}
<h1>Identities</h1>
<p>{{ rows | length }} people; {{ doubtful | length }} doubtful and {{ rejected | length }} rejected of
{{ info.tracks | length }} tracks.
{% if info.corrected %}These identities were corrected by hand and are used unchanged. {% endif %}
Numbers below the pictures are frames and track ids.</p>
<p>To correct: copy <code>people/identities.tsv</code> (below) into the dataset folder as <code>identities.tsv</code>,
or name the copy in <code>people.identities</code>; change the person of a line (empty = no person) and run again. Only
people whose lines changed are fitted again.</p>
<h2>Doubtful tracks first</h2>
{% for t in doubtful %}{{ track(t) }}{% else %}
<p class="soft">None: every track clearly prefers its person.</p>
{% endfor %}
{% for row in rows %}
<h2 style="--c:{{ colour_of(row.person) }}"><span class="who">{{ row.person }}</span>
<span class="soft">{{ row.frames }} frames,
confidence {{ row.confidence }}, {{ sources[row.source] }}; seen by {{ row.cameras }}</span></h2>
{{ cameras_of(row.person) }}
{% endfor %}
{% for one in info.left_out %}
<h2 style="--c:{{ nobody }}"><span class="who">{{ one.name }}</span>
<span class="soft">left out: {{ one.reason }}</span></h2>
{{ cameras_of(one.name) }}
<p>To accept this person, replace the lines of the same tracks in <code>identities.tsv</code> by these
(with the next free number if you accept several):</p><pre>{{ one.lines | join("\n") }}</pre>
{% endfor %}
<h2>Rejected tracks</h2>
{% for t in rejected[:most] %}{{ track(t) }}{% endfor %}
{% if rejected | length > most %}
<p class="soft">and {{ rejected | length - most }} shorter ones</p>
{% endif %}
<h2>identities.tsv</h2><pre>{{ listing }}</pre>
"""


@dataclass(frozen=True)
class PictureRequest:
    """One picture to cut out: detection number ``index`` of camera number ``view``."""

    view: int
    index: int


def choose_pictures(found: Detections, view: int, tracks: Sequence[int], pictures: int) -> list[PictureRequest]:
    """Evenly spread detections of ``tracks``, one per frame, the more confident one where two share a frame."""
    mine = np.flatnonzero(np.isin(found.track, tracks))
    chosen = []
    for t in sample_frames(found.frame[mine], pictures):
        here = mine[found.frame[mine] == t]
        chosen.append(PictureRequest(view, int(here[np.argmax(found.keypoints[here, :, 2].sum(1))])))
    return chosen


def cut_out(
    picture: Integer[np.ndarray, "H W 3"],
    keypoints: Num[np.ndarray, "K 3"],
    edges: Sequence[tuple[int, int]],
    colour: str,
    height_px: int,
) -> Integer[np.ndarray, "height_px w 3"]:
    """The part of ``picture`` around the keypoints, with limbs drawn in ``colour``."""
    present = (keypoints[:, 2] > 0) & np.isfinite(keypoints[:, :2]).all(1)
    points = keypoints[present, :2]
    # A stray keypoint far away must not shrink the person to nothing: the box holds the middle nine tenths.
    low, high = (np.percentile(points, q, axis=0) for q in (5, 95))
    # Margin around the keypoints' box.
    around = 0.18 * max(high - low) + 4
    x0, y0 = np.maximum(np.floor(low - around), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(high + around), picture.shape[1::-1]).astype(int)
    x1, y1 = max(x1, x0 + 2), max(y1, y0 + 2)
    part = picture[y0:y1, x0:x1]
    if part.size == 0:
        part, x0, y0 = picture, 0, 0
    scale = height_px / part.shape[0]
    width = int(np.clip(round(part.shape[1] * scale), 24, 2 * height_px))
    shown = cv2.resize(part, (width, height_px), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    at = (np.where(present[:, None], keypoints[:, :2], 0) - [x0, y0]) * [width / part.shape[1], scale]
    rgb = tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))
    for a, b in edges:
        if present[a] and present[b]:
            start, end = (tuple(int(v) for v in np.clip(at[k], -999, 9999)) for k in (a, b))
            cv2.line(shown, start, end, rgb, 1, cv2.LINE_AA)
    return shown


def cut_out_pictures(
    wanted: Sequence[tuple[PictureRequest, str]],
    detections: Sequence[Detections],
    videos: Sequence[Path],
    height_px: int,
) -> list[str]:
    """Data addresses (JPEG) of all wanted pictures, each video decoded once."""
    out = [""] * len(wanted)
    for v, found in enumerate(progress(detections, "cameras")):
        by_frame: dict[int, list[int]] = {}
        for n, (one, _) in enumerate(wanted):
            if one.view == v:
                by_frame.setdefault(int(found.frame[one.index]), []).append(n)
        if not by_frame:
            continue
        for t, picture in enumerate(read_frames(videos[v], 0, max(by_frame) + 1)):
            for n in by_frame.get(t, []):
                one, colour = wanted[n]
                cut = cut_out(picture, found.keypoints[one.index], LAYOUTS[found.layout].edges, colour, height_px)
                out[n] = "data:image/jpeg;base64," + base64.b64encode(jpeg(cut, 80)).decode()
    return out


def person_css_colour(person: str) -> str:
    return _COLOURS[int(person[1:]) % len(_COLOURS)] if person else _NOBODY


def order_by_doubt(tracks: Sequence[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Doubtful tracks, narrowest margin first, and rejected ones, longest first; a rejected one is not doubtful."""
    doubtful = [t for t in tracks if t["person"] and t["reason"]]
    rejected = [t for t in tracks if not t["person"]]
    doubtful.sort(key=lambda t: (t["margin"] if t["margin"] is not None else 1.0, t["camera"], t["track"]))
    return doubtful, sorted(rejected, key=lambda t: (-t["detections"], t["camera"], t["track"]))


def run(
    association: Path,
    people: Path,
    identities: Path,
    detections: list[Path],
    videos: list[Path],
    page: Written,
) -> None:
    """Write ``page`` (html that needs no network) from the identities and reasons in ``association``."""
    info, rows = read_association(association), people_rows(people)
    whose = read_identities(identities)
    found = [split_tracks(read_detections(p), whose) for p in detections]
    view = {d.camera: v for v, d in enumerate(found)}
    doubtful, rejected = order_by_doubt(info["tracks"])
    strips: list[tuple[str, str, list[PictureRequest]]] = []  # where it belongs, colour, pictures
    for row in rows:
        for v, d in enumerate(found):
            tracks = [t["track"] for t in info["tracks"] if t["camera"] == d.camera and t["person"] == row["person"]]
            strips.append(
                (
                    f"{row['person']} {d.camera}",
                    person_css_colour(row["person"]),
                    choose_pictures(d, v, tracks, _PICTURES),
                )
            )
    for one in info["left_out"]:
        for v, d in enumerate(found):
            mine = choose_pictures(d, v, [t for camera, t in one["tracks"] if camera == d.camera], _PICTURES)
            strips.append((f"{one['name']} {d.camera}", _NOBODY, mine))
    for t in [*doubtful, *rejected[:_MAX_REJECTED]]:
        v = view[t["camera"]]
        strips.append(
            (
                f"{t['camera']}/{track_text(t['track'])}",
                person_css_colour(t["person"]),
                choose_pictures(found[v], v, [t["track"]], min(3, _PICTURES)),
            )
        )
    flat = [(one, colour) for _, colour, some in strips for one in some]
    images = iter(cut_out_pictures(flat, found, videos, 150))
    shown = {}
    for where, colour, some in strips:
        figures = [
            {
                "address": next(images),
                "frame": found[o.view].frame[o.index],
                "track": track_text(int(found[o.view].track[o.index])),
            }
            for o in some
        ]
        shown[where] = skeleton.fill_template(_STRIP, where=where, colour=colour, figures=figures)
    write_text(page, _page(info, rows, doubtful, rejected, [d.camera for d in found], shown, whose))


def _page(
    info: dict[str, Any],
    rows: list[dict[str, str]],
    doubtful: list[dict[str, Any]],
    rejected: list[dict[str, Any]],
    cameras: list[str],
    shown: Mapping[str, str],
    identities: dict[tuple[str, int], str],
) -> str:
    body = skeleton.fill_template(
        _BODY,
        info=info,
        rows=rows,
        doubtful=doubtful,
        rejected=rejected,
        most=_MAX_REJECTED,
        cameras=cameras,
        shown=shown,
        sources=_SOURCES,
        colour_of=person_css_colour,
        track_text=track_text,
        nobody=_NOBODY,
        listing="\n".join(
            ["camera\ttrack\tperson", *(f"{c}\t{track_text(t)}\t{p}" for (c, t), p in sorted(identities.items()))]
        ),
    )
    return skeleton.page("Identity page", [body], _STYLE)
