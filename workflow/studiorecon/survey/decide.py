# SPDX-License-Identifier: Apache-2.0
"""Which effects does this scene call for? Each decision has a statistic, a threshold and a sentence, and can be forced.

Only what a decision is about is simulated later; "undetermined" takes the cheaper branch and says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.images.exr import read_depth
from studiorecon.images.stills import read_plate
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.decisions import Decision, forced, write_decisions
from studiorecon.scene.people import read_people
from studiorecon.survey.coverage import from_two_sides, largest_gap_deg, mean_pair_deg, seen_by, stage_points
from studiorecon.survey.exposures import View, disagreement, overlaps

# Sides from which a surface must be seen to be placed (numerics T01).
_PARALLAX_DEG = 2.0
# Least common surface points of two cameras that are evidence, and standard errors that make a difference certain.
_LEAST_PIXELS, _CERTAIN = 50, 5.0


@dataclass(frozen=True)
class Settings:
    """Thresholds.

    Attributes:
        coverage: view synthesis is left out when at least this share of the stage is seen from two sides …
        gap_deg: … and neighbouring cameras are at most this far apart.
        ring_deg: the cameras form a ring when no gap is wider.
        grid_m, height_m: step and height of the points of the stage.
        depth_tolerance: share of depth within which two depths are one surface.
        exposure: share by which exposures must differ to matter.
        force: effect → "on" or "off".
    """

    coverage: float
    gap_deg: float
    ring_deg: float
    grid_m: float
    height_m: float
    depth_tolerance: float
    exposure: float
    force: Mapping[str, str]


def decide_people(found: Sequence[str] | None) -> Decision:
    """Are there people? ``found`` is None when the dataset says the room is empty."""
    count = len(found or ())
    if found is None:
        reason = "the dataset says that nobody is there; the film shows the room alone"
    elif not found:
        reason = "nobody was seen by enough cameras; the film shows the room alone"
    else:
        reason = f"{', '.join(found)} will be reconstructed, each on its own"
    return Decision(
        "people", "persons followed by several cameras", float(count), (float(count),) * 2, 1.0, "on" if count else "off", reason
    )


def decide_views(cameras: Sequence[Camera], depths_m: Sequence[np.ndarray], settings: Settings) -> list[Decision]:
    """Do the photos cover the stage, so that no views need to be synthesised between them? And do the cameras form a ring?"""
    points = stage_points(cameras, settings.grid_m, settings.height_m)
    gap = largest_gap_deg(cameras)
    # A ring of wide-apart cameras has its gap between every two neighbours; an arc has one beyond its ends, which nobody crosses.
    ring = gap <= settings.ring_deg
    closed = Decision(
        "closed_path",
        "largest azimuth between neighbouring cameras, degrees",
        gap,
        (gap, gap),
        settings.ring_deg,
        "on" if ring else "off",
        f"the cameras {'surround the stage' if ring else 'leave one side open'}: the widest gap is {gap:.0f} degrees, "
        f"and any two are {mean_pair_deg(cameras):.0f} degrees apart on average",
    )
    statistic = "share of the stage seen from two sides"
    if not len(points):
        reason = "the cameras stand on the spot they look at, so there is no stage between them"
        return [Decision("view_synthesis", statistic, None, None, settings.coverage, "undetermined", reason), closed]
    seen = seen_by(points, cameras, depths_m, settings.depth_tolerance)
    once, twice = float(seen.any(axis=0).mean()), float(from_two_sides(points, cameras, seen, _PARALLAX_DEG).mean())
    error = float(np.sqrt(max(twice * (1 - twice), 1e-6) / len(points)))
    enough = twice >= settings.coverage and gap <= settings.gap_deg
    verdict = "off" if enough else "on"
    reason = (
        f"{once:.0%} of the stage is seen by one camera or more and {twice:.0%} from two sides, with up to {gap:.0f} degrees between "
        f"neighbours: views in between are {'not needed' if enough else 'synthesised'}"
    )
    return [
        Decision("view_synthesis", statistic, twice, (twice - 2 * error, twice + 2 * error), settings.coverage, verdict, reason),
        closed,
    ]


def decide_exposure(views: Sequence[View], settings: Settings) -> Decision:
    """Do the cameras' exposures differ enough to matter (evaluation: ignored, 2 % caps PSNR at 40 dB, 10 % at 26 dB)?"""
    statistic = "largest difference of a camera's gain from the mean, share"
    found, errors = overlaps(views, settings.depth_tolerance, _LEAST_PIXELS)
    if not found:
        reason = "no two cameras share enough surface to compare their colours"
        return Decision("exposure", statistic, None, None, settings.exposure, "undetermined", reason)
    value, error, gains = disagreement(len(views), found, errors)
    on = value > settings.exposure and value > _CERTAIN * error
    worst = int(np.abs(gains - 1).max(axis=1).argmax())
    told = " ".join(f"{g:.3f}" for g in gains[worst])
    reason = (
        f"{views[worst].camera.name} differs most (red, green, blue × {told}): cameras {'need' if on else 'do not need'} gains of their own"
    )
    return Decision("exposure", statistic, value, (value - 2 * error, value + 2 * error), settings.exposure, "on" if on else "off", reason)


def run(
    settings: Settings, manifest: Path, model: Path, people: list[Path], plates: list[Path], depths: list[Path], decisions: Path
) -> None:
    """Decide from what the earlier stages found; ``people`` is the table of people, absent when the room is known to be empty."""
    cameras = read_model(model.parent)
    depths_m = [read_depth(path)[0] for path in depths]
    views = [View(c, *read_plate(plate), depth) for c, plate, depth in zip(cameras, plates, depths_m, strict=True)]
    made = [
        decide_people(read_people(people[0]) if people else None),
        *decide_views(cameras, depths_m, settings),
        decide_exposure(views, settings),
    ]
    made = forced(made, settings.force)
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    say(f"{len(read_manifest(manifest).footage)} cameras surveyed")
    write_decisions(decisions, made)
