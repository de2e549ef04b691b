# SPDX-License-Identifier: Apache-2.0
"""``people.desk``: one page that shows who is who, doubtful tracks first, so that a person can correct identities.tsv by eye."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from studiorecon.body.layouts import LAYOUTS
from studiorecon.images.video import read_frames
from studiorecon.people.evidence import sampled_frames
from studiorecon.progress import progress
from studiorecon.scene.files import read_json, read_table, write_text
from studiorecon.scene.people import PEOPLE_COLUMNS, Detections, read_detections, read_identities

# Colours that colour-blind readers tell apart; one per person, again from the start after eight.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6bb1", "#4d4d4d")
_NOBODY = "#999999"
_MARGIN_SHARE = 0.18  # how much more than the keypoints' box is shown
_SOURCES = {
    "keypoints": "found by keypoints",
    "corrected": "corrected by hand",
    "hull": "found by its silhouette against the plates: no keypoints, no tracks to correct",
}
_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:76rem;padding:0 1rem;color:#1b1b1b;background:#fff}
h1{font-size:1.5rem;margin-bottom:.2rem}h2{font-size:1.15rem;margin:2rem 0 .4rem;border-top:1px solid #ddd;padding-top:1rem}
table{border-collapse:collapse}th{text-align:left;font-weight:600;padding:.2rem .8rem .2rem 0;vertical-align:top;white-space:nowrap}
td{padding:.2rem 1.2rem .2rem 0;vertical-align:top}.strip{display:flex;flex-wrap:wrap;gap:4px}
figure{margin:0}figcaption{font-size:.75rem;color:#555}img{display:block;border-bottom:4px solid var(--c)}
.who{color:var(--c);font-weight:700}.note{color:#555}.doubt{background:#fff4d6;padding:.5rem .8rem;border-left:4px solid #e69f00}
pre{background:#f5f5f5;padding:.6rem;overflow:auto;max-height:16rem}code{background:#f5f5f5;padding:0 .2rem}
"""


@dataclass(frozen=True)
class Desk:
    """``pictures`` per person and camera, ``height_px`` of each, and at most ``rejected`` tracks of nobody."""

    pictures: int
    height_px: int
    rejected: int


@dataclass(frozen=True)
class Settings:
    """The keys of the section ``people`` that this step uses."""

    desk: Desk


@dataclass(frozen=True)
class Wanted:
    """One picture to cut out: detection number ``index`` of camera number ``view``."""

    view: int
    index: int


def wanted_of(found: Detections, view: int, tracks: Sequence[int], pictures: int) -> list[Wanted]:
    """Evenly spread detections of ``tracks``, one per frame, the surer one where two share a frame."""
    mine = np.flatnonzero(np.isin(found.track, tracks))
    chosen = []
    for t in sampled_frames(found.frame[mine], pictures):
        here = mine[found.frame[mine] == t]
        chosen.append(Wanted(view, int(here[np.argmax(found.keypoints[here, :, 2].sum(1))])))
    return chosen


def cut_out(picture: np.ndarray, keypoints: np.ndarray, edges: Sequence[tuple[int, int]], colour: str, height_px: int) -> np.ndarray:
    """(height_px, w, 3) uint8: the part of ``picture`` (H, W, 3) around the keypoints (K, 3), with limbs drawn in ``colour``."""
    present = (keypoints[:, 2] > 0) & np.isfinite(keypoints[:, :2]).all(1)
    points = keypoints[present, :2]
    # A stray keypoint far away must not shrink the person to nothing: the box holds the middle nine tenths.
    low, high = (np.percentile(points, q, axis=0) for q in (5, 95))
    around = _MARGIN_SHARE * max(high - low) + 4
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
            ends = [tuple(int(v) for v in np.clip(at[k], -999, 9999)) for k in (a, b)]
            cv2.line(shown, *ends, rgb, 1, cv2.LINE_AA)
    return shown


def pictures_of(
    wanted: Sequence[tuple[Wanted, str]], detections: Sequence[Detections], videos: Sequence[Path], height_px: int
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
                jpeg = cv2.imencode(".jpg", cut[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
                out[n] = "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode()
    return out


def colour_of(person: str) -> str:
    return _COLOURS[int(person[1:]) % len(_COLOURS)] if person else _NOBODY


def ordered(tracks: Sequence[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Doubtful tracks, narrowest margin first, and rejected ones, longest first; a rejected one is not doubtful."""
    doubtful = [t for t in tracks if t["person"] and t["reason"]]
    rejected = [t for t in tracks if not t["person"]]
    doubtful.sort(key=lambda t: (t["margin"] if t["margin"] is not None else 1.0, t["camera"], t["track"]))
    return doubtful, sorted(rejected, key=lambda t: (-t["detections"], t["camera"], t["track"]))


def run(
    settings: Settings, association: Path, people: Path, identities: Path, detections: list[Path], videos: list[Path], page: Path
) -> None:
    """Write ``page`` (html that needs no network) from who was found, and why, in ``association``."""
    told, rows = read_json(association), [row for row in read_table(people, PEOPLE_COLUMNS) if row["status"] == "person"]
    found = [read_detections(p) for p in detections]
    view = {d.camera: v for v, d in enumerate(found)}
    doubtful, rejected = ordered(told["tracks"])
    keys = settings.desk
    strips: list[tuple[str, str, list[Wanted]]] = []  # where it belongs, colour, pictures
    for row in rows:
        for v, d in enumerate(found):
            tracks = [t["track"] for t in told["tracks"] if t["camera"] == d.camera and t["person"] == row["person"]]
            strips.append((f"{row['person']} {d.camera}", colour_of(row["person"]), wanted_of(d, v, tracks, keys.pictures)))
    for one in told["left_out"]:
        for v, d in enumerate(found):
            mine = wanted_of(d, v, [t for camera, t in one["tracks"] if camera == d.camera], keys.pictures)
            strips.append((f"{one['name']} {d.camera}", _NOBODY, mine))
    for t in [*doubtful, *rejected[: keys.rejected]]:
        v = view[t["camera"]]
        strips.append((f"{t['camera']}/{t['track']}", colour_of(t["person"]), wanted_of(found[v], v, [t["track"]], min(3, keys.pictures))))
    flat = [(one, colour) for _, colour, some in strips for one in some]
    images = iter(pictures_of(flat, found, videos, keys.height_px))
    shown = {}
    for where, colour, some in strips:
        figures = [
            f'<figure><img src="{next(images)}" style="--c:{colour}" alt="{escape(where)}, frame {found[o.view].frame[o.index]}">'
            f"<figcaption>{found[o.view].frame[o.index]}: track {found[o.view].track[o.index]}</figcaption></figure>"
            for o in some
        ]
        shown[where] = f'<div class="strip">{"".join(figures)}</div>' if figures else '<span class="note">not seen</span>'
    write_text(page, _page(told, rows, doubtful, rejected, [d.camera for d in found], shown, read_identities(identities), keys))


def _page(
    told: dict[str, Any],
    rows: list[dict[str, str]],
    doubtful: list[dict[str, Any]],
    rejected: list[dict[str, Any]],
    cameras: list[str],
    shown: dict[str, str],
    identities: dict[tuple[str, int], str],
    keys: Desk,
) -> str:
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Identity desk</title>',
        f"<style>{_STYLE}</style><h1>Who is who</h1>",
        f"<p>{len(rows)} people; {len(doubtful)} doubtful and {len(rejected)} rejected of {len(told['tracks'])} tracks. "
        + ("These identities were corrected by hand and are taken as they stand. " if told["corrected"] else "")
        + "Numbers below the pictures are frames and track ids.</p>",
        "<p>To correct: copy <code>people/identities.tsv</code> (below) into the dataset folder as <code>identities.tsv</code>, or name "
        "the copy in <code>people.identities</code>; change the person of a line (empty = nobody) and run again. Only people whose lines "
        "changed are fitted again.</p><h2>Doubtful tracks first</h2>",
    ]
    if not doubtful:
        parts.append('<p class="note">None: every track clearly prefers its person.</p>')
    parts += [_track(t, shown) for t in doubtful]
    for row in rows:
        colour = colour_of(row["person"])
        by_hull = row["source"] == "hull"
        words = _SOURCES[row["source"]]
        parts.append(
            f'<h2 style="--c:{colour}"><span class="who">{row["person"]}</span> <span class="note">{row["frames"]} frames, '
            f"confidence {row['confidence']}, {words}; seen by {escape(row['cameras'])}</span></h2>"
        )
        if not by_hull:
            name = row["person"]
            lines = [f"<tr><th>{escape(c)}</th><td>{shown[f'{name} {c}']}</td></tr>" for c in cameras]
            parts.append(f"<table>{''.join(lines)}</table>")
    parts += _left_out(told["left_out"], cameras, shown)
    parts.append("<h2>Rejected tracks</h2>")
    parts += [_track(t, shown) for t in rejected[: keys.rejected]]
    if len(rejected) > keys.rejected:
        parts.append(f'<p class="note">and {len(rejected) - keys.rejected} shorter ones (people.desk.rejected shows more)</p>')
    listing = "\n".join(["camera\ttrack\tperson", *(f"{c}\t{t}\t{p}" for (c, t), p in sorted(identities.items()))])
    parts.append(f"<h2>identities.tsv</h2><pre>{escape(listing)}</pre></html>\n")
    return "\n".join(parts)


def _left_out(those: Sequence[dict[str, Any]], cameras: Sequence[str], shown: dict[str, str]) -> list[str]:
    """Whom two cameras agree on and who is no person of this scene all the same: who that is, why, and what takes them in."""
    parts = []
    for one in those:
        name = one["name"]
        lines = [f"<tr><th>{escape(c)}</th><td>{shown[f'{name} {c}']}</td></tr>" for c in cameras]
        parts.append(
            f'<h2 style="--c:{_NOBODY}"><span class="who">{name}</span> <span class="note">left out: {escape(one["reason"])}</span></h2>'
            f"<table>{''.join(lines)}</table><p>If this is somebody, these lines of <code>identities.tsv</code> take them in, in place of "
            f"those of the same tracks (with the next free number where you take in several):</p>"
            f"<pre>{escape(chr(10).join(one['lines']))}</pre>"
        )
    return parts


def _track(t: dict[str, Any], shown: dict[str, str]) -> str:
    where = f"{t['camera']}/{t['track']}"
    person = f'<span class="who">{t["person"]}</span>, ' if t["person"] else ""
    return (
        f'<div{" class=doubt" if t["person"] else ""} style="--c:{colour_of(t["person"])}"><p>{person}<b>{escape(where)}</b>, frames '
        f'{t["first"]}–{t["last"]} ({t["detections"]} detections): <span class="note">{escape(t["reason"])}</span></p>{shown[where]}</div>'
    )
