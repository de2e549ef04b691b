# SPDX-License-Identifier: Apache-2.0
"""``humans.proxy``: the body itself as a canonical person with a chequered texture, only on request.

It has the person's build without their appearance: for films that must not show them, and to show the motion only.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.humans.start_settings import StartSettings
from studiorecon.humans.surface_samples import gaussians_on, initial_samples
from studiorecon.progress import say
from studiorecon.scene.gaussians import sh_from_rgb
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped

# Colours of a body's parts, sRGB in 0..1; a part without an entry (all of an SMPL body) has the first.
_COLOURS = {
    "skin": (0.80, 0.72, 0.62), "hair": (0.25, 0.22, 0.20), "shirt": (0.85, 0.55, 0.20), "trousers": (0.25, 0.45, 0.60),
    "shoes": (0.20, 0.20, 0.22), "eyes": (0.15, 0.15, 0.18),
}  # fmt: skip


@dataclass(frozen=True)
class Settings(StartSettings):
    """Number of Gaussians, and the seed of their positions."""


def chequered_colours(points_m: Float[np.ndarray, "N 3"], parts: Shaped[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"]:
    """Colours of rest-pose points on parts named as in a body model: squares of 7 cm, every other darker."""
    base = np.array([_COLOURS.get(str(part), _COLOURS["skin"]) for part in parts])
    dark = np.floor(points_m / 0.07).astype(int).sum(axis=1) % 2 == 0
    return np.where(dark[:, None], 0.72 * base, base)


def run(settings: Settings, body: Path, fit: Path, gaussians: Written) -> None:
    """Write the body of the person of ``fit`` in its rest pose as a canonical ``.ply``."""
    model = BodyModel.load(body)
    person = read_person(fit, model=model)
    rest = model.rest_vertices(person.betas)
    names = np.array(model.region_names)[model.region]
    faces = model.faces[names[model.faces[:, 0]] != "inside"]
    samples = initial_samples(rest, faces, model.weights, settings, np.random.default_rng(settings.seed))
    parts = names[scipy.spatial.cKDTree(rest).query(samples.points_m)[1]]
    made = gaussians_on(samples, 0)
    made.sh[:, 0] = sh_from_rgb(chequered_colours(samples.points_m, parts))
    write_ply(gaussians, made)
    say(f"{person.name}: the bare body of this build, {made.count} Gaussians in {gaussians.name}")
