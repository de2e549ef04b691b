# SPDX-License-Identifier: Apache-2.0
"""The light of a room that people can shade: ``render/room.light.json``.

Lamps are patches of the room's ceiling and walls, and of a far sky. A surface that faces up loses this share of its
light:

    (sky · S + contact · C + Σ_k share_k · g_k · H_k) / (1 + Σ_k share_k · (g_k - 1))

with H_k the hidden share of lamp k, g_k its fall-off relative to where it was measured, S the hidden share of the
diffuse light from above and C the closeness of a body.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.render.occlusion import Groups, body_proximity, hidden_light, sky_discs
from studiorecon.scene.files import write_json
from studiorecon.scene.schema import Anything, ListOf, MappingOf, flag, metres, real, text
from studiorecon.scene.step_files import read

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped

# The smallest share of light in a shadow, and the lower bound of the denominator where distant lamps dominate.
_MIN_FACTOR, _MIN_TOTAL = 0.05, 0.25
_LAMP = {
    "position_m": metres("3"),
    "facing": real("3", low=-1, high=1),
    "radius_m": metres(low=0),
    "share": real(low=0),
    "mean_falloff": real(low=0),
}
_LIGHT = {
    "accepted": flag(),
    "reason": text(),
    "sky": real(low=0),
    "contact": real(low=0),
    "contact_m": metres(low=0),
    "floor_m": metres(),
    "figures": MappingOf(Anything()),
    "lamps": ListOf(_LAMP),
}


@dataclass(frozen=True)
class Lamps:
    """K patches that may give light.

    Attributes:
        facing: unit normals into the room; zeros for the sky, which is equally bright everywhere.
        radius_m: of the disc that represents the patch.
    """

    positions_m: Float[np.ndarray, "K 3"]
    facing: Float[np.ndarray, "K 3"]
    radius_m: Float[np.ndarray, " K"]

    @property
    def discs(self) -> Float[np.ndarray, "K 4"]:
        """Position and radius."""
        return np.concatenate([self.positions_m, self.radius_m[:, None]], axis=1)

    def take(self, index: Shaped[np.ndarray, " M"]) -> Lamps:
        """The lamps at ``index`` (integers or a boolean mask)."""
        return Lamps(self.positions_m[index], self.facing[index], self.radius_m[index])

    def falloff(self, points_m: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N K"]:
        """Light on points that face up from lamps of equal strength: both cosines over distance squared; 1 from the
        sky.
        """
        towards = self.positions_m[None] - np.asarray(points_m, np.float64)[:, None]
        distance = np.maximum(np.linalg.norm(towards, axis=-1), 0.1)
        cosines = (
            np.maximum(towards[..., 2], 0) * np.maximum(-np.einsum("nkx,kx->nk", towards, self.facing), 0) / distance**2
        )
        return np.where(self.facing.any(axis=1), cosines / distance**2, 1.0)


@dataclass(frozen=True)
class Light:
    """The estimated light.

    Attributes:
        accepted: whether it predicts pictures that it was not fitted to; otherwise films leave it out.
        reason: one sentence.
        lamps: patches that give light.
        share: of the light of an unshaded floor, averaged over where it was measured.
        mean_falloff: mean fall-off there.
        sky, contact, contact_m: strengths of the two other terms; reach of the latter.
        floor_m: height of the floor.
        figures: measures of the fit.
    """

    accepted: bool
    reason: str
    lamps: Lamps
    share: Float[np.ndarray, " K"]
    mean_falloff: Float[np.ndarray, " K"]
    sky: float
    contact: float
    contact_m: float
    floor_m: float
    figures: Mapping[str, float] = field(default_factory=dict)

    def factor(
        self, points_m: Float[np.ndarray, "N 3"], bodies: Sequence[Float[np.ndarray, "C 7"]]
    ) -> Float[np.ndarray, " N"]:
        """Float32 remaining share of light on points that face up, near bodies of capsules each."""
        return LitPoints(self, points_m).remaining_light(bodies)


class LitPoints:
    """N points that face up under a light, with everything precomputed that does not depend on bodies."""

    def __init__(self, light: Light, points_m: Float[np.ndarray, "N 3"]) -> None:
        part = light.share * light.lamps.falloff(points_m) / light.mean_falloff
        self._light, self._groups = light, Groups.of(points_m)
        self._total = np.maximum(1 + part.sum(axis=1) - light.share.sum(), _MIN_TOTAL)
        self._discs = light.lamps.discs
        # Most fits have no diffuse light, which would cost as much as the lamps.
        if light.sky:
            sky = sky_discs()
            self._discs = np.concatenate([self._discs, sky])
            part = np.concatenate([part, np.full((len(part), len(sky)), light.sky / len(sky))], axis=1)
        self._parts = self._groups.grouped(part)

    def remaining_light(self, bodies: Sequence[Float[np.ndarray, "C 7"]]) -> Float[np.ndarray, " N"]:
        """Float32 remaining share of light on the points, near bodies of capsules each."""
        if not any(len(body) for body in bodies):
            return np.ones(len(self._total), np.float32)
        gone = hidden_light(self._groups, self._parts, self._discs, bodies)
        if self._light.contact:
            gone = gone + self._light.contact * body_proximity(self._groups, bodies, self._light.contact_m)
        return np.clip(1 - gone / self._total, _MIN_FACTOR, 1).astype(np.float32)


def write_light(path: Path, light: Light) -> None:
    """Write the light, with one entry per lamp."""
    lamps = [
        {"position_m": p, "facing": f, "radius_m": r, "share": s, "mean_falloff": u}
        for p, f, r, s, u in zip(
            light.lamps.positions_m, light.lamps.facing, light.lamps.radius_m, light.share, light.mean_falloff
        )
    ]
    others = ("accepted", "reason", "sky", "contact", "contact_m", "floor_m", "figures")
    write_json(path, {name: getattr(light, name) for name in others} | {"lamps": lamps})


def read_light(path: Path) -> Light:
    """The light in a file of ``write_light``; raises UserError as ``step_files.read`` does."""
    return read(path, _LIGHT, _light)


def _light(value: dict[str, Any]) -> Light:
    made = value.pop("lamps")
    radius_m, share, mean_falloff = (
        np.array([lamp[n] for lamp in made], np.float64) for n in ("radius_m", "share", "mean_falloff")
    )
    position_m, facing = (
        np.array([lamp[n] for lamp in made], np.float64).reshape(-1, 3) for n in ("position_m", "facing")
    )
    return Light(lamps=Lamps(position_m, facing, radius_m), share=share, mean_falloff=mean_falloff, **value)
