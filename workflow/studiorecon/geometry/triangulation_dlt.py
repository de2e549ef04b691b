# SPDX-License-Identifier: Apache-2.0
"""One point from its rays by homogeneous linear least squares, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def dlt(rig, seen, weights, n, used, rows, turned, point):
    """Solve homogeneous least squares over the used views into ``point``; False for a shared centre or infinity.

    Rows carry √w, because they enter squared (T05); the world is centred and scaled to the used views (T15). One-sided
    Jacobi on the rows themselves: the eigenvalues of AᵀA would lose half of the digits (T14).
    """
    rotations, translations, centres, focal, principal, _ = rig
    centre, total, spread = np.zeros(3), 0.0, 0.0
    for v in used:
        total += weights[v, n]
        centre += weights[v, n] * centres[v]
    centre /= total
    for v in used:
        spread += weights[v, n] * ((centres[v] - centre) ** 2).sum()
    spread = max(np.sqrt(spread / total), 1e-9)
    for k in range(len(used)):
        v = used[k]
        r, root = rotations[v], np.sqrt(weights[v, n])
        x = (seen[v, n, 0] - principal[v, 0]) / focal[v, 0]
        y = (seen[v, n, 1] - principal[v, 1]) / focal[v, 1]
        for a in range(3):
            rows[2 * k, a] = root * (x * r[2, a] - r[0, a])
            rows[2 * k + 1, a] = root * (y * r[2, a] - r[1, a])
        t0 = (r[0, 0] * centre[0] + r[0, 1] * centre[1] + r[0, 2] * centre[2] + translations[v, 0]) / spread
        t1 = (r[1, 0] * centre[0] + r[1, 1] * centre[1] + r[1, 2] * centre[2] + translations[v, 1]) / spread
        t2 = (r[2, 0] * centre[0] + r[2, 1] * centre[1] + r[2, 2] * centre[2] + translations[v, 2]) / spread
        rows[2 * k, 3] = root * (x * t2 - t0)
        rows[2 * k + 1, 3] = root * (y * t2 - t1)
    height = 2 * len(used)
    for a in range(4):
        for b in range(4):
            turned[a, b] = 1.0 if a == b else 0.0
    for _ in range(30):
        rotated = False
        for a in range(3):
            for b in range(a + 1, 4):
                square_a, square_b, mixed = 0.0, 0.0, 0.0
                for i in range(height):
                    square_a += rows[i, a] * rows[i, a]
                    square_b += rows[i, b] * rows[i, b]
                    mixed += rows[i, a] * rows[i, b]
                if abs(mixed) <= 1e-15 * np.sqrt(square_a * square_b):
                    continue
                rotated = True
                half = (square_b - square_a) / (2 * mixed)
                tangent = (1.0 if half >= 0 else -1.0) / (abs(half) + np.sqrt(1 + half * half))
                cosine = 1 / np.sqrt(1 + tangent * tangent)
                sine = cosine * tangent
                for i in range(height):
                    first, second = rows[i, a], rows[i, b]
                    rows[i, a], rows[i, b] = cosine * first - sine * second, sine * first + cosine * second
                for i in range(4):
                    first, second = turned[i, a], turned[i, b]
                    turned[i, a], turned[i, b] = cosine * first - sine * second, sine * first + cosine * second
        if not rotated:
            break
    least, next_least, most, which = np.inf, np.inf, 0.0, 0
    for a in range(4):
        square = 0.0
        for i in range(height):
            square += rows[i, a] * rows[i, a]
        most = max(most, square)
        if square < least:
            least, next_least, which = square, least, a
        elif square < next_least:
            next_least = square
    # Two vanishing singular values: a whole line of points fits as well (T03).
    if not next_least > 1e-12 * most or abs(turned[3, which]) < 1e-12:
        return False
    for a in range(3):
        point[a] = centre[a] + spread * turned[a, which] / turned[3, which]
    return True
