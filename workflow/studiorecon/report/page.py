# SPDX-License-Identifier: Apache-2.0
"""``report.page``: everything worth seeing on one page that needs no network, and what the run cost: ``index.html``,
``cost.json``."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from studiorecon.arrays import evenly_spread
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.exr import read_depth
from studiorecon.footage.video import read_frame
from studiorecon.machine.kernel_cache import compiled_since
from studiorecon.pages import html
from studiorecon.pages.ending import read_warnings
from studiorecon.progress import say, warn
from studiorecon.report.sections import appendix, comparison_slider, timeline, verdicts
from studiorecon.report.sections import licences as terms
from studiorecon.report.sections import tables as sections
from studiorecon.report.sections.cost import cost
from studiorecon.report.sections.pictures import depth_picture, difference, mask_picture, truth_picture
from studiorecon.report.sections.solvers import section as solvers_section
from studiorecon.scene.capture import Manifest, read_manifest
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.files import read_json, write_json, write_text
from studiorecon.scene.path import read_path
from studiorecon.scene.people import read_detections, read_identities
from studiorecon.signature import Place, Written


@dataclass(frozen=True)
class Settings:
    strip_frames: int = 2
    picture_width: int = 480
    # Films are warned about where less than this share of a picture is measured, and where the camera stands further
    # than this from every training camera.
    min_measured: float = 0.5
    max_angle_deg: float = 60.0


def strips(
    capture: Manifest, videos: Sequence[Path], render: Path, enhanced: Path, path: Path, settings: Settings
) -> tuple[str, list[str]]:
    """A slider, and rows of photo, raw render, enhanced picture and difference, of a few frames of every held-out
    camera."""
    steps, _ = read_path(path)
    rows, moments = [], []
    for video in videos:
        camera = video.stem
        first = next(i for i, step in enumerate(steps) if step.segment == camera)
        for frame in spread(capture.frames, settings.strip_frames):
            photo, raw = read_frame(video, frame), read_frame(render, first + frame)
            final = read_frame(enhanced, first + frame)
            raw, final = (picture[: photo.shape[0], : photo.shape[1]] for picture in (raw, final))
            about = f"{camera}, frame {frame}"
            made = {"photo": photo, "enhanced": final, "render": raw}
            shown = {name: html.jpeg(picture, settings.picture_width) for name, picture in made.items()}
            moments.append((about, shown))
            captions = {"photo": f"{about}: photo", "render": "render", "enhanced": "enhanced"}
            figures = [html.figure(shown[name], caption) for name, caption in captions.items()]
            missed = html.jpeg(difference(final, photo), settings.picture_width)
            rows.append(html.row([*figures, html.figure(missed, "difference × 3")]))
    return comparison_slider.slider(moments, "photo", "enhanced"), rows


def player(poster: Path, page: Path) -> str:
    """The player's picture, which opens the player: ``player.html`` beside it, by an address relative to the page."""
    address = html.text(Path(os.path.relpath(poster.with_suffix(".html"), page.parent)).as_posix())
    picture_bgr = cv2.imread(str(poster))
    assert picture_bgr is not None
    picture = html.jpeg(picture_bgr[..., ::-1], 1600)
    told = "The scene to move through: orbit, stand at a camera, stop time, see what is measured and what is invented."
    return f'<a href="{address}">{html.figure(picture, f"▶ {told}")}</a>'


def spread(frames: int, wanted: int) -> list[int]:
    """``wanted`` frames spread over a clip, its ends left out; fewer when the clip is shorter."""
    return [int(frame) for frame in evenly_spread(frames, wanted + 2)[1:-1]] if wanted else []


def room_pictures(plates: Sequence[Path], depths: Sequence[Path], width: int) -> list[str]:
    """Clean plate and depth of each training camera."""
    figures = []
    for plate, depth in zip(plates, depths, strict=True):
        camera = depth.stem
        picture, (near, far) = depth_picture(*read_depth(depth))
        image = cv2.imread(str(plate), cv2.IMREAD_UNCHANGED)
        assert image is not None
        figures.append(
            "<div>"
            + html.figure(html.jpeg(image[..., 2::-1], width), f"{camera}: clean plate, black where never seen empty")
            + html.figure(html.jpeg(picture, width), f"depth {near:.1f} m (bright) … {far:.1f} m (dark)")
            + "</div>"
        )
    return figures


def mask_pictures(videos: Sequence[Path], masks: Sequence[Path], frame: int, width: int) -> list[str]:
    """A photo of each training camera with its people tinted."""
    return [
        html.figure(
            html.jpeg(mask_picture(read_frame(video, frame), read_frame(mask, frame)), width),
            f"{mask.stem}, frame {frame}",
        )
        for video, mask in zip(videos, masks, strict=True)
    ]


def truth_pictures(
    renders: Sequence[Path], paths: Sequence[Path], maps: Sequence[Path], metrics: dict, width: int
) -> list[str]:
    """Three pictures of every film, tinted by what they are based on."""
    rows = []
    for render, path, truth in zip(renders, paths, maps, strict=True):
        shares = metrics["coverage"].get(render.stem, {})
        caption = ", ".join(
            f"{100 * shares[name]:.0f} % {name}" for name in ("measured", "inferred", "invented") if name in shares
        )
        steps = len(read_path(path)[0])
        figures = [
            html.figure(html.jpeg(truth_picture(read_frame(truth, i), read_frame(render, i)), width), f"picture {i}")
            for i in spread(steps, 3)
        ]
        rows.append(f"<p>Shot <b>{html.text(render.stem)}</b>: {html.text(caption)}</p>" + html.row(figures))
    return rows


def learned(listed_s: Mapping[str, float], spent: Mapping[str, Any]) -> dict[str, float]:
    """Processor seconds of this run in the stages that a budget's prediction knows, as predicted for the machine of the
    price list and as ``spent`` (``cost``) has them: what the next prediction's pace is told by."""
    taken_s = {stage: entry["cpu_seconds"] for stage, entry in spent["stages"].items() if entry["cpu_seconds"]}
    both = sorted(set(listed_s) & set(taken_s))
    return {"listed_s": sum(listed_s[stage] for stage in both), "spent_s": sum(taken_s[stage] for stage in both)}


def run(
    settings: Settings,
    scene: str,
    manifest: Path,
    model: Path,
    metrics: Path,
    recognition: list[Path],
    decisions: list[Path],
    refinement: Path,
    sheet: Path,
    plates: list[Path],
    depths: list[Path],
    training_videos: list[Path],
    masks: list[Path],
    films: list[Path],
    renders: list[Path],
    paths: list[Path],
    ledgers: list[Path],
    truth_maps: list[Path],
    heldout_videos: list[Path],
    heldout_render: list[Path],
    heldout_enhanced: list[Path],
    heldout_path: list[Path],
    fits: list[Path],
    detections: list[Path],
    identities: list[Path],
    association: list[Path],
    linked: list[Path],
    benchmarks: Place,
    logs: Place,
    configuration: str,
    budget: str,
    licences: Place,
    paper: Path,
    solvers: Path,
    poster: Path | None,
    costs: Written,
    page: Written,
) -> None:
    """Write the page; lists of optional files may be empty, and the page then says what is missing."""
    capture, measured, spent = read_manifest(manifest), read_json(metrics), cost(benchmarks)
    spent["machine"] = {
        "system": platform.system(),
        "processor": platform.machine(),
        "python": platform.python_version(),
    }
    chosen = json.loads(budget)
    if chosen:
        # Kernels are compiled once: a run that had to is no guide to the next one.
        began_s = min((path.stat().st_mtime for path in benchmarks.rglob("*.tsv")), default=0.0)
        if not compiled_since(began_s):
            spent["budget"] = learned(chosen["listed_s"], spent)
    write_json(costs, spent)
    width, decided = settings.picture_width, [read_decisions(path) for path in decisions]
    body = [sections.head(scene, capture, len(read_model(model.parent)), measured, spent)]
    shown = [html.film(film.read_bytes(), f"Shot {film.stem}, enhanced") for film in films]
    rows: list[str] = []
    if heldout_render and heldout_enhanced:
        slider, rows = strips(
            capture, heldout_videos, heldout_render[0], heldout_enhanced[0], heldout_path[0], settings
        )
        shown.insert(1, slider)
    body += [player(poster, page) if poster else "", *shown[:2], html.row(shown[2:], 2) if shown[2:] else ""]
    body.append(
        html.heading(
            "Against the held-out cameras",
            "Cameras that no stage but this report has looked at. Differences are amplified.",
        )
    )
    body += rows
    body.append(sections.measures(measured))
    body.append(sections.paper(measured, read_json(recognition[0]) if recognition else {}, paper))
    body.append(sections.people(measured))
    bodies = [read_person(path) for path in fits]
    body.append(timeline.surety(bodies, measured["jitter"]))
    if identities:
        names = [person.name for person in bodies]
        whose, found = read_identities(identities[0]), [read_detections(path) for path in detections]
        body.append(timeline.strip(timeline.frames_seen(found, whose, names, capture.frames), names))
    body += [sections.left_out(read_json(path)["left_out"]) for path in association]
    if masks:
        body.append(html.row(mask_pictures(training_videos, masks, capture.frames // 2, width), min(len(masks), 4)))
    body.append(
        html.heading(
            "What is measured",
            "Blue: seen by a camera. Yellow: inferred from its surroundings. Red: invented, nobody saw it.",
        )
    )
    body += truth_pictures(renders, paths, truth_maps, measured, width)
    body.append(html.heading("The room", "What the cameras see without people, and how far away it is."))
    body.append(html.row(room_pictures(plates, depths, width), min(len(plates), 4)))
    sheet_bgr = cv2.imread(str(sheet))
    assert sheet_bgr is not None
    body.append(sections.cameras(read_json(refinement), html.jpeg(sheet_bgr[..., ::-1], 1600)))
    body.append(sections.overlap(measured["rig"]))
    body.append(sections.coverage(decided))
    body.append(verdicts.decisions(decided, spent))
    body.append(sections.reached(measured, spent, chosen))
    body.append(sections.costs(spent))
    body.append(solvers_section(solvers))
    body.append(sections.settings(configuration))
    body.append(terms.licences(json.loads(configuration), licences))
    of_films = appendix.film_warnings(ledgers, settings.min_measured, settings.max_angle_deg)
    before = read_warnings(logs)
    body.append(appendix.warnings([*before, *of_films]))
    body.append(appendix.versions(measured["provenance"], spent["machine"]))
    body.append(
        appendix.links(page.parents[1], page, [metrics, costs, *decisions, refinement, *identities, *linked], ledgers)
    )
    write_text(page, html.page(f"{scene}: 4D scene", body, comparison_slider.STYLE))
    say(f"the page is {page.stat().st_size / 1e6:.1f} MB and needs no network: {page}")
    for _, sentence in of_films:
        warn(sentence)
