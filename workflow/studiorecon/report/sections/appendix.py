# SPDX-License-Identifier: Apache-2.0
"""The end of the page: every warning of the run, its libraries, and links to the data files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from studiorecon.pages import html
from studiorecon.scene.files import read_json, read_table

# Files for readers, relative to results/<scene>/, and their contents.
_FILES = {
    "report/metrics.json": "every measure, per camera and frame, with its definition",
    "report/cost.json": "seconds and memory of every rule",
    "survey/decisions.json": "effects decided before training",
    "report/audit.json": "effects decided on the trained scene",
    "cameras/refinement.json": "reprojection before and after refinement",
    "people/identities.tsv": "person of each track of each camera; edit a copy to correct it",
    "people/review.html": "everybody's pictures per camera and time",
    "depth/room.json": "the fitted room",
    "deliver/manifest.json": "everything delivered, with checksums",
    "deliver/player.html": "the scene to move through, in space and time",
    "deliver/scene.glb": "room, people and cameras as one glTF, for three.js, PlayCanvas and Blender",
}


def film_warnings(ledgers: Sequence[Path], min_measured: float, max_angle_deg: float) -> list[tuple[str, str]]:
    """(step, sentence) for films that show unfilmed parts or pass through something, by their ``ledgers``."""
    found = []
    for path in ledgers:
        rows = read_table(path, ("picture", "measured", "angle_deg", "near"))
        stretches = {
            f"shows less than {100 * min_measured:.0f} % measured surfaces": [
                float(r["measured"]) < min_measured for r in rows
            ],
            f"is more than {max_angle_deg:.0f} degrees from every training camera": [
                float(r["angle_deg"]) > max_angle_deg for r in rows
            ],
        }
        for near in sorted({r["near"] for r in rows} - {""}):
            through = "walls or furniture" if near == "background" else near
            stretches[f"passes through {through}"] = [r["near"] == near for r in rows]
        for what, chosen in stretches.items():
            pictures = [int(r["picture"]) for r, there in zip(rows, chosen) if there]
            if pictures:
                where = f"in {len(pictures)} of {len(rows)} pictures ({_ranges(pictures)})"
                found.append((f"render.shot.{path.stem}", f"shot {path.stem} {what} {where}"))
    return found


def _ranges(pictures: Sequence[int]) -> str:
    """``0-3, 7, 9-12``; at most five stretches are named."""
    starts = [i for i, p in enumerate(pictures) if i == 0 or p != pictures[i - 1] + 1]
    ends = [*(s - 1 for s in starts[1:]), len(pictures) - 1]
    parts = [f"{pictures[a]}-{pictures[b]}" if a < b else str(pictures[a]) for a, b in zip(starts, ends)]
    return ", ".join(parts[:5]) + (" …" if len(parts) > 5 else "")


def warnings_section(found: Sequence[tuple[str, str]]) -> str:
    """The section of warnings that a reader needs before trusting the result."""
    title = "Warnings"
    if not found:
        return html.heading(title, "No warnings.")
    return html.heading(title, f"Warnings of this run: {len(found)}.") + html.table(["step", "what"], found)


def versions_section(provenance: Mapping[str, Any], machine: Mapping[str, str]) -> str:
    """The libraries and machine behind the numbers."""
    rows = machine | provenance["libraries"]
    rows |= {
        "commit of the code": provenance["revision"] or "not from a repository",
        "masks of people": provenance["masks"],
    }
    return html.heading("Versions") + html.table(["what", "which"], [[k, str(v)] for k, v in rows.items()])


def delivery_links(folder: Path, page: Path) -> str:
    """Links to the files in ``deliver/``, one line per folder; keypoints and pictures, which are many, as a count."""
    manifest = folder / "manifest.json"
    if not manifest.is_file():
        return ""
    groups: dict[str, list[str]] = {}
    for name in ("scene.glb", "player.html", *read_json(manifest)["files"]):
        if (folder / name).is_file():
            groups.setdefault(name.partition("/")[0] if "/" in name else "", []).append(name)
    items = []
    for group, names in sorted(groups.items()):
        opened = [name for name in names if not name.startswith("keypoints/") and not name.endswith(".png")]
        linked = [
            f'<a href="{html.escape(Path(os.path.relpath(folder / name, page.parent)).as_posix())}">'
            f"{html.escape(name.removeprefix(f'{group}/'))}</a>"
            for name in opened
        ]
        more = [f"{len(names) - len(opened)} more files"] if len(names) > len(opened) else []
        items.append(f"<li>{html.escape(f'{group}/: ' if group else '')}{', '.join([*linked, *more])}</li>")
    lead = "In deliver/; README.txt there explains each file."
    return html.heading("Files for other programs", lead) + f"<ul>{''.join(items)}</ul>"


def data_links(results: Path, page: Path, files: Sequence[Path], ledgers: Sequence[Path]) -> str:
    """Relative links to data of the scene in ``results``; they work while the page stays in its folder."""
    rows = [(path, _FILES[path.relative_to(results).as_posix()]) for path in files]
    rows += [(path, f"provenance of every picture of shot {path.stem}") for path in ledgers]
    items = []
    for path, what in rows:
        address, name = Path(os.path.relpath(path, page.parent)).as_posix(), path.relative_to(results).as_posix()
        items.append(f'<li><a href="{html.escape(address)}">{html.escape(name)}</a>: {html.escape(what)}</li>')
    return html.heading("The numbers as files", "In the results folder.") + f"<ul>{''.join(items)}</ul>"
