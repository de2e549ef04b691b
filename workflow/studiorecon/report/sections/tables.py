# SPDX-License-Identifier: Apache-2.0
"""The page's sections made of numbers: head, measures, people, cameras, cost, settings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from studiorecon.pages import html
from studiorecon.report.sections.paper import paper_comparison as paper_table
from studiorecon.report.sections.quality_summary import quality_summary
from studiorecon.scene.capture import Manifest
from studiorecon.scene.decisions import Decision

MISSING = "not measured"
# name in metrics.json, name for readers, unit, digits, meaning. Arrows show which direction is better.
_MEASURES = (
    ("psnr", "PSNR ↑", "dB", 2, "whole picture"),
    ("ssim", "SSIM ↑", "", 4, "whole picture, windows inside it"),
    ("ssim_3dgs", "SSIM, zero-padded ↑", "", 4, "as in papers on Gaussian splatting"),
    ("lpips", "LPIPS ↓", "", 4, "perceptual distance, whole picture"),
    ("flip", "ꟻLIP ↓", "", 4, "perceptual distance that needs no weights, of some frames"),
    ("psnr_people", "PSNR, people ↑", "dB", 2, "pixels of people"),
    ("ssim_people", "SSIM, people ↑", "", 4, "windows inside people"),
    ("psnr_background", "PSNR, room ↑", "dB", 2, "all other pixels"),
    ("ssim_background", "SSIM, room ↑", "", 4, "all other pixels"),
    ("psnr_seen", "PSNR, seen ↑", "dB", 2, "surfaces of the room that some training camera sees at that time"),
    ("psnr_unseen", "PSNR, unseen ↑", "dB", 2, "surfaces of the room that no training camera sees"),
    ("share_seen", "share seen", "", 3, "of the room's pixels"),
    ("psnr_people_seen", "PSNR, people seen ↑", "dB", 2, "surfaces of people that some training camera sees"),
    ("psnr_people_unseen", "PSNR, people unseen ↑", "dB", 2, "surfaces of people that no training camera sees"),
    (
        "temporal_l1",
        "flicker ↓",
        "",
        5,
        "change against the previous picture moved along the photos' flow, mean absolute",
    ),
    ("warp_rms", "Warp-RMS ↓", "", 5, "the same, root mean square (papers: Warp-L2)"),
    ("flicker_excess", "flicker excess", "", 5, "flicker minus that of the photos; below 0 is too smooth"),
)


def format_value(value: float | None, digits: int, unit: str = "") -> str:
    """A number for readers; a value that was not measured is never shown as zero."""
    return MISSING if value is None else f"{value:.{digits}f} {unit}".strip()


def duration(seconds: float | None) -> str:
    """Seconds as minutes and seconds."""
    if seconds is None:
        return MISSING
    return f"{seconds:.1f} s" if seconds < 60 else f"{int(seconds // 60)} min {round(seconds % 60):02d} s"


def version_names(metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """The versions of films that differ: ``raw`` and ``enhanced``, or only ``enhanced`` when they are identical."""
    raw, final = (
        {name: found["value"] for name, found in metrics["pictures"].get(version, {}).items()}
        for version in ("raw", "enhanced")
    )
    return ("raw", "enhanced") if raw and final and raw != final else ("enhanced",)


def _title(version: str, versions: Sequence[str]) -> str:
    return version if len(versions) > 1 else "value"


def head(scene: str, capture: Manifest, cameras: int, metrics: Mapping[str, Any]) -> str:
    """Title, the sentence of judgement, and one on the capture."""
    held_out = len(capture.held_out)
    about = f"{cameras} training cameras, {held_out} held out, {capture.frames} frames at {capture.fps:g} per second."
    return (
        f'<h1>{html.escape(scene)}</h1><p class="lead">{html.escape(quality_summary(metrics))}</p>'
        f'<p class="soft">{html.escape(about)}</p>'
    )


def main_numbers(metrics: Mapping[str, Any], spent: Mapping[str, Any]) -> str:
    """The main numbers for a reader."""
    people, versions = metrics["bodies"].get("people") or {}, version_names(metrics)
    entries = []
    for version in reversed(versions):
        found = metrics["pictures"].get(version, {}).get("psnr", {})
        of = "" if len(versions) == 1 else ", enhanced" if version == "enhanced" else ", raw render"
        entries.append((format_value(found.get("value"), 2, "dB"), f"PSNR at held-out cameras{of}"))
    joints = f"mean joint error in the world, {len(people)} people" if people else "mean joint error"
    entries.append((format_value(metrics["bodies"]["mpjpe_world_mm"], 0, "mm"), joints))
    entries.append((duration(spent["total"]["seconds"]), "all jobs, one after the other"))
    return html.tiles(entries)


def measures_table(metrics: Mapping[str, Any]) -> str:
    """The table of picture measures, raw next to enhanced where they differ, with expandable values per camera."""
    rows = []
    reasons: dict[str, list[str]] = {}
    pictures, versions = metrics["pictures"], version_names(metrics)
    for name, title, unit, digits, meaning in _MEASURES:
        found = [pictures.get(version, {}).get(name, {"value": None, "reason": ""}) for version in versions]
        photo = pictures.get("photo", {}).get(name, {}).get("value")
        raw, final = found[0], found[-1]
        change = [] if len(versions) == 1 else [""]
        if change and raw["value"] is not None and final["value"] is not None:
            change = [f"{final['value'] - raw['value']:+.{digits}f}"]
        rows.append([title, *(format_value(entry["value"], digits, unit) for entry in found), *change, meaning])
        if photo is not None:
            rows[-1][-1] += f" (the photos themselves: {photo:.{digits}f})"
        if final["value"] is None and final.get("reason"):
            reasons.setdefault(final["reason"], []).append(title.rstrip(" ↑↓"))
    notes = "".join(
        f"<p class=soft>Not measured: {html.escape(', '.join(n))}: {html.escape(r)}.</p>" for r, n in reasons.items()
    )
    of_each = [(version, measure, digits) for version in versions for measure, digits in (("psnr", 2), ("ssim", 4))]
    each = [
        [camera, *(format_value(_camera(pictures, version, measure, camera), d) for version, measure, d in of_each)]
        for camera in pictures.get(versions[-1], {}).get("psnr", {}).get("cameras", {})
    ]
    header = [f"{version if len(versions) > 1 else ''} {measure.upper()}".strip() for version, measure, _ in of_each]
    per_camera = html.table(["camera", *header], each, numeric=range(1, 1 + len(header))) if each else ""
    # A note on scores of cameras that were moved or whose pose could not be checked.
    notes += "".join(
        f"<p class=soft>{html.escape(c['sentence'][:1].upper() + c['sentence'][1:])}.</p>"
        for c in metrics.get("held_out_cameras", ())
        if c["turned_deg"] or not c["is_verified"]
    )
    columns = [*(_title(version, versions) for version in versions), *(["change"] if len(versions) > 1 else [])]
    table = html.table(["measure", *columns, "measured on"], rows, numeric=range(1, 1 + len(columns)))
    return table + per_camera + notes


def paper_comparison_table(metrics: Mapping[str, Any], recognised: Mapping[str, Any], rows: Path) -> str:
    """This run as a row of the paper's tables, with a plain note that the paper's methods ran on other captures."""
    lead = "The paper measured its methods on other data: the columns show usual values and do not rank the methods."
    header, lines = paper_table(metrics, recognised, rows, version_names(metrics))
    table = html.table(header, lines, numeric=range(1, len(header) - 1))
    return f"<details><summary>Compared with the paper's tables</summary><p>{html.escape(lead)}</p>{table}</details>"


def joint_errors_table(metrics: Mapping[str, Any]) -> str:
    """Joint errors per person."""
    bodies = metrics["bodies"]
    parts = [
        html.heading(
            "People",
            "Joint errors against the true bodies: in the world, pelvis on pelvis, and after the best similarity.",
        )
    ]
    names = ("mpjpe_world_mm", "mpjpe_pelvis_mm", "mpjpe_similarity_mm")
    rows = [
        [name, entry["true_person"], str(entry["frames"]), *(format_value(entry[n], 1, "mm") for n in names)]
        for name, entry in bodies["people"].items()
    ]
    if rows:
        parts.append(
            html.table(["person", "true person", "frames", "world", "pelvis", "similarity"], rows, numeric=(2, 3, 4, 5))
        )
    else:
        parts.append(
            f"<p>Joint errors are {MISSING}: {html.escape(bodies.get('reason') or 'no person was fitted')}.</p>"
        )
    for key, sentence in (("missed", "True people without a fit"), ("invented", "Fitted people who are not real")):
        if bodies[key]:
            parts.append(f"<p>{sentence}: {html.escape(', '.join(bodies[key]))}.</p>")
    return "".join(parts)


def rejected_people_table(those: Sequence[Mapping[str, Any]]) -> str:
    """The short list of people that association left out, with reason and remedy; empty without any."""
    if not those:
        return ""
    lead = (
        "At least two cameras saw each of these for a second, or for half of a shorter clip. Their pictures are in "
        "people/review.html. To accept one, copy people/identities.tsv into the dataset folder and replace the "
        "lines of the same tracks by these."
    )
    rows = [
        [
            one["name"],
            f"{one['seconds']:.1f} s",
            ", ".join(one["cameras"]),
            one["reason"],
            html.details(f"{len(one['lines'])} lines", "\n".join(one["lines"])),
        ]
        for one in those
    ]
    header = ["person", "seen for", "seen by", "reason", "lines to accept"]
    return html.heading("People left out", lead) + html.table(header, rows, raw=(4,))


def cameras_table(doctor: Any, sheet: str) -> str:
    """How well the cameras explain the keypoints, and the contact sheet."""
    lead = "How well the calibration explains the keypoints."
    errors = zip(
        doctor.get("cameras", ()), doctor.get("before_px_per_camera") or (), doctor.get("after_px_per_camera") or ()
    )
    rows = [[name, format_value(before, 2, "px"), format_value(after, 2, "px")] for name, before, after in errors]
    header = ["camera", "reprojection error as calibrated", "as used"]
    return (
        html.heading("Cameras", lead)
        + "".join(f"<p><b>{html.escape(d)}</b></p>" for d in (doctor.get("calibration") or {}).get("doubts") or ())
        + (html.table(header, rows, numeric=(1, 2)) if rows else "")
        + _edges(doctor.get("edges"))
        + html.figure(sheet, "contact sheet of all cameras")
    )


def _edges(edge: Any) -> str:
    """How the room's straight edges constrained the cameras' rotation, before refinement and after."""
    if edge is None:
        return ""
    off = f"the rotation between {' and '.join(edge['cameras'])} by {edge['off_deg']:.1f}°"
    if edge["believed"]:
        sentence = (
            f"contradicted {off}; after refinement by {edge['off_after_deg']:.1f}°, with an interval of "
            f"±{edge['between_deg']:.1f}° (95 %)"
        )
    else:
        sentence = f"differ from {off}, {edge['off_sigmas']:.1f} of their standard deviations: no camera was refined"
    return f"<p class=soft>{html.escape(f'The straight edges of the room {sentence}.')}</p>"


def coverage_table(decided: Sequence[Mapping[str, Decision]]) -> str:
    """Shares of the stage that one, two, … training cameras see, by the survey; empty without its measurement."""
    shares = next((d["view_synthesis"].detail.get("seen_by") for d in decided if "view_synthesis" in d), None)
    if not shares:
        return ""
    rows = [[f"{count} or more", f"{share:.0%}", html.bar(share)] for count, share in enumerate(shares, start=1)]
    lead = "Share of the stage, from the floor to the height of people, by the number of training cameras that see it."
    return f"<p>{html.escape(lead)}</p>" + html.table(["cameras", "share", ""], rows, numeric=(1,), raw=(2,))


def overlap_table(rig: Mapping[str, Any]) -> str:
    """The overlap of the training cameras, next to the paper's table; empty for a single camera."""
    if rig["position_deg"] is None:
        return ""
    rows = [
        ["training cameras", str(rig["training_cameras"]), "4", "3"],
        [
            "between any two cameras, about the scene's middle",
            format_value(rig["position_deg"], 0, "°"),
            "117 °",
            "17 °",
        ],
        ["from an optical axis to the nearest other", format_value(rig["viewing_deg"], 0, "°"), "70 °", "28 °"],
    ]
    return html.table(["angle", "here", "the paper's captures", "its prior work's"], rows, numeric=(1, 2, 3))


def cost_and_quality(metrics: Mapping[str, Any], spent: Mapping[str, Any], budget: Mapping[str, Any]) -> str:
    """The cost and scores of this run in one sentence and three numbers, with the prediction of its ``budget``."""
    if spent["reason"]:
        return html.heading("What accuracy costs") + f"<p>{MISSING}: {html.escape(spent['reason'])}.</p>"
    seconds = {stage: entry["seconds"] or 0.0 for stage, entry in spent["stages"].items()}
    dearest = sorted(seconds, key=seconds.__getitem__, reverse=True)[:3]
    share = sum(seconds[stage] for stage in dearest) / (sum(seconds.values()) or 1.0)
    final = metrics["pictures"].get("enhanced", metrics["pictures"].get("raw", {})).get("psnr", {})
    psnr = format_value(final.get("value"), 2, "dB")
    parts = ", ".join(f"{stage} {duration(seconds[stage])}" for stage in dearest)
    took = duration(spent["total"]["seconds"])
    sentence = f"On this machine: {took} → {psnr} at held-out cameras; {100 * share:.0f} % of it is {parts}."
    tiles = [
        (psnr, "PSNR at held-out cameras"),
        (duration(spent["total"]["seconds"]), "all jobs, one after the other"),
        (format_value(spent["total"]["peak_memory_mb"], 0, "MB"), "memory of the largest job"),
    ]
    lead = "snakemake sweep measures what other settings cost and gain on this scene."
    cost = f"<p>{html.escape(_bought(budget, spent))}</p>" if budget else ""
    return (
        html.heading("What accuracy costs", lead) + f"<p><b>{html.escape(sentence)}</b></p>" + html.tiles(tiles) + cost
    )


def _bought(budget: Mapping[str, Any], spent: Mapping[str, Any]) -> str:
    predicted = duration(budget["predicted_s"])
    ends = f"{duration(budget['low_s'])} to {duration(budget['high_s'])}"
    took = spent["total"]["cpu_seconds"]
    return (
        f"A budget of {budget['minutes']:g} min chose {budget['preset'] or 'the defaults'}: predicted {predicted} from "
        f"nothing ({ends}). Its jobs were predicted to take {duration(budget['work_s'])} of processor time and took "
        f"{duration(took) if took else MISSING}. {budget['more'][:1].upper()}{budget['more'][1:]}."
    )


def costs_table(spent: Mapping[str, Any]) -> str:
    """Seconds per stage as bars, with memory and the rules on demand."""
    lead = "Wall seconds of all jobs of a stage, added up; stages may have run at the same time."
    if spent["reason"]:
        return html.heading("Where the time went") + f"<p>{MISSING}: {html.escape(spent['reason'])}.</p>"
    longest = max((stage["seconds"] or 0 for stage in spent["stages"].values()), default=0) or 1
    rows = [
        [
            name,
            f"{stage['count']:.0f}",
            duration(stage["seconds"]),
            html.bar((stage["seconds"] or 0) / longest),
            format_value(stage["peak_memory_mb"], 0, "MB"),
        ]
        for name, stage in spent["stages"].items()
    ]
    total = spent["total"]
    rows.append(
        ["all", f"{total['count']:.0f}", duration(total["seconds"]), "", format_value(total["peak_memory_mb"], 0, "MB")]
    )
    by_rule = [
        [
            f"{stage}.{rule}",
            f"{entry['count']:.0f}",
            duration(entry["seconds"]),
            format_value(entry["peak_memory_mb"], 0, "MB"),
        ]
        for stage, parts in spent["stages"].items()
        for rule, entry in parts["rules"].items()
    ]
    table = html.table(["stage", "jobs", "time", "", "largest job"], rows, numeric=(1, 2, 4), raw=(3,))
    return (
        html.heading("Where the time went", lead)
        + table
        + "<details><summary>Per step</summary>"
        + (html.table(["step", "jobs", "time", "largest job"], by_rule, numeric=(1, 2, 3)) + "</details>")
    )


def settings_table(configuration: str) -> str:
    """Every setting of the run, a line each."""
    return html.heading("Settings") + html.details(
        "All settings of this run", "\n".join(_lines(json.loads(configuration), ""))
    )


def _lines(values: Mapping[str, Any], above: str) -> Iterator[str]:
    for name, value in sorted(values.items()):
        if isinstance(value, Mapping) and value:
            yield from _lines(value, f"{above}{name}.")
        else:
            listed = ", ".join(map(str, value)) if isinstance(value, Sequence) and not isinstance(value, str) else value
            yield f"{above}{name} = {listed}"


def _camera(pictures: Mapping[str, Any], version: str, measure: str, camera: str) -> float | None:
    return pictures.get(version, {}).get(measure, {}).get("cameras", {}).get(camera, {}).get("value")
