# SPDX-License-Identifier: Apache-2.0
"""Compiled search of ``regions``: how well a slanted plane through one region of a photo agrees with all other photos.

A plane is (3,) w with 1/z = w·(column, row, 1) in the photo it is looked for in (``matching.plane_inverse_depth``).
"""

from __future__ import annotations

import numpy as np
from numba import njit

# As in passes.py: another surface hides a point when it is nearer by this share of the depth and this many metres.
_HIDING_SHARE, _HIDING_M = 0.04, 0.05
# A well explained surface of another camera that is further by this share is looked at through the plane: it cannot be
# there.
_THROUGH = 1.07
# As in matching.py and agreement.py: flat windows correlate, so they are told from each other by their means and cost
# at least this.
_FLAT_VARIANCE, _FLAT_COST, _LEAST_VARIANCE = 4e-4, 0.3, 1e-3
_MOST_DIFFERENCE, _MOST_COST = 0.6, 1.2
# Shares of a region that another camera must see to judge, and that must lie inside the room.
_LEAST_SEEN, _LEAST_INSIDE = 0.6, 0.9
# Cost of what no other camera sees: between a match (about 0.1) and chance (about 0.9).
UNSEEN = np.float32(0.5)
# Neighbours that are tried around the best planes of the coarse search: steps of depth (share) and of tilt (radians),
# halved each round.
_STEP, _TILT, _ROUNDS = 0.012, 0.2, 5


@njit(cache=True, fastmath=True)
def region_cost(rgb, pixels, inverse, bound, others, other_known, surface, firm, maps, shifts, judging, mean_weight):
    """Cost of one region whose pixels (N, 2: column, row) have inverse depths (N,); ``UNSEEN`` when no camera can judge
    it.

    ``others`` (O, H, W, 3), ``surface`` (O, H, W) depth and ``firm`` (O, H, W) bool are the other cameras'; a pixel p
    at inverse depth i is seen at maps[o] (3, 3) p + shifts[o] (3,) i. ``bound`` (N,) is the inverse depth of the room's
    walls; ``judging`` (O,) bool.
    """
    inside = 0
    for k in range(len(pixels)):
        if inverse[k] >= bound[k] * 0.97:
            inside += 1
    if inside < _LEAST_INSIDE * len(pixels):
        return np.float32(_MOST_COST)
    total, judges = np.float32(0), 0
    height, width = other_known.shape[1:]
    for o in range(len(others)):
        if not judging[o]:
            continue
        n, through = 0, 0
        aa, bb, ab = np.float32(0), np.float32(0), np.float32(0)
        a0, a1, a2, b0, b1, b2 = (
            np.float32(0),
            np.float32(0),
            np.float32(0),
            np.float32(0),
            np.float32(0),
            np.float32(0),
        )
        for k in range(len(pixels)):
            x, y = pixels[k, 0], pixels[k, 1]
            u, v, i = x + 0.5, y + 0.5, inverse[k]
            w = maps[o, 2, 0] * u + maps[o, 2, 1] * v + maps[o, 2, 2] + shifts[o, 2] * i
            if w <= 0 or i <= 0:
                continue
            bx = (maps[o, 0, 0] * u + maps[o, 0, 1] * v + maps[o, 0, 2] + shifts[o, 0] * i) / w - 0.5
            by = (maps[o, 1, 0] * u + maps[o, 1, 1] * v + maps[o, 1, 2] + shifts[o, 1] * i) / w - 0.5
            if not (bx >= 0 and by >= 0 and bx < width - 1 and by < height - 1):
                continue
            c, r = int(bx), int(by)
            if not (
                other_known[o, r, c]
                and other_known[o, r, c + 1]
                and other_known[o, r + 1, c]
                and other_known[o, r + 1, c + 1]
            ):
                continue
            z = w / i
            p, q = np.float32(bx - c), np.float32(by - r)
            nearest_r, nearest_c = int(by + 0.5), int(bx + 0.5)
            there = surface[o, nearest_r, nearest_c]
            if there > 0 and there < z * (1 - _HIDING_SHARE) - _HIDING_M:
                continue
            if firm[o, nearest_r, nearest_c] and there > z * _THROUGH:
                through += 1
            r0, r1, r2 = rgb[y, x, 0], rgb[y, x, 1], rgb[y, x, 2]
            kk, kp, kq, pq = (1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q
            s0 = (
                others[o, r, c, 0] * kk
                + others[o, r, c + 1, 0] * kp
                + others[o, r + 1, c, 0] * kq
                + others[o, r + 1, c + 1, 0] * pq
            )
            s1 = (
                others[o, r, c, 1] * kk
                + others[o, r, c + 1, 1] * kp
                + others[o, r + 1, c, 1] * kq
                + others[o, r + 1, c + 1, 1] * pq
            )
            s2 = (
                others[o, r, c, 2] * kk
                + others[o, r, c + 1, 2] * kp
                + others[o, r + 1, c, 2] * kq
                + others[o, r + 1, c + 1, 2] * pq
            )
            a0, a1, a2, b0, b1, b2 = a0 + r0, a1 + r1, a2 + r2, b0 + s0, b1 + s1, b2 + s2
            aa += r0 * r0 + r1 * r1 + r2 * r2
            bb += s0 * s0 + s1 * s1 + s2 * s2
            ab += r0 * s0 + r1 * s1 + r2 * s2
            n += 1
        if n < _LEAST_SEEN * len(pixels):
            continue
        s = np.float32(1.0 / n)
        a0, a1, a2, b0, b1, b2 = a0 * s, a1 * s, a2 * s, b0 * s, b1 * s, b2 * s
        va = max(aa * s - a0 * a0 - a1 * a1 - a2 * a2, np.float32(0))
        vb = max(bb * s - b0 * b0 - b1 * b1 - b2 * b2, np.float32(0))
        apart = min(abs(a0 - b0) + abs(a1 - b1) + abs(a2 - b2), np.float32(_MOST_DIFFERENCE))
        cov = ab * s - a0 * b0 - a1 * b1 - a2 * b2
        score = (cov + _FLAT_VARIANCE) / np.sqrt((va + _FLAT_VARIANCE) * (vb + _FLAT_VARIANCE)) - mean_weight * apart
        cost = min(max(1 - score, 0.0), _MOST_COST)
        if va < _LEAST_VARIANCE:
            cost = max(cost, _FLAT_COST)
        share = through * s
        total += np.float32(cost * (1 - share) + _MOST_COST * share)
        judges += 1
    return total / judges if judges else UNSEEN


@njit(cache=True)
def _through(normal, ray, lens, z):
    """(3,) w of the plane with this normal through the point at depth ``z`` on the ray (x, y, 1), all in the camera's
    axes."""
    along = (normal[0] * ray[0] + normal[1] * ray[1] + normal[2]) * z
    a, b = normal[0] / lens[0], normal[1] / lens[1]
    return np.array([a / along, b / along, (normal[2] - a * lens[2] - b * lens[3]) / along])


@njit(cache=True)
def _price(
    w, rgb, pixels, inverse, bound, others, other_known, surface, firm, maps, shifts, seats, judging, mean_weight
):
    for k in range(len(pixels)):
        inverse[k] = w[0] * (pixels[k, 0] + 0.5) + w[1] * (pixels[k, 1] + 0.5) + w[2]
    for o in range(len(seats)):
        # Beyond the plane a camera sees its back, which looks otherwise.
        judging[o] = w[0] * seats[o, 0] + w[1] * seats[o, 1] + w[2] * seats[o, 2] < 0.98
    cost = region_cost(
        rgb, pixels, inverse, bound, others, other_known, surface, firm, maps, shifts, judging, mean_weight
    )
    seen = False
    for o in range(len(seats)):
        seen = seen or judging[o]
    return cost if seen else UNSEEN


@njit(cache=True)
def best_plane(
    lens,
    normals,
    depths,
    rgb,
    pixels,
    bound,
    others,
    other_known,
    surface,
    firm,
    maps,
    shifts,
    seats,
    mean_weight,
    most,
):
    """(``most``, 4) the best planes of a region after a look at every normal (M, 3) at every depth (D,): w and cost,
    best first.

    ``lens`` (4,), normals and ``seats`` (O, 3: the lens times the other camera's centre) are in the camera's axes; at
    most one plane per depth neighbourhood is kept.
    """
    middle = np.array([pixels[:, 0].mean() + 0.5, pixels[:, 1].mean() + 0.5])
    ray = np.array([(middle[0] - lens[2]) / lens[0], (middle[1] - lens[3]) / lens[1], 1.0])
    inverse, judging = np.zeros(len(pixels)), np.zeros(len(seats), np.bool_)
    best = np.full((len(depths), 2), 9.0)
    for d in range(len(depths)):
        for m in range(len(normals)):
            w = _through(normals[m], ray, lens, depths[d])
            cost = _price(
                w,
                rgb,
                pixels,
                inverse,
                bound,
                others,
                other_known,
                surface,
                firm,
                maps,
                shifts,
                seats,
                judging,
                mean_weight,
            )
            if cost < best[d, 0]:
                best[d, 0], best[d, 1] = cost, m
    found = np.full((most, 4), 9.0)
    for place in range(most):
        d = int(best[:, 0].argmin())
        if best[d, 0] >= UNSEEN:
            break
        normal, z, cost = normals[int(best[d, 1])].copy(), depths[d], best[d, 0]
        best[max(d - 2, 0) : d + 3, 0] = 9.0
        step, tilt = _STEP, _TILT
        for _ in range(_ROUNDS):
            for _again in range(4):
                kept_normal, kept_z, improved = normal, z, False
                for move in range(6):
                    sign = 1.0 if move % 2 == 0 else -1.0
                    trial, there = normal.copy(), z
                    if move < 2:
                        there = z * (1 + sign * step)
                    else:
                        side = (
                            np.array([normal[1], -normal[0], 0.0])
                            if abs(normal[2]) < 0.9
                            else np.array([0.0, normal[2], -normal[1]])
                        )
                        side /= np.sqrt((side * side).sum())
                        if move >= 4:
                            side = np.cross(normal, side)
                        trial = normal + sign * tilt * side
                        trial /= np.sqrt((trial * trial).sum())
                    if trial[0] * ray[0] + trial[1] * ray[1] + trial[2] > -0.15 * np.sqrt((ray * ray).sum()):
                        continue
                    w = _through(trial, ray, lens, there)
                    priced = _price(
                        w,
                        rgb,
                        pixels,
                        inverse,
                        bound,
                        others,
                        other_known,
                        surface,
                        firm,
                        maps,
                        shifts,
                        seats,
                        judging,
                        mean_weight,
                    )
                    if priced < cost - 1e-4:
                        cost, kept_normal, kept_z, improved = priced, trial, there, True
                normal, z = kept_normal, kept_z
                if not improved:
                    break
            step, tilt = step / 2, tilt / 2
        w = _through(normal, ray, lens, z)
        found[place, 0], found[place, 1], found[place, 2], found[place, 3] = w[0], w[1], w[2], cost
    return found
