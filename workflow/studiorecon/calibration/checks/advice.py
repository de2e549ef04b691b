# SPDX-License-Identifier: Apache-2.0
"""The doctor's verdict, and sentences on what to check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.calibration.checks.edges import edge_sentence, is_beyond_refinement
from studiorecon.rig.starts import LENS_READINGS

if TYPE_CHECKING:
    from jaxtyping import Integer

_UNEVEN_LIGHT = 1.5
# Levels of 255: decoders round grey by less, and the dullest room has ten times as much colour.
_GREY = 1.0
_BURNT = 0.1
# From this level on in all channels a pixel counts as white.
_WHITE = 250
# Error of detectors on real people with a careful calibration: 0.33 % of the longer side (6.3 of 1920 px, OpenPose).
_NOISE_SHARE = 0.004
# If people leave the cameras' relative rotation uncertain by more degrees than this, a sentence says so. Two people who
# walk past each other leave 2.9, one man in one place 7.
_MAX_OPEN_DEG = 4.0

# The page's headline for each verdict.
HEADLINES = {
    "good": "This capture is ready: calibration, clocks and footage agree.",
    "usable": "The calibration is roughly right: refinement will correct the cameras from people "
    "and the room's edges. The error is given below.",
    "check": "The calibration fits the people. Check the points below before the long run.",
    "cannot tell": "This calibration cannot be verified: the evidence also fits a wrong one, or there "
    "is nothing to compare.",
    "wrong": "Calibration, keypoints and pictures contradict each other. The long run would stop.",
}


def verdict(report: dict[str, Any], limit_px: float) -> tuple[str, list[str]]:
    """("good", "usable", "check", "cannot tell" or "wrong", sentences on what to check, the gravest first).

    ``report`` is as from ``doctor.examine``; ``limit_px`` is the median reprojection error above which
    ``cameras.refine`` stops.
    """
    refused = [report["sync"]["refusal"]] if report["sync"]["refusal"] else []
    if report["lengths"] and not report["required"]:
        # No other check is valid in lengths that are not metres; a sentence about their unit follows below.
        return "wrong", [*refused, report["lengths"]]
    with_keypoints = len(report["cameras"]) - len(report["without_keypoints"])
    alone = report["people"] and len(report["inactive_cameras"]) >= with_keypoints - 1
    wrong, unclear, rest = (
        [] if alone else _wrong(report, limit_px),
        _unclear(report),
        list(report["inactive_cameras"].values()) + list(report["oddities"]) + _clocks(report) + _footage(report),
    )
    if not report["people"]:
        unclear = [
            "there are no keypoints of people, so poses, clocks and unit are unchecked; only the "
            "calibration files and the footage were examined. Add keypoints/<camera>/*.json, or "
            "check in the picture that every camera points the right way."
        ]
    elif alone:
        unclear = ["people are seen by one camera alone, so poses, clocks and unit could not be compared with anything"]
    elif report["median_px"] is None and not wrong:
        unclear = [
            "no person of any two cameras fits: are the calibration, the videos and the "
            "keypoints of the same take, and synchronised? Or is no person ever in two pictures "
            "at once?"
        ]
    off = _off(report)
    if report["refined"] is not None and report["refined"]["elsewhere"] and not report["required"]:
        # Cameras that were moved since: nothing fits as read, another reading may seem to fit, and refinement corrects
        # it.
        wrong, unclear = [report["outlier_camera"]] if report["outlier_camera"] else [], []
    if report["edges"] is not None and report["edges"]["clear"] and not wrong:
        described = [edge_sentence(report["edges"])]
        if is_beyond_refinement(report["edges"]):
            unclear += described
        elif report["edges"]["mended"]:
            off += described
        else:
            rest = described + rest
    # Before any camera is blamed: the check of the keypoints against the pictures.
    compared = report.get("keypoints", {"refused": [], "notes": []})
    wrong, rest = compared["refused"] or wrong, rest + compared["notes"]
    name = (
        "wrong" if wrong else "cannot tell" if unclear else "usable" if off else "check" if rest or refused else "good"
    )
    # Held-out cameras need no keypoints: that is no reason for a check.
    silent = report["without_keypoints"] if report["people"] else []
    remarks = _left_open(report) if not wrong else []
    remarks += [f"camera {c} has no keypoints: check that the dots are on people in its picture" for c in silent]
    return name, refused + wrong + unclear + off + rest + remarks


def edge_agreement_note(report: dict[str, Any]) -> str:
    """A sentence about the room's edges where there is nothing to check; "" without one."""
    edges = report["edges"]
    return "" if edges is None or edges["clear"] or report["verdict"] == "wrong" else edge_sentence(edges)


def _wrong(report: dict[str, Any], limit_px: float) -> list[str]:
    rows = {row["hypothesis"]: row for row in report["hypotheses"]}
    found = [report["outlier_camera"]] if report["outlier_camera"] else []
    if required := report["required"]:
        row, as_read = rows[required[0]], rows["as read"]
        found.append(
            f"people fit if {' or '.join(required)} (agreement {row['score']:.2f}, {as_read['score']:.2f} as read): "
            f"{row['remedy']}, or export the calibration again"
        )
    if report["median_px"] is not None and report["median_px"] > limit_px:
        worst = max((px, c) for c, px in report["px_per_camera"].items() if px is not None)
        found.append(
            f"people are {report['median_px']:.0f} px off in the median where {limit_px:.0f} px "
            f"are allowed, worst in camera {worst[1]} "
            f"({worst[0]:.0f} px): the calibration is of other cameras or another zoom, "
            "or the keypoints of another picture size"
        )
    return found


def _off(report: dict[str, Any]) -> list[str]:
    """Sentences about a reprojection error above a detector's noise: other poses explain people better, or it is
    large."""
    px, refined = report["median_px"], report["refined"]
    if px is None and refined is None:
        return []
    width = max(max(a["wh"]) for a in report["footage"].values())
    better = refined is not None and refined["better"]
    if px is None:
        size = "no three cameras agree on a person with this calibration"
    elif not better and px <= _NOISE_SHARE * width:
        return []
    else:
        size = (
            f"people are {px:.1f} px off in the median ({px / width:.2%} of the picture, {report['median_mm']:.0f} "
            "mm at their distance)"
        )
    if not better:
        return [
            f"{size}, and no other poses of the cameras make that less: a coarse "
            "detector, clocks that differ, or moving cameras"
        ]
    turned = ", ".join(
        f"{c} by {m['turned_deg']:.1f}° and {100 * m['moved_m']:.0f} cm" for c, m in refined["moves"].items()
    )
    return [
        f"{size}, {refined['px']:.1f} px once refinement has moved the cameras "
        f"({turned}); usable, with cameras.refine on"
    ]


def _left_open(report: dict[str, Any]) -> list[str]:
    """Sentences about large camera errors that people cannot reveal."""
    refined = report["refined"]
    if refined is None or refined["between_deg"] is None:
        return []
    asked, between = refined["disagreement_deg"], refined["between_deg"]
    if asked + between <= _MAX_OPEN_DEG:
        return []
    remedy = "let a person walk through the whole room while all cameras film, or calibrate again if that is not enough"
    if refined["elsewhere"]:
        return [
            "after refinement, people determine the relative rotation of any two cameras to "
            f"±{between:.1f}° (95 %), less where the room's floor joins them; {remedy}"
        ]
    return [
        f"people alone determine the relative rotation of any two cameras to ±{between:.1f}° (95 "
        f"%), and would rotate two of them by {asked:.1f}°: a calibration that is off by up to "
        f"{asked + between:.1f}° fits these people; {remedy}"
    ]


def _unclear(report: dict[str, Any]) -> list[str]:
    apart = [*report["without_keypoints"], *report["inactive_cameras"]]
    found = [
        f"camera {camera} could not be checked: none of its keypoints fits two other cameras that agree; check its "
        "pose, keypoints and clock"
        for camera, px in report["px_per_camera"].items()
        if px is None and camera not in apart
    ]
    as_read, *others = report["hypotheses"]
    # A mild lens in the other model bends people by less than their own errors.
    close = [
        f"{row['hypothesis']} ({row['score']:.2f})"
        for row in others
        if row["close"] and row["hypothesis"] not in LENS_READINGS
    ]
    if close and not report["required"]:
        found.append(
            f"people agree about as well ({as_read['score']:.2f} as read) if {' or '.join(close)}; "
            "more frames of people would decide it"
        )
    return found


def _clocks(report: dict[str, Any]) -> list[str]:
    lags = report["sync"]["lags_frames"]
    late = {c: lag for c, lag in lags.items() if not lag["low"] <= 0 <= lag["high"]}
    if not late:
        return []
    starts = {c: about["first_frame"] + lags.get(c, {"frames": 0.0})["frames"]
              for c, about in report["footage"].items()}  # fmt: skip
    least = min(starts.values())
    listed = ", ".join(f'"{c}": {start - least:.4g}' for c, start in starts.items())
    described = [
        f"camera {c} is {lag['frames']:+.1f} frames late ({lag['low']:+.1f} to {lag['high']:+.1f})"
        for c, lag in late.items()
    ]
    return [f"by people's motion {'; '.join(described)}; if so, write starts: {{{listed}}} into capture.yaml"]


def _footage(report: dict[str, Any]) -> list[str]:
    found = footage_notes(list(report["footage"].values()))
    if report["coverage"]["2"] < 0.5:
        found.append(
            f"only {report['coverage']['2']:.0%} of the volume is seen by two cameras: people outside of it cannot "
            "be measured"
        )
    return found


def brightness_and_clipping(pictures: Sequence[Integer[np.ndarray, "H W 3"]]) -> dict[str, float]:
    """Mean grey 0..1 (``brightness``), share of white pixels (``burnt``) and mean difference of channels (``colour``,
    0..255) of a camera's (H, W, 3) uint8 pictures, every fourth pixel."""
    grey = float(np.mean([p[::4, ::4].mean() for p in pictures]) / 255)
    return {
        "brightness": grey,
        "burnt": float(np.mean([(p[::4, ::4].min(-1) >= _WHITE).mean() for p in pictures])),
        "colour": float(np.mean([np.ptp(p[::4, ::4], axis=-1).mean() for p in pictures])),
    }


def footage_notes(footage: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sentences about faults of the videos themselves; ``footage`` holds the cameras' entries as for
    ``doctor.examine``."""
    found = []
    for key, what, remedy in (
        (
            "fps",
            "frame rates",
            "every frame keeps its own time, and a slower camera samples fast motion less often",
        ),
        ("rotation_deg", "rotation tags", "harmless if the pictures below are upright"),
    ):
        values = {a["camera"]: a[key] for a in footage}
        if len(set(values.values())) > 1:
            listed = ", ".join(f"{c} {v:g}" for c, v in values.items())
            found.append(f"the {what} differ ({listed}): {remedy}")
    light = {a["camera"]: a["brightness"] for a in footage}
    if max(light.values()) > _UNEVEN_LIGHT * max(min(light.values()), 1e-3):
        found.append(
            "the exposures differ (mean grey "
            + ", ".join(f"{c} {v:.2f}" for c, v in light.items())
            + "): views of one thing will differ too"
        )
    grey = [a["camera"] for a in footage if a.get("colour", _GREY) < _GREY]
    if 0 < len(grey) < len(footage):
        found.append(f"the pictures of {', '.join(grey)} have no colour: views of one thing will differ")
    found += [
        f"camera {a['camera']}: {a['burnt']:.0%} of its pictures are burnt out" for a in footage if a["burnt"] > _BURNT
    ]
    return found
