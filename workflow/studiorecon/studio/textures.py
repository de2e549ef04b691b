# SPDX-License-Identifier: Apache-2.0
"""Procedural textures: linear albedo (N, 3) at surface coordinates u, v (N,) in metres, from hashed lattice noise.

All are pure functions of position and an integer seed, so that every camera sees the same paint on the same wall.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

Colour = tuple[float, float, float]


def hash_values(column: Num[np.ndarray, " N"], row: Num[np.ndarray, " N"], seed: int) -> Float[np.ndarray, " N"]:
    """Values in [0, 1) that depend on two integers and the seed only (an integer hash with two mixing rounds)."""
    x = column.astype(np.int64) * 374761393 + row.astype(np.int64) * 668265263 + seed * 1442695041
    x &= 0xFFFFFFFF
    x = ((x ^ (x >> 13)) * 1274126177) & 0xFFFFFFFF
    return ((x ^ (x >> 16)) & 0xFFFF) / 65536.0


def noise(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, " N"]:
    """Smooth value noise in [0, 1) on the unit lattice."""
    i, j = np.floor(u), np.floor(v)
    a, b = u - i, v - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    low = hash_values(i, j, seed) * (1 - a) + hash_values(i + 1, j, seed) * a
    high = hash_values(i, j + 1, seed) * (1 - a) + hash_values(i + 1, j + 1, seed) * a
    return low * (1 - b) + high * b


def clouds(
    u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int, octaves: int = 3
) -> Float[np.ndarray, " N"]:
    """Sum of octaves of noise, in [0, 1)."""
    total = sum(noise(u * 2.0**k, v * 2.0**k, seed + k) * 0.5**k for k in range(octaves))
    return np.asarray(total / sum(0.5**k for k in range(octaves)))


def mix(
    a: Colour | Float[np.ndarray, "N 3"], b: Colour | Float[np.ndarray, "N 3"], share_of_b: Num[np.ndarray, " N"]
) -> Float[np.ndarray, "N 3"]:
    """Colours between ``a`` and ``b``."""
    return np.asarray(a) * (1 - share_of_b[:, None]) + np.asarray(b) * share_of_b[:, None]


def near_line(x: Float[np.ndarray, " N"], period: float, half_width: float) -> Bool[np.ndarray, " N"]:
    """Closer than ``half_width`` to a multiple of ``period``."""
    return np.abs(x - np.round(x / period) * period) < half_width


def planks(
    u: Float[np.ndarray, " N"],
    v: Float[np.ndarray, " N"],
    seed: int,
    dark: Colour = (0.20, 0.105, 0.05),
    light: Colour = (0.44, 0.27, 0.14),
) -> Float[np.ndarray, "N 3"]:
    """Oak boards 14 cm wide and 1.4 m long, with grain and gaps."""
    width, length = 0.14, 1.4
    row = np.floor(v / width)
    shifted = u + hash_values(row, row * 0, seed) * length
    board = np.floor(shifted / length)
    colour = mix(dark, light, 0.15 + 0.85 * hash_values(row, board, seed + 1))
    grain = (
        noise(u * 2.5 + 9 * hash_values(row, board, seed + 3), v * 38, seed + 2) * 0.6
        + noise(u * 14, v * 90, seed + 4) * 0.4
    )
    colour = colour * (0.74 + 0.52 * grain)[:, None]
    gap = near_line(v, width, 0.0028) | near_line(shifted, length, 0.0035)
    return np.where(gap[:, None], colour * 0.3, colour)


def bricks(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """A running bond of red bricks with light joints."""
    height, length = 0.09, 0.26
    row = np.floor(v / height)
    shifted = u + 0.5 * length * (row % 2)
    column = np.floor(shifted / length)
    colour = mix((0.27, 0.075, 0.045), (0.52, 0.22, 0.13), hash_values(row, column, seed))
    colour = mix(colour, (0.16, 0.08, 0.07), (hash_values(row, column, seed + 9) > 0.86) * 0.6)
    colour = colour * (0.72 + 0.55 * clouds(u * 16, v * 16, seed + 3))[:, None]
    joint = near_line(v, height, 0.0075) | near_line(shifted, length, 0.0075)
    return np.where(
        joint[:, None], np.asarray((0.46, 0.42, 0.37)) * (0.85 + 0.3 * noise(u * 60, v * 60, seed + 5))[:, None], colour
    )


def tiles(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """Glazed 20 cm tiles, blue-green and cream, some with an ornament."""
    side = 0.2
    column, row = np.floor(u / side), np.floor(v / side)
    kind = hash_values(column, row, seed)
    colour = mix((0.055, 0.19, 0.23), (0.62, 0.63, 0.55), (kind > 0.42) * 0.85 + 0.15 * kind)
    distance = np.hypot(u - (column + 0.5) * side, v - (row + 0.5) * side)
    ornament = (distance < 0.06) & (distance > 0.03) & (hash_values(column, row, seed + 5) > 0.5)
    colour = np.where(ornament[:, None], np.asarray((0.60, 0.28, 0.07)), colour)
    joint = near_line(u, side, 0.004) | near_line(v, side, 0.004)
    return np.where(joint[:, None], 0.30, colour) * (0.88 + 0.24 * noise(u * 9, v * 9, seed + 7))[:, None]


def plaster(
    u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int, tint: Colour = (0.60, 0.54, 0.43)
) -> Float[np.ndarray, "N 3"]:
    """Roughly painted plaster: low contrast, broad and fine mottling."""
    broad, fine = clouds(u * 1.3, v * 1.3, seed), clouds(u * 22, v * 22, seed + 4, 2)
    return np.asarray(tint) * (0.84 + 0.2 * broad + 0.14 * fine)[:, None]


def wallpaper(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """Two-tone stripes with a row of printed leaves in every other one."""
    stripe = np.floor(u / 0.16)
    colour = mix((0.17, 0.27, 0.25), (0.47, 0.50, 0.40), (stripe % 2) * 0.9 + 0.1 * clouds(u * 12, v * 12, seed))
    x, y = (u / 0.16 - stripe - 0.5) * 2, (v / 0.22 + 0.5 * (stripe % 4 > 1)) % 1.0 * 2 - 1
    leaf = (np.abs(x) < 0.55 * (1 - y * y) * (0.6 + 0.4 * np.sin(3 * y))) & (stripe % 2 == 1)
    vein = leaf & (np.abs(x) < 0.06)
    colour = np.where(leaf[:, None], np.asarray((0.16, 0.30, 0.20)), colour)
    return np.where(vein[:, None], np.asarray((0.55, 0.50, 0.28)), colour)


def picture(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """An abstract painting: flat shapes of a few strong colours with brushwork, different for every seed."""
    warp = 0.12 * clouds(u * 4, v * 4, seed + 20, 2)
    level = np.floor(clouds(u * 3.1 + warp, v * 3.1 - warp, seed, 2) * 7)
    colour = np.stack([hash_values(level, level * 0 + k, seed + 31) for k in range(3)], axis=1) ** 1.4
    colour = 0.55 * colour + 0.45 * colour.mean(axis=1, keepdims=True)
    colour = colour * np.asarray((0.72, 0.62, 0.50)) + 0.035
    disc = np.hypot(u * 1.0 - np.floor(u) - 0.5, v - np.floor(v) - 0.45) < 0.18 + 0.08 * (seed % 3)
    accent = np.asarray([0.75, 0.35, 0.10]) * (0.4 + 0.6 * hash_values(np.array([seed]), np.array([1]), 77)[0])
    colour = np.where((disc & (level % 2 == 0))[:, None], accent, colour)
    return colour * (0.82 + 0.36 * noise(u * 18, v * 70, seed + 8))[:, None]


def fabric(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """Woven upholstery: a checked weave over a mottled base of one seeded hue."""
    base = np.asarray([hash_values(np.array([k]), np.array([seed]), 5)[0] for k in range(3)]) ** 1.5
    base = (0.5 * base + 0.5 * base.mean()) * 0.40 + 0.05
    check = ((np.floor(u / 0.07) + np.floor(v / 0.07)) % 2) * 0.35 + near_line(u + v, 0.14, 0.012) * 0.5
    thread = noise(u * 120, v * 20, seed + 1) * 0.5 + noise(u * 20, v * 120, seed + 2) * 0.5
    return base * (0.55 + 0.5 * check + 0.55 * clouds(u * 7, v * 7, seed + 3) + 0.25 * thread)[:, None]


def books(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """Shelves 33 cm apart with book backs of uneven height, gaps and title labels."""
    shelf = np.floor(v / 0.33)
    height = v - shelf * 0.33
    shifted = u + hash_values(shelf, shelf * 0, seed) * 3
    column = np.floor(shifted / 0.045)
    colour = np.stack([hash_values(column, shelf, seed + k) for k in range(3)], axis=1) ** 1.8
    colour = (0.6 * colour + 0.4 * colour.mean(axis=1, keepdims=True)) * np.asarray((0.7, 0.55, 0.45)) + 0.03
    label = (np.abs(height - 0.17) < 0.02) & (hash_values(column, shelf, seed + 8) > 0.4)
    colour = np.where(label[:, None], np.asarray((0.62, 0.52, 0.30)), colour)
    colour = np.where((near_line(shifted, 0.045, 0.002))[:, None], colour * 0.3, colour)
    top = 0.2 + 0.09 * hash_values(column, shelf, seed + 6)
    colour = np.where(
        ((height > top) | (hash_values(column, shelf, seed + 7) > 0.93))[:, None],
        np.asarray((0.035, 0.022, 0.013)),
        colour,
    )
    board = (height < 0.022) | (height > 0.325)
    return np.where(board[:, None], planks(u, v, seed + 9) * 0.8, colour)


def rug(u: Float[np.ndarray, " N"], v: Float[np.ndarray, " N"], seed: int) -> Float[np.ndarray, "N 3"]:
    """A medallion rug in coordinates from its middle, ±1 at the edges: borders, diamonds, knotted texture."""
    edge = np.maximum(np.abs(u), np.abs(v))
    diamond = np.abs(((np.abs(u) + np.abs(v)) * 4) % 1 - 0.5) * 2
    colour = mix((0.23, 0.045, 0.035), (0.06, 0.07, 0.13), (diamond > 0.5).astype(float))
    cell = (np.floor(u * 9) + np.floor(v * 9)) % 2 == 0
    colour = np.where((cell & (diamond > 0.75))[:, None], np.asarray((0.55, 0.40, 0.18)), colour)
    colour = np.where(((edge > 0.8) & (edge < 0.92))[:, None], np.asarray((0.50, 0.37, 0.19)), colour)
    zigzag = (edge > 0.82) & (edge < 0.90) & (((u + v) * 12) % 1 < 0.5)
    colour = np.where(zigzag[:, None], np.asarray((0.20, 0.03, 0.03)), colour)
    return colour * (0.7 + 0.6 * noise(u * 110, v * 110, seed))[:, None]
