# SPDX-License-Identifier: Apache-2.0
"""Possible positions of lamps, and the strengths that best explain the darkening of the floor near people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import scipy

from studiorecon.geometry.statistics import SIGMA_OF_MAD
from studiorecon.render.occlusion import Groups, body_proximity, hidden_shares, hidden_sky_share
from studiorecon.render.room_light import Lamps
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped

# Walls give light from this height on: below it people occlude nearly every lamp and window.
_WALL_FROM_M = 1.2
# The sky: rings of patches (elevation in degrees, number of patches), at this distance.
_SKY_RINGS = ((20.0, 12), (40.0, 10), (60.0, 6), (80.0, 3))
_SKY_M, _SKY_RADIUS = 200.0, 0.15
# Patches are merged where the width of the merged one, seen from people, is at most this part (1 / 4) of its distance,
# so that a hall has as few as a room.
_JOINED_FROM = 4.0
# Pixels whose equations are set up at a time.
_PIXELS = 256
# Lamps below this share of the light are noise; the number of alternations of strengths and total; Huber's threshold.
_MIN_SHARE, _ROUNDS, _HUBER = 0.01, 5, 2.0


def lamp_patches(room_box: RoomBox, spacing_m: float, seen_from_m: Float[np.ndarray, " 3"]) -> Lamps:
    """Patches on the ceiling and upper walls, ``spacing_m`` apart, and of the sky; wider far from ``seen_from_m``."""
    low, high = room_box.low_m, room_box.high_m

    def steps(start: float, end: float) -> np.ndarray:
        count = max(round((end - start) / spacing_m), 1)
        return start + (np.arange(count) + 0.5) * (end - start) / count

    u, v, z = steps(low[0], high[0]), steps(low[1], high[1]), steps(min(low[2] + _WALL_FROM_M, high[2] - 0.1), high[2])
    parts = [(np.stack([g.ravel() for g in np.meshgrid(u, v, [high[2]], indexing="ij")], axis=1), [0, 0, -1])]
    for axis, along in ((0, v), (1, u)):
        for place, sign in ((low[axis], 1), (high[axis], -1)):
            a, b = (g.ravel() for g in np.meshgrid(along, z, indexing="ij"))
            points = np.stack([np.full(len(a), place), a, b] if axis == 0 else [a, np.full(len(a), place), b], axis=1)
            parts.append((points, np.eye(3)[axis] * sign))
    points = np.concatenate([points for points, _ in parts])
    facing = np.concatenate([np.tile(normal, (len(points), 1)) for points, normal in parts])
    inside = Lamps(points, facing, np.full(len(points), spacing_m / np.sqrt(np.pi)))
    for width_m in (2 * spacing_m, 4 * spacing_m):
        inside = _merge_lamps(inside, width_m, room_box.axes @ np.asarray(seen_from_m, np.float64))
    sky = []
    for elevation, count in _SKY_RINGS:
        azimuth, rise = np.arange(count) * 2 * np.pi / count, np.radians(elevation)
        sky.append(
            np.stack(
                [np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.full(count, np.sin(rise))], axis=1
            )
        )
    far = np.concatenate(sky) * _SKY_M
    return Lamps(
        np.concatenate([inside.positions_m @ room_box.axes, far]),
        np.concatenate([inside.facing @ room_box.axes, np.zeros_like(far)]),
        np.concatenate([inside.radius_m, np.full(len(far), _SKY_RADIUS * _SKY_M)]),
    )


def _merge_lamps(lamps: Lamps, width_m: float, seen_from_m: np.ndarray) -> Lamps:
    """The lamps, merged to one per cell of ``width_m`` where the cell is far from ``seen_from_m``."""
    cells = np.concatenate([np.floor(lamps.positions_m / width_m), lamps.facing], axis=1)
    first, cell, count = np.unique(cells, axis=0, return_index=True, return_inverse=True, return_counts=True)[1:]
    cell = cell.reshape(-1)
    middle = np.stack([np.bincount(cell, axis) for axis in lamps.positions_m.T], axis=1) / count[:, None]
    far = np.linalg.norm(middle - seen_from_m, axis=1) > _JOINED_FROM * width_m
    own = lamps.take(~far[cell])
    return Lamps(
        np.concatenate([own.positions_m, middle[far]]),
        np.concatenate([own.facing, lamps.facing[first][far]]),
        np.concatenate([own.radius_m, np.sqrt(np.bincount(cell, lamps.radius_m**2))[far]]),
    )


def light_losses(
    points: Groups, bodies: Sequence[Float[np.ndarray, "C 7"]], lamps: Lamps, contact_m: float
) -> Float[np.ndarray, "N M"]:
    """Float32 hidden share of the sky, closeness of a body, and the hidden share of every lamp."""
    beside = np.stack([hidden_sky_share(points, bodies), body_proximity(points, bodies, contact_m)], axis=1)
    return np.concatenate([beside, hidden_shares(points, lamps.discs, bodies)], axis=1)


def fit_strengths(
    lost: Float[np.ndarray, "P T M"], relative: Float[np.ndarray, "P K"], ratio: Float[np.ndarray, "P T"]
) -> Float[np.ndarray, " M"]:
    """Non-negative strengths of sky, contact and lamps, from the changes of P pixels over T pictures.

    ``lost`` is from ``light_losses``, ``relative`` every lamp's fall-off over its mean, ``ratio`` that of picture to
    plate, NaN where unknown. A plate may contain a permanent shadow, so every pixel has a fitted level, and only its
    changes count. The unshaded light depends on the strengths too, so the two are updated in alternation. Large
    residuals count by their root (Huber), since reflections and carried objects are no shadows.
    """
    known = np.isfinite(ratio)
    seen, weight = np.where(known, ratio, 0.0), known.astype(np.float64)
    found, total, own = np.zeros(lost.shape[-1]), np.ones(len(ratio)), np.ones(len(ratio))
    for _ in range(_ROUNDS):
        darker, triangle = 1 - seen / own[:, None], np.zeros((0, len(found) + 1))
        for part in _parts(len(ratio)):
            triangle = _with_rows(
                triangle, _columns(lost, relative, part) / total[part, None, None], darker, weight, part
            )
        found = scipy.optimize.nnls(triangle[:, :-1], triangle[:, -1], maxiter=50 * len(found))[0]
        found[2:][found[2:] < _MIN_SHARE] = 0
        on = np.flatnonzero(found)
        left = np.empty_like(seen)
        for part in _parts(len(ratio)):
            left[part] = 1 - _columns(lost, relative, part)[..., on] @ found[on] / total[part, None]
        own = unshaded_levels(seen, left, weight)
        residual = np.abs(seen - own[:, None] * left)
        usual = max(SIGMA_OF_MAD * float(np.median(residual[known])), 1e-4)
        weight = known * np.minimum(1, _HUBER * usual / np.maximum(residual, 1e-9))
        total = np.maximum(1 + (relative - 1) @ found[2:], 0.25)
    return found


def _parts(pixels: int) -> list[slice]:
    """Slices of the pixels, small enough that memory does not grow with their number."""
    return [slice(first, first + _PIXELS) for first in range(0, pixels, _PIXELS)]


def _columns(lost: np.ndarray, relative: np.ndarray, part: slice) -> np.ndarray:
    """(p, T, 2 + K) float64 losses of a part's pixels at unit strengths."""
    columns = lost[part].astype(np.float64)
    columns[..., 2:] *= relative[part, None]
    return columns


def _with_rows(
    triangle: np.ndarray, scaled: np.ndarray, darker: np.ndarray, weight: np.ndarray, part: slice
) -> np.ndarray:
    """The triangle of the least-squares problem with the known equations of a part's pixels added.

    The update is orthogonal, so that precision remains where neighbouring patches hide nearly the same pixels.
    """
    own = weight[part]
    share = own / np.maximum(own.sum(axis=1, keepdims=True), 1e-9)
    changes = scaled - np.einsum("pt,ptk->pk", share, scaled)[:, None]
    target = darker[part] - (share * darker[part]).sum(axis=1)[:, None]
    rows = np.concatenate([changes, target[..., None]], axis=-1)[own > 0] * np.sqrt(own[own > 0])[:, None]
    # numpy's stubs include results of other modes
    return cast(np.ndarray, np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))


def unshaded_levels(
    seen: Float[np.ndarray, "P T"], left: Float[np.ndarray, "P T"], weight: Shaped[np.ndarray, "P T"]
) -> Float[np.ndarray, " P"]:
    """Ratio of pixels to their plate when unshaded, from ``left`` of their light; 1 where unknown."""
    light = (weight * left).sum(axis=1)
    return np.where(light > 1e-9, (weight * seen).sum(axis=1) / np.maximum(light, 1e-9), 1.0)
