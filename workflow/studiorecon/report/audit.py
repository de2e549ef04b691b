# SPDX-License-Identifier: Apache-2.0
"""What only a trained scene shows: is refinement, the temporal network, enhancement or injection called for?

Writes ``report/audit.json`` beside ``decisions.json``. Human training and the films decided on theirs before the work
that they are about; refinement's verdict says what to choose in the next run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.geometry.statistics import Estimate
from studiorecon.progress import say
from studiorecon.report.metrics.rendered_effects import (
    appearance,
    decide_refinement,
    density_px,
    thin_share,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import Decision, forced, from_entry, read_decisions, write_decisions
from studiorecon.scene.effects import FILMED, TRAINED, force, thresholds
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.intermediate import read_arrays
from studiorecon.signature import Written
from studiorecon.splatting.device import rasteriser

_RISE, _LONGEST_PX, _NEAR_M = 0.15, 240, 0.05
if TYPE_CHECKING:
    Named = str
    Acting = str
else:
    Named = Literal[tuple(effect.name for effect in TRAINED)]
    Acting = Literal[tuple(effect.name for effect in TRAINED if effect.acts)]


@dataclass(frozen=True)
class Settings:
    """Of the effects that only a trained scene shows; ``survey.effects.Decided`` declares them for all."""

    thresholds: Mapping[Named, float] = thresholds(TRAINED)
    force: Mapping[Acting, str] = force(TRAINED)


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


def decisions_of(avatars: Sequence[Path]) -> dict[str, Decision | None]:
    """What human training measured of every person."""
    found: dict[str, Decision | None] = {}
    for path in avatars:
        told = str(read_arrays(path, ["decision"])["decision"])
        found[path.stem] = from_entry(json.loads(told)) if told else None
    return found


def of_films(files: Sequence[Path]) -> list[Decision]:
    """What the films measured, one decision per effect of ``FILMED``: of the film that calls for it most."""
    found = [read_decisions(path) for path in files]
    made = []
    for effect in FILMED:
        measured = [decisions[effect.name] for decisions in found if effect.name in decisions]
        if measured:
            made.append(max(measured, key=lambda one: (one.called_for, one.value is not None, one.value or 0.0)))
        else:
            made.append(effect.decide(None, None, "no film was made here that it could be measured on"))
    return made


def run(
    settings: Settings,
    model: Path,
    background: Path,
    avatars: list[Path],
    films: list[Path],
    decisions: Written,
    device: str = "cpu",
) -> None:
    """Decide from what was trained; ``films`` are the decisions of every film."""
    limit, cameras = {e.name: e.threshold for e in TRAINED} | dict(settings.thresholds), read_model(model.parent)
    thin = thinness(read_ply(background), cameras, device)
    measured = [
        decide_refinement(thin, limit["refinement"]),
        appearance(decisions_of(avatars), limit["temporal_appearance"]),
    ]
    made = [*forced(measured, settings.force), *of_films(films)]
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    write_decisions(decisions, made)
