# SPDX-License-Identifier: Apache-2.0
"""The page's timeline of people per camera, and of the certainty of every body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.images.palette import NOBODY, person_colour
from studiorecon.pages import html
from studiorecon.scene.people import Detections, Person

if TYPE_CHECKING:
    from jaxtyping import Bool

_WIDTH, _LEFT, _BAR, _GAP = 1000, 120, 9, 12


def frames_with_detections(
    found: Sequence[Detections], whose: Mapping[tuple[str, int], str], people: Sequence[str], frames: int
) -> dict[str, Bool[np.ndarray, "P F"]]:
    """camera → frames with a detection of each person; the last row has detections of rejected tracks."""
    seen = {}
    for detections in found:
        rows = np.zeros((len(people) + 1, frames), bool)
        for frame, track in zip(detections.frame, detections.track):
            person = whose.get((detections.camera, int(track)))
            rows[people.index(person) if person in people else len(people), int(frame)] = True
        seen[detections.camera] = rows
    return seen


def timeline_strip(seen: Mapping[str, Bool[np.ndarray, "P F"]], people: Sequence[str]) -> str:
    """A row of bars per camera, one bar per person, coloured as in the overlay films; rejected tracks are grey."""
    if not seen:
        return ""
    lanes = len(people) + 1
    frames = next(iter(seen.values())).shape[1]
    step = (_WIDTH - _LEFT) / max(frames, 1)
    parts, top = [], 4.0
    for camera, rows in seen.items():
        parts.append(
            f'<text x="0" y="{top + lanes * _BAR / 2 + 4:.1f}" font-size="14" '
            f'fill="currentColor">{html.escape(camera)}</text>'
        )
        for lane, row in enumerate(rows):
            name = people[lane] if lane < len(people) else "no person"
            colour = "rgb({},{},{})".format(*(person_colour(lane) if lane < len(people) else NOBODY))
            for first, last in true_runs(row):
                x, y, width = _LEFT + first * step, top + lane * _BAR, (last - first) * step
                parts.append(
                    f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{_BAR - 2}" fill="{colour}">'
                    f"<title>{html.escape(name)}, frames {first} to {last - 1}</title></rect>"
                )
                if lane < len(people) and width > 40:
                    parts.append(
                        f'<text x="{x + 4:.1f}" y="{y + _BAR - 3:.1f}" font-size="8" '
                        f'fill="#000">{html.escape(name)}</text>'
                    )
        top += lanes * _BAR + _GAP
    words = f"people seen by each camera in {frames} frames"
    return (
        f'<svg viewBox="0 0 {_WIDTH} {top:.0f}" role="img" aria-label="{words}" style="width:100%;height:auto">'
        + "".join(parts)
        + '</svg><p class="soft">Frames from left to right; one bar per person and camera, grey for tracks of no '
        "person.</p>"
    )


def true_runs(row: Bool[np.ndarray, " T"]) -> list[tuple[int, int]]:
    """[first, last) of every stretch of True in (T,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]


def certainty_table(people: Sequence[Person], jitter: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of people: frames measured, frames present, uncertainty of the joints, and jitter."""
    if not people:
        return ""
    rows = []
    for person in people:
        sigma = np.asarray(person.sigma, np.float64)[person.valid]
        sigma = sigma[np.isfinite(sigma)]
        moves = jitter.get(person.name, {})
        middle, most = (1000 * float(np.quantile(sigma, q)) for q in (0.5, 0.95)) if len(sigma) else (None, None)
        rows.append(
            [
                person.name,
                f"{int(person.valid.sum())} of {len(person.valid)}",
                "all" if person.present.all() else f"{int(person.present.sum())}",
                *(("not known" if v is None else f"{v:.1f} mm") for v in (middle, most)),
                *(
                    "not known" if moves.get(key) is None else f"{moves[key]:.2f} {unit}"
                    for key, unit in (("joints_mm_f2", "mm/frame²"), ("pose_deg_f2", "°/frame²"))
                ),
            ]
        )
    header = [
        "person",
        "frames measured",
        "frames present",
        "joint deviation, median",
        "95 %",
        "jitter of joints",
        "of rotations",
    ]
    return html.table(header, rows, numeric=range(1, 7))
