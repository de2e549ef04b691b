# SPDX-License-Identifier: Apache-2.0
"""The share of a lamp that bodies of capsules hide from points, and the closeness of bodies: soft, in closed form.

Points are processed in groups of sixteen neighbours, and sixteen groups make a heap. Most capsules cannot be between
most groups and most lamps; one test of all groups of a heap detects that. Only the remaining groups are computed,
sixteen points at a time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import float32, int64, njit, prange

from studiorecon.arrays import require
from studiorecon.splatting.conventions import INLINE, KERNEL, LANES
from studiorecon.splatting.cpu.blocks import morton_order
from studiorecon.splatting.cpu.simd import (
    above,
    at_least,
    bits_from_mask,
    both,
    broadcast,
    least,
    most,
    root,
    select,
    zeros,
)
from studiorecon.splatting.cpu.simd_rows import load, lowest_bit, store

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Directions that represent diffuse light from above, distributed by the cosine; the angular width of each.
_SKY, _SKY_TAN = 24, 0.32
_FAR_M = 50.0
# A bell curve counts as 0 beyond this multiple of its reach.
_REACHES = 4.0
# Edges of closer occluders are sharp, metres.
_SHARP = float32(1e-4)


@dataclass(frozen=True)
class Groups:
    """N points in G groups of sixteen neighbours.

    Attributes:
        order: index of the point at each position.
        count: G, whole heaps of sixteen groups.
        places: (G · 3 · 16,) float32 x, y and z of every group's points, metres; surplus places repeat a point.
        spheres: (G / 16 · 4 · 16,) float32 x, y, z and radius of the spheres around every heap's groups.
    """

    order: Integer[np.ndarray, " N"]
    count: int
    places: Float[np.ndarray, " P"]
    spheres: Float[np.ndarray, " S"]

    @classmethod
    def of(cls, points_m: Num[np.ndarray, "N 3"]) -> Groups:
        """Groups of points; raises ValueError for another shape."""
        require("points_m", points_m, ("N", 3))
        order = morton_order(np.asarray(points_m))
        count = -(-len(order) // LANES**2) * LANES
        padded = np.concatenate([order, np.full(count * LANES - len(order), order[-1] if len(order) else 0)])
        grouped = np.asarray(points_m, np.float64)[padded].reshape(count, LANES, 3)
        middle = (grouped.min(axis=1) + grouped.max(axis=1)) / 2
        radius = np.linalg.norm(grouped - middle[:, None], axis=2).max(axis=1)
        spheres = np.concatenate([middle, radius[:, None]], axis=1).reshape(-1, LANES, 4)
        lanes = (np.ascontiguousarray(rows.transpose(0, 2, 1), np.float32).reshape(-1) for rows in (grouped, spheres))
        return cls(order, count, *lanes)

    def grouped(self, values: Num[np.ndarray, "N K"]) -> Float[np.ndarray, " V"]:
        """(G · 16 · …,) float32, flat: values of the points in the kernels' layout, (G, K, 16); padding is 0."""
        out = np.zeros((len(self.spheres) * LANES, values.shape[1]), np.float32)
        out[: len(self.order)] = values[self.order]
        return np.ascontiguousarray(out.reshape(len(self.spheres), LANES, values.shape[1]).transpose(0, 2, 1)).reshape(
            -1
        )

    def of_points(self, values: Float[np.ndarray, "P ..."]) -> Float[np.ndarray, "N ..."]:
        """(N, …) in the points' own order from (G · 16, …) in the groups'."""
        out = np.empty((len(self.order), *values.shape[1:]), values.dtype)
        out[self.order] = values[: len(self.order)]
        return out


def pack_capsules(
    bodies: Sequence[Float[np.ndarray, "C 7"]],
) -> tuple[Float[np.ndarray, "C 7"], Float[np.ndarray, "B 7"], Integer[np.ndarray, " B+1"]]:
    """Capsules of all bodies, a ball (capsule of length 0) around each body, and start index of each one's capsules.

    Raises ValueError for other shapes.
    """
    there = [np.asarray(body, np.float64) for body in bodies if len(body)]
    for body in there:
        require("body", body, ("C", 7))
    starts = np.cumsum([0, *(len(body) for body in there)])
    balls = []
    for body in there:
        low = (np.minimum(body[:, :3], body[:, 3:6]) - body[:, 6:]).min(axis=0)
        high = (np.maximum(body[:, :3], body[:, 3:6]) + body[:, 6:]).max(axis=0)
        middle = (low + high) / 2
        balls.append([*middle, *middle, float(np.linalg.norm(high - middle))])
    capsules = np.concatenate([np.zeros((0, 7)), *there])
    return capsules.astype(np.float32), np.array(balls, np.float32).reshape(-1, 7), starts


def sky_discs() -> Num[np.ndarray, "D 4"]:
    """Discs that represent diffuse light from above, all equally bright on a surface that faces up.

    They are uniform on the disc below the dome, which gives the cosine, and so far away that every point of a room sees
    each in the same direction.
    """
    k = np.arange(_SKY) + 0.5
    radius, angle = np.sqrt(k / _SKY), k * np.pi * (3 - np.sqrt(5))
    directions = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
    return np.concatenate([directions * _FAR_M**2, np.full((_SKY, 1), _SKY_TAN * _FAR_M**2)], axis=1)


def hidden_shares(
    points_m: Num[np.ndarray, "N 3"] | Groups, lamps: Num[np.ndarray, "K 4"], bodies: Sequence[Float[np.ndarray, "C 7"]]
) -> Float[np.ndarray, "N K"]:
    """Float32 share of every lamp that the bodies hide from points.

    ``lamps``: position and radius in metres, seen as a disc; ``bodies``: capsules each, two ends and a radius. Capsules
    hide parts of a lamp independently of each other: against sampled rays, this error is a third smaller than with only
    the capsule that hides most. Raises ValueError for other shapes.
    """
    groups = points_m if isinstance(points_m, Groups) else Groups.of(points_m)
    require("lamps", lamps, ("K", 4))
    shares = np.zeros((groups.count, len(lamps), LANES), np.float32)
    discs = np.ascontiguousarray(lamps, np.float32)
    nothing = np.zeros(0, np.float32)
    _hide_discs(groups.places, groups.spheres, discs, *pack_capsules(bodies), nothing, shares.reshape(-1), nothing)
    return groups.of_points(shares.transpose(0, 2, 1).reshape(-1, len(lamps)))


def hidden_light(
    groups: Groups,
    parts: Float[np.ndarray, " P"],
    lamps: Float[np.ndarray, "K 4"],
    bodies: Sequence[Float[np.ndarray, "C 7"]],
) -> Float[np.ndarray, " N"]:
    """Float32 sum over lamps of ``parts`` times the hidden share; ``parts`` are those of ``grouped``."""
    out = np.zeros(groups.count * LANES, np.float32)
    discs = np.ascontiguousarray(lamps, np.float32)
    _hide_discs(groups.places, groups.spheres, discs, *pack_capsules(bodies), parts, np.zeros(0, np.float32), out)
    return groups.of_points(out)


def hidden_sky_share(
    points_m: Float[np.ndarray, "N 3"] | Groups, bodies: Sequence[Float[np.ndarray, "C 7"]]
) -> Float[np.ndarray, " N"]:
    """Float32 share of the diffuse light from above that the bodies hide from points that face up."""
    return hidden_shares(points_m, sky_discs(), bodies).mean(axis=1)


def body_proximity(
    points_m: Float[np.ndarray, "N 3"] | Groups, bodies: Sequence[Float[np.ndarray, "C 7"]], reach_m: float
) -> Float[np.ndarray, " N"]:
    """1 where a body touches a point, exp(-1) at ``reach_m`` from its surface, 0 beyond four times that (bell
    curve)."""
    groups = points_m if isinstance(points_m, Groups) else Groups.of(points_m)
    gaps = np.empty(groups.count * LANES, np.float32)
    _surface_distances(groups.places, groups.spheres, *pack_capsules(bodies), float32(_REACHES * reach_m), gaps)
    near = np.exp(-np.square(np.maximum(gaps, 0) / np.float32(reach_m), dtype=np.float32))
    return groups.of_points(np.where(gaps < _REACHES * reach_m, near, np.float32(0)))


@njit(**INLINE)
def _near_ray(cx, cy, cz, radius, disc, capsule):
    """A mask of sixteen spheres (middle, radius): whether a capsule may be between any point of one and a disc."""
    nothing, whole = zeros(), broadcast(float32(1))
    lx, ly, lz = disc[0] - cx, disc[1] - cy, disc[2] - cz
    away = most(root(lx * lx + ly * ly + lz * lz), broadcast(float32(1e-6)))
    lx, ly, lz = lx / away, ly / away, lz / away
    ux, uy, uz = capsule[3] - capsule[0], capsule[4] - capsule[1], capsule[5] - capsule[2]
    uu = ux * ux + uy * uy + uz * uz
    wx, wy, wz = cx - capsule[0], cy - capsule[1], cz - capsule[2]
    ul, uw, lw = ux * lx + uy * ly + uz * lz, ux * wx + uy * wy + uz * wz, lx * wx + ly * wy + lz * wz
    # Extent along the ray: behind all points, or at most the width of the light there.
    furthest = most(-lw, ul - lw) + radius + capsule[6]
    light = disc[3] * least(whole, most(furthest, nothing) / most(away - radius, broadcast(float32(1e-6))))
    # The smallest distance of two segments: where the lines are nearest, clipped to the ray, then to the axis, then
    # again.
    across = uu - ul * ul
    slanted = above(across, broadcast(float32(1e-6) * max(uu, float32(1e-9))))
    share = least(most(select(slanted, (uw - ul * lw) / across, nothing), nothing), whole)
    along = least(most(share * ul - lw, nothing), away)
    share = least(most((uw + along * ul) * (float32(1) / uu if uu > float32(1e-12) else float32(0)), nothing), whole)
    along = least(most(share * ul - lw, nothing), away)
    dx, dy, dz = wx + along * lx - share * ux, wy + along * ly - share * uy, wz + along * lz - share * uz
    reach = radius + light + (capsule[6] + float32(1e-3))
    return both(at_least(furthest, nothing), above(reach * reach, dx * dx + dy * dy + dz * dz))


@njit(**INLINE)
def _visible_share(px, py, pz, lx, ly, lz, away, spread, capsule):
    """Share of a disc that one capsule leaves visible, from the distance of its axis to the ray to the disc's
    middle."""
    ux, uy, uz = capsule[3] - capsule[0], capsule[4] - capsule[1], capsule[5] - capsule[2]
    uu, radius = ux * ux + uy * uy + uz * uz, capsule[6]
    wx, wy, wz = px - capsule[0], py - capsule[1], pz - capsule[2]
    nothing, whole = zeros(), broadcast(float32(1))
    ul, uw, lw = ux * lx + uy * ly + uz * lz, ux * wx + uy * wy + uz * wz, lx * wx + ly * wy + lz * wz
    across = uu - ul * ul
    slanted = above(across, broadcast(float32(1e-6) * max(uu, float32(1e-9))))
    share = select(slanted, (uw - ul * lw) / across, broadcast(float32(0.5)))
    share = least(most(share, nothing), whole)
    along = least(most(share * ul - lw, nothing), away)
    # The ray is clipped to the segment between point and lamp, which moves the nearest point of the axis.
    share = least(most((uw + along * ul) * (float32(1) / uu if uu > float32(1e-12) else float32(0)), nothing), whole)
    dx, dy, dz = wx + along * lx - share * ux, wy + along * ly - share * uy, wz + along * lz - share * uz
    distance = root(dx * dx + dy * dy + dz * dz)
    wide = most(spread * along, broadcast(_SHARP))
    edge = float32(0.5) + float32(0.5) * (radius - distance) / wide
    edge = least(most(edge, nothing), whole)
    # A capsule narrower than the disc covers a strip of it.
    strip = least(float32(4 / math.pi) * radius / wide, whole)
    return float32(1) - edge * edge * (float32(3) - float32(2) * edge) * strip


@njit(**KERNEL)
def _visible_shares(places, at, disc, capsule):
    """Share of a disc that a capsule leaves visible to the sixteen points at ``at``."""
    px, py, pz = load(places, at), load(places, at + LANES), load(places, at + 2 * LANES)
    lx, ly, lz = disc[0] - px, disc[1] - py, disc[2] - pz
    away = most(root(lx * lx + ly * ly + lz * lz), broadcast(float32(1e-6)))
    return _visible_share(px, py, pz, lx / away, ly / away, lz / away, away, disc[3] / away, capsule)


@njit(**KERNEL)
def _hide_heap(places, spheres, heap, disc, capsules, starts, near, left):
    """Fills ``left`` (16 · 16) with the share of a disc that the bodies ``near`` leave visible to a heap's points.

    Returns bits of the groups that anything may occlude; the entries of other groups are not filled.
    """
    at = heap * 4 * LANES
    cx, cy, cz = load(spheres, at), load(spheres, at + LANES), load(spheres, at + 2 * LANES)
    radius, shaded = load(spheres, at + 3 * LANES), int64(0)
    for b in range(len(near)):
        if not near[b]:
            continue
        for c in range(starts[b], starts[b + 1]):
            bits = bits_from_mask(_near_ray(cx, cy, cz, radius, disc, capsules[c]))
            for new in range(LANES if bits & ~shaded else 0):
                if (bits & ~shaded) >> new & 1:
                    store(left, new * LANES, broadcast(float32(1)))
            shaded |= bits
            while bits:
                group = lowest_bit(bits)
                bits &= bits - 1
                covered = _visible_shares(places, (heap * LANES + group) * 3 * LANES, disc, capsules[c])
                store(left, group * LANES, load(left, group * LANES) * covered)
    return shaded


@njit(parallel=True, nogil=True, **KERNEL)
def _hide_discs(places, spheres, discs, capsules, balls, starts, parts, shares, sums):
    """Fills ``shares`` with the hidden share of every disc, or, given ``parts``, adds their product to ``sums``."""
    lamps = len(discs)
    for heap in prange(len(spheres) // (4 * LANES)):
        left, near = np.empty(LANES * LANES, np.float32), np.empty(len(balls), np.bool_)
        at = heap * 4 * LANES
        cx, cy, cz = load(spheres, at), load(spheres, at + LANES), load(spheres, at + 2 * LANES)
        for k in range(lamps):
            anybody = False
            for b in range(len(balls)):
                near[b] = bits_from_mask(_near_ray(cx, cy, cz, load(spheres, at + 3 * LANES), discs[k], balls[b])) != 0
                anybody |= near[b]
            bits = _hide_heap(places, spheres, heap, discs[k], capsules, starts, near, left) if anybody else int64(0)
            while bits:
                group = lowest_bit(bits)
                bits &= bits - 1
                hidden_share = float32(1) - load(left, group * LANES)
                g = heap * LANES + group
                row = (g * lamps + k) * LANES
                if len(parts):
                    store(sums, g * LANES, load(sums, g * LANES) + load(parts, row) * hidden_share)
                else:
                    store(shares, row, hidden_share)


@njit(nogil=True, **KERNEL)
def _surface_distances(places, spheres, capsules, balls, starts, reach, gaps):
    """Fills ``gaps`` (G, 16) with the distance to the nearest capsule's surface, exact below ``reach``."""
    for g in range(len(gaps) // LANES):
        sphere = (g // LANES) * 4 * LANES + g % LANES
        store(gaps, g * LANES, broadcast(float32(np.inf)))
        for b in range(len(balls)):
            ball = balls[b]
            dx, dy = spheres[sphere] - ball[0], spheres[sphere + LANES] - ball[1]
            dz, radius = spheres[sphere + 2 * LANES] - ball[2], spheres[sphere + 3 * LANES]
            if math.sqrt(dx * dx + dy * dy + dz * dz) > radius + ball[6] + reach:
                continue
            at, gap = g * 3 * LANES, load(gaps, g * LANES)
            px, py, pz = load(places, at), load(places, at + LANES), load(places, at + 2 * LANES)
            for c in range(starts[b], starts[b + 1]):
                own = capsules[c]
                ux, uy, uz = own[3] - own[0], own[4] - own[1], own[5] - own[2]
                uu = ux * ux + uy * uy + uz * uz
                inverse = float32(1) / uu if uu > float32(1e-12) else float32(0)
                wx, wy, wz = px - own[0], py - own[1], pz - own[2]
                share = (ux * wx + uy * wy + uz * wz) * inverse
                share = least(most(share, zeros()), broadcast(float32(1)))
                ex, ey, ez = wx - share * ux, wy - share * uy, wz - share * uz
                gap = least(gap, root(ex * ex + ey * ey + ez * ez) - own[6])
            store(gaps, g * LANES, gap)
