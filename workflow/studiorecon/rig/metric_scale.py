# SPDX-License-Identifier: Apache-2.0
"""Metres for cameras estimated from people: a person's height, or a measured distance between two cameras.

Without either, people's bones are assumed to be a mean adult's, which is wrong by as much as people differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.geometry.triangulation import TriangulatedPoints
from studiorecon.rig.correspondences import Observations
from studiorecon.rig.from_tracks import bone_factor
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Num

# Sigma of limbs of people of one height, as a share, and of a detector's joints.
_OF_HEIGHT = 0.02
# If persons' heights give scales further apart than this, the identities are wrong.
_CONTRADICT = 0.12


@dataclass(frozen=True)
class GivenLengths:
    """Lengths in capture.yaml.

    Attributes:
        height_m: person → height, metres; "" = everybody's, or their mean.
        between: two cameras, and ``distance_m`` from lens to lens; empty: not given.
    """

    height_m: Mapping[str, float] = field(default_factory=dict)
    between: tuple[str, ...] = ()
    distance_m: float = 0.0


@dataclass(frozen=True)
class Scale:
    """Factor on all lengths, its sigma (a share), and a sentence with its reason."""

    factor: float
    sigma: float
    basis: str


def stature_m(body: BodyModel) -> float:
    """Height of the body of mean shape, metres."""
    heights = body.rest_vertices(np.zeros(body.shapes))[:, 1]
    return float(np.ptp(heights))


def scale_from_lengths(
    given: GivenLengths,
    cameras: Sequence[Camera],
    points: Num[np.ndarray, "N 3"],
    found: TriangulatedPoints,
    seen: Observations,
    template_m: Num[np.ndarray, "12 3"],
    mean_stature_m: float,
) -> Scale | None:
    """The scale from the given lengths, where a distance has priority over heights; None without any.

    ``points``, NaN unknown, are those of ``found`` and ``seen`` in the units of ``cameras``; ``template_m`` and
    ``mean_stature_m`` are the mean body's. Raises UserError for unknown names, and for heights that contradict one
    another.
    """
    if given.between:
        return _by_distance(given, cameras)
    if not given.height_m:
        return None
    if "" in given.height_m:
        height = given.height_m[""]
        factor = bone_factor(points, found, seen, template_m * (height / mean_stature_m))
        return None if factor is None else Scale(factor, _OF_HEIGHT, f"lengths by people's height of {height:.2f} m")
    people = people_in_order(points, seen)
    factors = {}
    for name, height in given.height_m.items():
        number = int(name[1:]) if name[:1] == "p" and name[1:].isdigit() else -1
        if not 0 <= number < len(people):
            there = ", ".join(f"p{k}" for k in range(len(people)))
            raise UserError(
                f"capture.yaml gives the height_m of {name}, but the cameras were estimated from {there}: correct it"
            )
        own = np.where((seen.group == people[number])[:, None], points, np.nan)
        factor = bone_factor(own, found, seen, template_m * (height / mean_stature_m))
        if factor is not None:
            factors[name] = factor
    if not factors:
        return None
    if max(factors.values()) > (1 + _CONTRADICT) * min(factors.values()):
        described = ", ".join(f"{name} {factor:.2f}" for name, factor in factors.items())
        raise UserError(
            "the heights in capture.yaml contradict one another (each alone multiplies lengths "
            f"by {described}): check the identities, or give one height_m for all: height_m: 1.70"
        )
    named = ", ".join(f"{name} is {given.height_m[name]:.2f} m tall" for name in factors)
    who = "; ".join(f"{name}: {_visibility_note(people[int(name[1:])], cameras, points, seen)}" for name in factors)
    factor = float(np.exp(np.mean(np.log(list(factors.values())))))
    return Scale(factor, _OF_HEIGHT / np.sqrt(len(factors)), f"lengths by heights: {named} ({who})")


def people_in_order(points: Num[np.ndarray, "N 3"], seen: Observations) -> list[int]:
    """Groups in association's order of p0, p1, …: by first frame, then by duration, then by x.

    Groups too short for a person are left out.
    """
    described = []
    for group in np.unique(seen.group):
        mine = (seen.group == group) & np.isfinite(points).all(-1)
        if mine.any():
            frames = np.unique(seen.frame[mine])
            described.append((int(frames[0]), -len(frames), float(np.median(points[mine, 0])), int(group)))
    longest = max((-t[1] for t in described), default=0)
    return [group for *_, group in sorted(t for t in described if -t[1] >= 0.25 * longest)]


def _by_distance(given: GivenLengths, cameras: Sequence[Camera]) -> Scale:
    at = {c.name: c.centre_m for c in cameras}
    if missing := [name for name in given.between if name not in at]:
        raise UserError(
            f"capture.yaml measures distance_m from camera {missing[0]}, but the cameras are {', '.join(at)}"
        )
    first, second = given.between
    apart = float(np.linalg.norm(at[first] - at[second]))
    described = f"lengths by the {given.distance_m:.2f} m between {first} and {second}"
    return Scale(given.distance_m / max(apart, 1e-9), 0.005, described)


def _visibility_note(group: int, cameras: Sequence[Camera], points: np.ndarray, seen: Observations) -> str:
    """A sentence that helps to locate a person in the pictures: the first camera that sees them, and its pixels."""
    mine = np.flatnonzero((seen.group == group) & np.isfinite(points).all(-1))
    frame = seen.frame[mine].min()
    now = mine[seen.frame[mine] == frame]
    view = int(np.argmax((seen.confidence[:, now] > 0).sum(1)))
    x, y = np.nanmedian(seen.pixels[view, now], axis=0)
    return f"at ({x:.0f}, {y:.0f}) in {cameras[view].name} at moment {frame}"
