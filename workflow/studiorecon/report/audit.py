# SPDX-License-Identifier: Apache-2.0
"""What only a trained scene shows: is refinement, the temporal network, enhancement or injection called for?

Writes ``report/audit.json`` beside ``decisions.json``. These verdicts come after the work that they are about: they
say what to choose in the next run, and whether what was chosen was worth its time.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import read_frames_from
from studiorecon.geometry.statistics import NOTHING, Estimate
from studiorecon.progress import say
from studiorecon.report.metrics.rendered_effects import (
    appearance,
    decide_enhancement,
    decide_injection,
    decide_refinement,
    density_px,
    excess_flicker,
    thin_share,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision, forced, from_entry, switched_on, write_decisions
from studiorecon.scene.effects import LATE, force, thresholds
from studiorecon.scene.files import read_table
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.path import PathStep, read_path
from studiorecon.signature import Written
from studiorecon.splatting.device import rasteriser

_RISE, _LONGEST_PX, _NEAR_M = 0.15, 240, 0.05
# Successive pictures of a shot with a camera that stands still that are compared, and how little static pixels of the
# raw film change.
_STILL_PICTURES, _STATIC_LEVELS = 12, 1.0
# Pictures of a film show nearly the same: so many count as one.
_TOGETHER = 12
if TYPE_CHECKING:
    Named = str
else:
    Named = Literal[tuple(effect.name for effect in LATE)]


@dataclass(frozen=True)
class Settings:
    """Of the effects that only a trained scene shows; ``survey.effects.Decided`` declares them for all."""

    thresholds: Mapping[Named, float] = thresholds(LATE)
    force: Mapping[Named, str] = force(LATE)


def raised(camera: Camera, share: float) -> Camera:
    """The camera, smaller, at another height: ``share`` of its own higher or lower, looking the same way."""
    scale = max(max(camera.wh) / _LONGEST_PX, 1.0)
    centre = camera.centre_m * np.array([1.0, 1.0, 1 + share])
    pose = camera.camera_from_world.copy()
    pose[:3, 3] = -pose[:3, :3] @ centre
    small = camera.resized((round(camera.wh[0] / scale), round(camera.wh[1] / scale)))
    return replace(small, camera_from_world=pose)


def thinness(background: Gaussians, cameras: Sequence[Camera], device: str) -> Estimate:
    """How thin the room is seen from 15 % higher and lower than every camera."""
    drawing = rasteriser(device, near_m=_NEAR_M)
    alphas, densities = [], []
    for camera in (raised(c, share) for c in cameras for share in (_RISE, -_RISE)):
        alphas.append(np.asarray(drawing.forward(background, camera).alpha))
        densities.append(density_px(camera.project(np.asarray(background.means_m, np.float64))[0], camera.hw))
    sizes = {a.shape for a in alphas}
    # Cameras of several sizes are of one kind only within a size; the largest group speaks.
    most = max(sizes, key=lambda hw: sum(a.shape == hw for a in alphas))
    return thin_share(
        np.stack([a for a in alphas if a.shape == most]), np.stack([d for d in densities if d.shape == most])
    )


def unseen_share(ledgers: Sequence[Path]) -> Estimate:
    """Share of the films' pixels that no training camera measured, with its scatter over the pictures."""
    rows = [row for path in ledgers for row in read_table(path, ("picture", "measured"))]
    if not rows:
        return NOTHING
    unseen = 1 - np.array([float(row["measured"]) for row in rows])
    error = float(unseen.std() / np.sqrt(max(len(unseen) / _TOGETHER, 1)))
    value = float(unseen.mean())
    return Estimate(value, (max(value - 2 * error, 0.0), min(value + 2 * error, 1.0)))


def still_stretches(steps: Sequence[PathStep]) -> Iterator[tuple[int, int]]:
    """(first, stop) of pictures on end that one unmoving camera shows."""
    for _, group in groupby(
        range(len(steps)), key=lambda i: (steps[i].segment, steps[i].camera.camera_from_world.tobytes())
    ):
        held = list(group)
        if len(held) > 3:
            yield held[0], min(held[-1] + 1, held[0] + _STILL_PICTURES)


def flicker(raw: Path, enhanced: Path, steps: Sequence[PathStep]) -> list[Estimate]:
    """How much more static pixels change after enhancement, for every stretch of a film in which the camera stands
    still."""
    found = []
    for first, stop in still_stretches(steps):
        before, after = (
            np.stack([_brightness(f) for f in read_frames_from(path, first, stop)]) for path in (raw, enhanced)
        )
        static = np.ptp(before, axis=0) <= _STATIC_LEVELS / 255
        found.append(excess_flicker(before, after, static))
    return found


def _brightness(picture: np.ndarray) -> np.ndarray:
    """(H, W) float64 brightness in 0..1, at full size: single pixels flicker."""
    return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float64) / 255


def decisions_of(avatars: Sequence[Path]) -> dict[str, Decision | None]:
    """What human training measured of every person."""
    found: dict[str, Decision | None] = {}
    for path in avatars:
        with np.load(path, allow_pickle=False) as held:
            told = str(held["decision"]) if "decision" in held.files else ""
        found[path.stem] = from_entry(json.loads(told)) if told else None
    return found


def run(
    settings: Settings,
    model: Path,
    background: Path,
    avatars: list[Path],
    ledgers: list[Path],
    renders: list[Path],
    enhanced: list[Path],
    paths: list[Path],
    history: int,
    earlier: list[Path],
    decisions: Written,
    device: str = "cpu",
) -> None:
    """Decide from what was rendered; ``history`` earlier pictures were injected (enhance.injection.history).
    ``earlier``: the audit of an earlier run, for the hysteresis.

    LPIPS is not computed here: its weights are the user's own, so one half of what decides on enhancement stays
    unmeasured.
    """
    limit, cameras = {e.name: e.threshold for e in LATE} | dict(settings.thresholds), read_model(model.parent)
    was_on = switched_on(earlier)
    still = [
        e
        for raw, better, path in zip(renders, enhanced, paths, strict=True)
        for e in flicker(raw, better, read_path(path)[0])
    ]
    thin = thinness(read_ply(background), cameras, device)
    measured = [
        decide_refinement(thin, limit["refinement"], "refinement" in was_on),
        appearance(decisions_of(avatars), limit["temporal_appearance"]),
        decide_enhancement(NOTHING, unseen_share(ledgers), limit["enhancement"], "enhancement" in was_on),
        decide_injection(still, history, limit["injection"], "injection" in was_on),
    ]
    made = forced(measured, settings.force)
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    write_decisions(decisions, made)
