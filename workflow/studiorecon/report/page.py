# SPDX-License-Identifier: Apache-2.0
"""``report.page``: writes the report on one page that needs no network, and the run's cost (``cost.json``)."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from studiorecon.arrays import spread_indices
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_image
from studiorecon.footage.video import encoded_film, read_frame
from studiorecon.pages import html
from studiorecon.pages.run_summary import read_warnings
from studiorecon.progress import say, warn
from studiorecon.report.sections import appendix, comparison_slider, timeline, verdicts
from studiorecon.report.sections import licences as terms
from studiorecon.report.sections import tables as sections
from studiorecon.report.sections.cost import cost
from studiorecon.report.sections.pictures import depth_picture, difference, mask_picture, truth_picture
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.decisions import Decision, read_decisions
from studiorecon.scene.files import write_json, write_text
from studiorecon.scene.path import read_path
from studiorecon.scene.people import read_detections, read_identities, split_tracks
from studiorecon.scene.reports import read_association, read_metrics, read_recognition, read_refinement
from studiorecon.scene.step_files import CURE
from studiorecon.signature import Place, Written


@dataclass(frozen=True)
class Settings:
    strip_frames: int = 2
    picture_width: int = 480
    # The report warns about a film where less than this share of a picture is measured, and where its camera is further
    # than this angle from every training camera.
    min_measured: float = 0.5
    max_angle_deg: float = 60.0


@dataclass(frozen=True)
class ResultFiles:
    """Files of ``results/<scene>``, by the names that its rules give those of cameras and films (``shots``)."""

    folder: Path
    cameras: tuple[str, ...]
    held_out: tuple[str, ...]
    shots: tuple[str, ...]

    def each(self, pattern: str, names: Sequence[str]) -> list[Path]:
        """The file of every camera or film; ``{}`` in ``pattern`` is its name."""
        return [self.folder / pattern.format(name) for name in names]


@dataclass(frozen=True)
class PeopleFiles:
    """Everybody's body, detections, identities and masks, and people left out by association."""

    fits: list[Path] = field(default_factory=list)
    detections: list[Path] = field(default_factory=list)
    identities: list[Path] = field(default_factory=list)
    association: list[Path] = field(default_factory=list)
    masks: list[Path] = field(default_factory=list)


@dataclass(frozen=True)
class MeasuredFiles:
    """Measures and decisions of the run, and the paper's measures."""

    metrics: Path
    recognition: list[Path]
    decisions: list[Path]
    paper: Path


@dataclass(frozen=True)
class RunFiles:
    """The run's times, logs, settings and budget (both JSON), and the licences of its networks."""

    benchmarks: Place
    logs: Place
    configuration: str
    budget: str
    licences: Place


def comparison_strips(made: ResultFiles, frames: int, enhanced: bool, settings: Settings) -> tuple[str, list[str]]:
    """A slider, and rows for a few frames of every held-out camera: photo, render, enhanced picture, difference."""
    render, final_film = made.folder / "render/heldout.mkv", made.folder / "enhance/heldout.mkv"
    steps, _ = read_path(made.folder / "render/heldout.json")
    rows, moments = [], []
    for video in made.each("capture/{}.mkv", made.held_out):
        camera = video.stem
        first = next(i for i, step in enumerate(steps) if step.segment == camera)
        for frame in spread_frames(frames, settings.strip_frames):
            photo, raw = read_frame(video, frame), read_frame(render, first + frame)
            final = read_frame(final_film, first + frame)
            raw, final = (picture[: photo.shape[0], : photo.shape[1]] for picture in (raw, final))
            about = f"{camera}, frame {frame}"
            versions = {"photo": photo, **({"enhanced": final} if enhanced else {}), "render": raw}
            shown = {name: html.jpeg(picture, settings.picture_width) for name, picture in versions.items()}
            moments.append((about, shown))
            captions = {"photo": f"{about}: photo", "render": "render"} | ({"enhanced": "enhanced"} if enhanced else {})
            figures = [html.figure(shown[name], caption) for name, caption in captions.items()]
            missed = html.jpeg(difference(final, photo), settings.picture_width)
            rows.append(html.row([*figures, html.figure(missed, "difference × 3")]))
    return comparison_slider.slider(moments, "photo", "enhanced" if enhanced else "render"), rows


def player(poster: Path, page: Path) -> str:
    """A link with the player's picture; it opens ``player.html`` in the page's folder by a relative address."""
    address = html.escape(Path(os.path.relpath(poster.with_suffix(".html"), page.parent)).as_posix())
    picture_bgr = read_image(poster, cv2.IMREAD_COLOR, CURE)
    caption = "The scene in 3D: orbit, jump to a camera, stop time, show which pixels are measured or invented."
    figure = html.figure(html.jpeg(picture_bgr[..., ::-1], 1600), caption)
    return f'<a class="open" href="{address}"><b>▶ Open the scene</b>{figure}</a>'


def spread_frames(frames: int, wanted: int) -> list[int]:
    """``wanted`` frames spread over a clip without its ends; fewer when the clip is shorter."""
    return [int(frame) for frame in spread_indices(frames, wanted + 2)[1:-1]] if wanted else []


def room_pictures(plates: Sequence[Path], depths: Sequence[Path], width: int) -> list[str]:
    """Clean plate and depth of each training camera."""
    figures = []
    for plate, depth in zip(plates, depths, strict=True):
        camera = depth.stem
        picture, (near, far) = depth_picture(*read_depth(depth))
        image = read_image(plate, cv2.IMREAD_UNCHANGED, CURE)
        figures.append(
            "<div>"
            + html.figure(html.jpeg(image[..., 2::-1], width), f"{camera}: clean plate, black = always hidden")
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


def truth_section(made: ResultFiles, metrics: Mapping[str, Any], width: int) -> list[str]:
    """Three pictures of every film, tinted by provenance."""
    rows = []
    for shot in made.shots:
        render, path, truth = (made.folder / f"render/{shot}.{kind}" for kind in ("mkv", "json", "truth.mkv"))
        shares = metrics["coverage"].get(render.stem, {})
        caption = ", ".join(
            f"{100 * shares[name]:.0f} % {name}" for name in ("measured", "inferred", "invented") if name in shares
        )
        steps = len(read_path(path)[0])
        figures = [
            html.figure(html.jpeg(truth_picture(read_frame(truth, i), read_frame(render, i)), width), f"picture {i}")
            for i in spread_frames(steps, 3)
        ]
        rows.append(f"<p>Shot <b>{html.escape(render.stem)}</b>: {html.escape(caption)}</p>" + html.row(figures))
    lead = "Blue: seen by a camera. Yellow: inferred from its surroundings. Red: invented, seen by no camera."
    return [html.heading("Measured, inferred, invented", lead), *rows]


def run_cost(benchmarks: Path) -> dict[str, Any]:
    """The cost of the run, and its machine."""
    spent = cost(benchmarks)
    spent["machine"] = {
        "system": platform.system(),
        "processor": platform.machine(),
        "python": platform.python_version(),
    }
    return spent


def films_section(made: ResultFiles, frames: int, enhanced: bool, settings: Settings) -> tuple[list[str], list[str]]:
    """The films with the slider between photo and picture, and the strips of the held-out cameras."""
    after = ", enhanced" if enhanced else ""
    films = [
        html.film(encoded_film(film), f"Shot {film.stem}{after}") for film in made.each("enhance/{}.mp4", made.shots)
    ]
    slider, rows = "", list[str]()
    if "heldout" in made.shots and made.held_out:
        slider, rows = comparison_strips(made, frames, enhanced, settings)
    shown = [*films[:1], slider, *([html.row(films[1:], 2)] if films[1:] else [])]
    return [html.heading("Films"), *shown] if films else [], rows


def people_section(
    made: ResultFiles,
    frames: int,
    measured: Mapping[str, Any],
    people: PeopleFiles,
    width: int,
) -> list[str]:
    """The section on people: joint errors, presence over time, people left out by association, and masks."""
    bodies = [read_person(path) for path in people.fits]
    parts = [sections.joint_errors_table(measured), timeline.certainty_table(bodies, measured["jitter"])]
    if people.identities:
        names, whose = [person.name for person in bodies], read_identities(people.identities[0])
        found = [split_tracks(read_detections(path), whose) for path in people.detections]
        parts.append(timeline.timeline_strip(timeline.frames_with_detections(found, whose, names, frames), names))
    parts += [sections.rejected_people_table(read_association(path)["left_out"]) for path in people.association]
    if people.masks:
        videos = [made.folder / "capture" / f"{mask.stem}.mkv" for mask in people.masks]
        parts.append(html.row(mask_pictures(videos, people.masks, frames // 2, width), min(len(videos), 4)))
    return parts


def room_section(made: ResultFiles, width: int) -> list[str]:
    """The section on the room: plate and depth of each camera."""
    plates, depths = made.each("plates/{}.png", made.cameras), made.each("depth/{}.exr", made.cameras)
    lead = "Each camera's view without people, and its depth."
    return [html.heading("The room", lead), html.row(room_pictures(plates, depths, width), min(len(plates), 4))]


def cameras_section(
    made: ResultFiles, measured: Mapping[str, Any], decided: Sequence[Mapping[str, Decision]]
) -> list[str]:
    """The section on cameras: how well they explain the keypoints, and how much of the stage they see."""
    sheet_bgr = read_image(made.folder / "cameras/refinement.png", cv2.IMREAD_COLOR, CURE)
    sheet = html.jpeg(sheet_bgr[..., ::-1], 1600)
    refinement = read_refinement(made.folder / "cameras/refinement.json")
    return [
        sections.cameras_table(refinement, sheet),
        sections.overlap_table(measured["rig"]),
        sections.coverage_table(decided),
    ]


def run(
    settings: Settings,
    manifest: Path,
    model: Path,
    measures: MeasuredFiles,
    people: PeopleFiles,
    ran: RunFiles,
    films: list[Path],
    linked: list[Path],
    poster: Path,
    costs: Written,
    page: Written,
) -> None:
    """Write the page; lists of optional files may be empty, and the page then says what is missing.

    Files that are not arguments have the names that the rules give them in ``results/<scene>``.
    """
    capture, measured, chosen = read_manifest(manifest), read_metrics(measures.metrics), json.loads(ran.budget)
    spent = run_cost(ran.benchmarks)
    write_json(costs, spent)
    names = tuple(camera.name for camera in read_model(model.parent)), tuple(f.camera for f in capture.held_out)
    made = ResultFiles(manifest.parents[1], *names, tuple(film.stem for film in films))
    width, decided = settings.picture_width, [read_decisions(path) for path in measures.decisions]
    recognised = read_recognition(measures.recognition[0]) if measures.recognition else {}
    ledgers = made.each("render/{}.tsv", made.shots)
    shown, rows = films_section(made, capture.frames, len(sections.version_names(measured)) > 1, settings)
    of_films = appendix.film_warnings(ledgers, settings.min_measured, settings.max_angle_deg)
    refinement = made.folder / "cameras/refinement.json"
    files = [measures.metrics, costs, *measures.decisions, refinement, *people.identities, *linked]
    lead = "Cameras that only this report uses. Differences are amplified."
    body = [
        *shown,
        html.heading("Against the held-out cameras", lead),
        *rows,
        sections.main_numbers(measured, spent),
        sections.measures_table(measured),
        sections.paper_comparison_table(measured, recognised, measures.paper),
        *people_section(made, capture.frames, measured, people, width),
        *truth_section(made, measured, width),
        *room_section(made, width),
        *cameras_section(made, measured, decided),
        verdicts.decisions_table(decided, spent),
        sections.cost_and_quality(measured, spent, chosen),
        sections.costs_table(spent),
        appendix.delivery_links(poster.parent, page),
        appendix.warnings_section([*read_warnings(ran.logs), *of_films]),
        appendix.data_links(made.folder, page, files, ledgers),
        sections.settings_table(ran.configuration),
        terms.licences(json.loads(ran.configuration), ran.licences),
        appendix.versions_section(measured["provenance"], spent["machine"]),
    ]
    first = [sections.head(capture.scene, capture, len(made.cameras), measured), player(poster, page)]
    content = [*first, html.contents(body), *body]
    write_text(page, html.page(f"{capture.scene}: 4D scene", content, comparison_slider.STYLE))
    say(f"the page is {page.stat().st_size / 1e6:.1f} MB and needs no network: {page}")
    for _, sentence in of_films:
        warn(sentence)
