# SPDX-License-Identifier: Apache-2.0
"""The static room: 8.4 × 7.2 × 3 m, painted walls, furniture, a table, a pillar and two lamps; floor z = 0."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from studiorecon.studio import textures
from studiorecon.studio.meshes import Mesh, Texture, box, box_texture, lathe, plain_texture, pose_on_floor, quad

HALF_X_M, HALF_Y_M, HEIGHT_M = 4.2, 3.6, 3.0
# Centre and half-size of the two luminous panels in the ceiling; tracing.py samples the same rectangles.
LAMPS_M = ((-1.3, -0.5, 0.42, 0.22), (1.7, 0.9, 0.42, 0.22))
# Unequal, so that every shadow has one clear direction.
LAMP_SHARES = (1.3, 0.7)
LAMP_BELOW_CEILING_M = 0.06
LAMP_RADIANCE = 2.5


def build_room(seed: int, glossy_floor: float) -> list[Mesh]:
    """All solids of the room; furniture is shifted a little and every texture drawn from the seed."""
    return _shell(seed, glossy_floor) + _furniture(seed, np.random.default_rng(seed))


def _shell(seed: int, glossy_floor: float) -> list[Mesh]:
    x, y, z = HALF_X_M, HALF_Y_M, HEIGHT_M
    floor = quad("floor", [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], _floor(seed + 1))
    solids = [
        Mesh(floor.name, floor.vertices_m, floor.faces, floor.texture, floor.world_from_solid, mirror=glossy_floor),
        quad("ceiling", [[-x, -y, z], [-x, y, z], [x, y, z], [x, -y, z]], _ceiling(seed + 2)),
        quad(
            "brick wall",
            [[-x, -y, 0], [-x, y, 0], [-x, y, z], [-x, -y, z]],
            _wall(textures.bricks, seed + 3, 1, pictures=0),
        ),
        quad(
            "plaster wall",
            [[x, -y, 0], [x, y, 0], [x, y, z], [x, -y, z]],
            _wall(textures.plaster, seed + 4, 1, pictures=3),
        ),
        quad(
            "papered wall",
            [[-x, -y, 0], [x, -y, 0], [x, -y, z], [-x, -y, z]],
            _wall(textures.wallpaper, seed + 5, 0, pictures=3),
        ),
        quad("tiled wall", [[-x, y, 0], [x, y, 0], [x, y, z], [-x, y, z]], _wall(_half_tiles, seed + 6, 0, pictures=4)),
    ]
    for k, (cx, cy, hx, hy) in enumerate(LAMPS_M):
        where = pose_on_floor((cx, cy, HEIGHT_M - LAMP_BELOW_CEILING_M))
        lamp = box(f"lamp {k}", (2 * hx, 2 * hy, LAMP_BELOW_CEILING_M - 0.001), where, plain_texture((0.9, 0.9, 0.88)))
        solids.append(
            Mesh(lamp.name, lamp.vertices_m, lamp.faces, lamp.texture, lamp.world_from_solid, emission=LAMP_RADIANCE)
        )
    return solids


# Radius and height in metres, from bottom to top.
_VASE = [(0.0, 0.0), (0.07, 0.0), (0.11, 0.10), (0.09, 0.20), (0.045, 0.27)]
_VASE += [(0.06, 0.32), (0.045, 0.32), (0.03, 0.25), (0.0, 0.25)]
_BOWL = [(0.0, 0.0), (0.08, 0.0), (0.19, 0.10), (0.17, 0.10), (0.07, 0.03), (0.0, 0.03)]
_STOOL = [(0.0, 0.0), (0.19, 0.0), (0.15, 0.05), (0.06, 0.10), (0.06, 0.36), (0.20, 0.42), (0.20, 0.47), (0.0, 0.47)]
_PLANT = [(0.04, 0.0), (0.30, 0.25), (0.34, 0.60), (0.22, 0.95), (0.0, 1.15)]
_PILLAR = [(0.27, 0.0), (0.27, 0.15), (0.20, 0.20), (0.20, 2.82), (0.27, 2.88), (0.27, HEIGHT_M)]


def _furniture(seed: int, rng: np.random.Generator) -> list[Mesh]:
    def shift(most_m: float = 0.12) -> float:
        return float(rng.uniform(-most_m, most_m))

    def block(name: str, size_m: tuple, at_m: tuple, texture: Texture, turn_rad: float = 0.0) -> Mesh:
        return box(name, size_m, pose_on_floor(at_m, turn_rad), texture)

    def turned(name: str, profile: list, at_m: tuple, texture: Texture, segments: int = 48) -> Mesh:
        return lathe(name, profile, pose_on_floor(at_m), texture, segments)

    def textured(pattern: Callable[..., np.ndarray], number: int) -> Texture:
        return box_texture(pattern, seed + number)

    dark = textured(lambda u, v, s: textures.planks(v, u, s, (0.10, 0.045, 0.02), (0.20, 0.10, 0.05)), 21)
    light, cloth = textured(textures.planks, 20), [textured(textures.fabric, 40 + k) for k in range(4)]
    glaze, brass = (
        _ring_texture((0.05, 0.16, 0.30), (0.55, 0.45, 0.30)),
        _ring_texture((0.45, 0.13, 0.04), (0.60, 0.40, 0.12)),
    )
    red = _ring_texture((0.35, 0.06, 0.05), (0.45, 0.30, 0.14))
    # One after the other as they are drawn; x and y of the table, y of the sofa, x of the shelves, y of the sideboard.
    tx, ty, sofa, shelf, low = -1.95 + shift(), 1.15 + shift(), 0.3 + shift(), 1.9 + shift(), 1.2 + shift()
    side = -0.7 + shift()
    return [
        block("table top", (1.5, 0.85, 0.05), (tx, ty, 0.70), light),
        *(
            block("table leg", (0.07, 0.07, 0.70), (tx + a, ty + b, 0), light)
            for a in (-0.67, 0.67)
            for b in (-0.35, 0.35)
        ),
        turned("vase", _VASE, (tx - 0.42, ty + 0.1, 0.75), glaze),
        block("book pile", (0.30, 0.22, 0.16), (tx + 0.25, ty - 0.05, 0.75), textured(textures.fabric, 47), 0.5),
        block("sofa seat", (0.80, 2.0, 0.42), (-3.72, sofa - 1.0, 0), cloth[0]),
        block("sofa back", (0.28, 2.0, 0.44), (-4.02, sofa - 1.0, 0.42), cloth[0]),
        *(block("sofa arm", (0.80, 0.20, 0.60), (-3.72, sofa - 1.0 + b, 0), cloth[0]) for b in (-1.1, 1.1)),
        block("cushion", (0.16, 0.45, 0.40), (-3.78, sofa - 0.5, 0.42), cloth[1], 0.3),
        block("bookshelf", (1.7, 0.34, 1.98), (shelf, -3.42, 0), textured(textures.books, 25)),
        *(block("bookshelf side", (0.04, 0.38, 2.02), (shelf + a, -3.40, 0), dark) for a in (-0.87, 0.87)),
        block("low shelf", (1.5, 0.36, 0.66), (low, 3.41, 0), textured(textures.books, 29)),
        block("sideboard", (0.48, 1.7, 0.74), (3.95, side, 0.10), dark),
        *(block("foot", (0.06, 0.06, 0.1), (3.95 + a, side + b, 0), dark) for a in (-0.18, 0.18) for b in (-0.8, 0.8)),
        turned("bowl", _BOWL, (3.92, side + 0.3, 0.84), brass),
        block("crate", (0.55, 0.55, 0.48), (2.55 + shift(), -1.05 + shift(), 0), textured(textures.planks, 26), 0.6),
        block("parcel", (0.34, 0.26, 0.22), (2.55, -1.05, 0.48), textured(textures.picture, 27), 0.2),
        turned("stool", _STOOL, (-0.2 + shift(), -2.75 + shift(), 0), red),
        block("pouf", (0.55, 0.55, 0.40), (-1.75 + shift(), -2.65 + shift(), 0), cloth[2], 0.25),
        block("plant box", (0.40, 0.40, 0.45), (3.7, 3.2, 0), textured(textures.tiles, 33)),
        turned("plant", _PLANT, (3.7, 3.2, 0.45), _leaves(seed + 34)),
        turned("pillar", _PILLAR, (-3.25 + shift(0.05), -2.55 + shift(0.05), 0), _pillar(seed + 31), 64),
    ]


def _floor(seed: int) -> Texture:
    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        colour = textures.planks(points[:, 0], points[:, 1], seed)
        u, v = (points[:, 0] - 0.15) / 1.45, (points[:, 1] + 0.1) / 1.05
        on_rug = (np.abs(u) < 1) & (np.abs(v) < 1)
        colour[on_rug] = textures.rug(u[on_rug], v[on_rug], seed)
        return colour

    return paint


def _ceiling(seed: int) -> Texture:
    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        colour = textures.plaster(points[:, 0], points[:, 1], seed, (0.66, 0.65, 0.61))
        beam = textures.near_line(points[:, 0], 1.4, 0.07)
        wood = textures.planks(points[beam, 1], points[beam, 0], seed + 5, (0.09, 0.045, 0.02), (0.2, 0.11, 0.055))
        colour[beam] = wood
        return colour

    return paint


def _half_tiles(u: np.ndarray, v: np.ndarray, seed: int) -> np.ndarray:
    colour = np.where(
        (v < 1.2)[:, None], textures.tiles(u, v, seed), textures.plaster(u, v, seed + 1, (0.50, 0.36, 0.26))
    )
    return np.where((np.abs(v - 1.2) < 0.025)[:, None], np.asarray((0.16, 0.08, 0.04)), colour)


def _wall(texture, seed: int, along: int, pictures: int) -> Texture:
    """A papered wall with framed pictures of seeded size, a skirting board and a ledge under the ceiling."""
    rng = np.random.default_rng(seed)
    length = (HALF_X_M, HALF_Y_M)[along] * 2
    frames = []
    for k in range(pictures):
        middle = (k + 0.5) / pictures * length - length / 2 + rng.uniform(-0.2, 0.2)
        frames.append(
            (middle, rng.uniform(1.55, 1.85), rng.uniform(0.25, 0.52), rng.uniform(0.22, 0.42), int(rng.integers(1000)))
        )

    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        u, v = points[:, along], points[:, 2]
        colour = texture(u + 20, v, seed)
        for middle, height, half_w, half_h, number in frames:
            x, y = np.abs(u - middle), np.abs(v - height)
            frame, mount = (x < half_w) & (y < half_h), (x < half_w - 0.035) & (y < half_h - 0.035)
            canvas = (x < half_w - 0.085) & (y < half_h - 0.085)
            colour[frame] = (0.035, 0.025, 0.02) if number % 2 else (0.36, 0.24, 0.09)
            colour[mount] = (0.68, 0.66, 0.60)
            colour[canvas] = textures.picture((u - middle)[canvas] + number, (v - height)[canvas] + 0.3, number)
        skirting = v < 0.11
        colour[skirting] = (
            np.asarray((0.50, 0.47, 0.42)) * np.where(np.abs(v[skirting] - 0.085) < 0.006, 0.5, 1.0)[:, None]
        )
        colour[v > HEIGHT_M - 0.07] = (0.55, 0.53, 0.48)
        return colour

    return paint


def _ring_texture(dark: tuple[float, float, float], light: tuple[float, float, float]) -> Texture:
    """Turned ware: painted rings around the axis."""

    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        ring = 0.5 + 0.5 * np.sin(points[:, 2] * 85 + 0.6 * np.sin(6 * np.arctan2(points[:, 1], points[:, 0])))
        return textures.mix(dark, light, (ring > 0.72) * 0.85 + 0.1 * ring)

    return paint


def _pillar(seed: int) -> Texture:
    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        around, height = np.arctan2(points[:, 1], points[:, 0]) * 0.2 + 9, points[:, 2]
        spiral = ((height * 1.4 + around * 2.5) % 1) < 0.5
        colour = textures.plaster(around, height, seed, (0.58, 0.50, 0.36))
        band = spiral & (height > 0.9) & (height < 2.2)
        colour[band] = textures.plaster(around, height, seed + 1, (0.30, 0.10, 0.06))[band]
        return colour

    return paint


def _leaves(seed: int) -> Texture:
    def paint(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        around = np.arctan2(points[:, 1], points[:, 0])
        leaf = textures.clouds(around * 5, points[:, 2] * 9 + 0.8 * np.abs(np.sin(around * 6)), seed)
        return textures.mix((0.01, 0.035, 0.01), (0.13, 0.30, 0.07), np.clip(leaf * 1.8 - 0.4, 0, 1))

    return paint
