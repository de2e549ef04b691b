# SPDX-License-Identifier: Apache-2.0
"""Clothes, hair and skin, painted in the coordinates of the rest pose, so that the paint sticks to the moving body.

Seams are drawn where a tailor would put them on the bundled body's T-pose (x to the left, y up, z forward, pelvis at
0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.studio.meshes import Texture
from studiorecon.studio.textures import Colour

_SHOE_TOP_M, _SOLE_TOP_M = -0.862, -0.932
_HEM_M = -0.015


@dataclass(frozen=True)
class Outfit:
    """One person's clothes; colours are linear albedo.

    Attributes:
        shirt, shirt_pattern: two colours of the shirt; ``cut`` is their pattern (stripes, checks, dots, block).
        sleeve_m: how far along the arms it reaches, from the middle of the chest.
        trousers: colour; ``leg_m``: height of their lower end over the pelvis (negative).
    """

    shirt: Colour
    shirt_pattern: Colour
    cut: str
    sleeve_m: float
    trousers: Colour
    leg_m: float
    shoes: Colour
    hair: Colour
    skin: Colour


OUTFITS = (
    Outfit((0.62, 0.10, 0.045), (0.80, 0.66, 0.45), "stripes", 0.66, (0.035, 0.065, 0.16), -0.86,
           shoes=(0.72, 0.70, 0.66), hair=(0.075, 0.035, 0.015), skin=(0.56, 0.32, 0.22)),
    Outfit((0.05, 0.30, 0.20), (0.60, 0.62, 0.40), "checks", 0.37, (0.40, 0.31, 0.19), -0.86,
           shoes=(0.10, 0.045, 0.02), hair=(0.012, 0.010, 0.009), skin=(0.30, 0.15, 0.085)),
    Outfit((0.20, 0.09, 0.36), (0.66, 0.50, 0.70), "dots", 0.33, (0.18, 0.19, 0.20), -0.86,
           shoes=(0.45, 0.06, 0.05), hair=(0.32, 0.19, 0.07), skin=(0.62, 0.38, 0.28)),
    Outfit((0.68, 0.48, 0.06), (0.06, 0.16, 0.34), "block", 0.36, (0.03, 0.03, 0.035), -0.40,
           shoes=(0.05, 0.10, 0.30), hair=(0.03, 0.018, 0.010), skin=(0.44, 0.24, 0.15)),
)  # fmt: skip


def body_texture(outfit: Outfit, body: BodyModel) -> Texture:
    """The texture of a dressed body over template coordinates (N, 3): skin, hair, eyes, shirt, trousers, shoes."""
    eyes = [e for e in _eyes(body) if e is not None]

    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        out = np.abs(x)
        colour = (
            np.broadcast_to(np.asarray(outfit.skin), points.shape)
            * (0.96 + 0.08 * np.sin(37 * x + 23 * y + 31 * z))[:, None]
        )
        _head(colour, x, y, z, outfit, eyes)
        neckline = (x**2 + (y - 0.555) ** 2 + (z - 0.03) ** 2 < 0.098**2) | (y > 0.59)
        shirt = (y > _HEM_M) & (out < outfit.sleeve_m) & ~neckline
        colour[shirt] = _shirt(outfit, x[shirt], y[shirt], z[shirt])
        cuff = shirt & ((out > outfit.sleeve_m - 0.022) | (y < _HEM_M + 0.02))
        colour[cuff] = colour[cuff] * 0.45
        legs = (y <= _HEM_M) & (y > outfit.leg_m) & (out < 0.4)
        colour[legs] = np.asarray(outfit.trousers) * _weave(x[legs], y[legs], z[legs])
        seam = legs & (np.abs(z + 0.01) < 0.006) & (out > 0.13)
        colour[seam] = colour[seam] * 1.7
        shoes = (y < _SHOE_TOP_M) & (out < 0.4)
        colour[shoes] = np.asarray(outfit.shoes)
        laces = shoes & (z > 0.015) & (np.abs(out - 0.155) < 0.03) & (((z * 40) % 1) < 0.4) & (y > -0.90)
        colour[laces] = 0.75 - 0.6 * np.asarray(outfit.shoes)
        colour[shoes & (y < _SOLE_TOP_M)] = (0.55, 0.53, 0.48) if outfit.shoes[0] < 0.5 else (0.10, 0.09, 0.08)
        return colour

    return paint


def _head(
    colour: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    outfit: Outfit,
    eyes: list[tuple[np.ndarray, float]],
) -> None:
    lips = (np.abs(x) < 0.024) & (np.abs(y - 0.647) < 0.008) & (z > 0.125)
    colour[lips] = np.asarray(outfit.skin) * (0.85, 0.45, 0.45)
    wave = 0.006 * np.sin(70 * x) + 0.004 * np.sin(151 * x + 40 * z)
    hair = (y > 0.62) & (y - 0.682 + wave > 0.75 * z)
    strands = 0.75 + 0.5 * np.sin(230 * x + 20 * np.sin(40 * y)) ** 2
    colour[hair] = np.asarray(outfit.hair) * strands[hair][:, None]
    for centre, radius in eyes:
        distance = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2)
        near = (distance < radius) & (z > centre[2] - 0.005) & ~hair
        colour[near] = (0.62, 0.60, 0.57)
        colour[near & (distance < 0.45 * radius)] = (0.03, 0.02, 0.015)
        brow = (np.abs(x - centre[0]) < 0.020) & (np.abs(y - centre[1] - 0.019) < 0.004) & (z > 0.10) & ~hair
        colour[brow] = np.asarray(outfit.hair)


def _shirt(outfit: Outfit, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    # Round the arms the pattern runs along x, round the trunk along y: a sleeve is cut from the same cloth.
    along = np.where(np.abs(x) > 0.21, np.abs(x) + 0.3, y)
    across = np.where(np.abs(x) > 0.21, z, np.arctan2(x, z + 0.02) * 0.15)
    if outfit.cut == "stripes":
        second = (along / 0.075) % 1 < 0.36
    elif outfit.cut == "checks":
        second = ((along / 0.07) % 1 < 0.30) | ((across / 0.06) % 1 < 0.28)
    elif outfit.cut == "dots":
        row = np.floor(along / 0.055)
        u = (across / 0.055 + 0.5 * (row % 2)) % 1 - 0.5
        second = u**2 + ((along / 0.055) % 1 - 0.5) ** 2 < 0.07
    else:
        second = (np.abs(x) > 0.21) | ((y > 0.22) & (y < 0.34))
    colour = np.where(second[:, None], np.asarray(outfit.shirt_pattern), np.asarray(outfit.shirt))
    return colour * _weave(x, y, z)


def _weave(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(N, 1) folds and mottling of cloth around 1: sums of incommensurate waves, cheap enough for every frame."""
    folds = (
        np.sin(9 * y + 14 * x + 6 * np.sin(8 * z + 5 * x))
        + np.sin(31 * y - 17 * z + 4 * np.sin(21 * x))
        + 0.8 * np.sin(67 * x + 59 * y + 71 * z)
    )
    return (1 + 0.085 * folds)[:, None]


def _eyes(body: BodyModel) -> list[tuple[np.ndarray, float] | None]:
    """Centre and radius of the right and left eyeball in the template; None where the body marks no eyes."""
    if "eyes" not in body.region_names:
        return [None, None]
    vertices = body.template_m[body.region == body.region_names.index("eyes")]
    found: list[tuple[np.ndarray, float] | None] = []
    for side in (vertices[:, 0] < 0, vertices[:, 0] >= 0):
        centre = vertices[side].mean(axis=0) if side.any() else None
        found.append(None if centre is None else (centre, 0.013))
    return found
