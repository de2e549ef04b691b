# SPDX-License-Identifier: Apache-2.0
"""Matches a network's numbers to fitted people: each to the body that it covers most, several to one person."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.images.palette import UNASSIGNED
from studiorecon.images.silhouette import front_person

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# A number belongs to a person only if at least this share of its pixels is on them; clothes are wider than bodies.
MIN_SHARE = 0.3


def assign_people(
    labels: Iterable[Integer[np.ndarray, "H W"]], depths_m: Iterable[Float[np.ndarray, "K H W"]], people: int
) -> tuple[Iterator[Integer[np.ndarray, "H W"]], str]:
    """Uint8 masks with this project's labels from a network's numbers, frame by frame, and a sentence on the match.

    ``labels`` are read twice. Numbers that match no person are 255.
    """
    overlap = count_overlaps(labels, depths_m, people)
    sizes = overlap.sum(axis=1)
    table = np.zeros(256, np.uint8)
    matched = []
    for value in np.flatnonzero(sizes[1:]) + 1:
        best = int(overlap[value, 1:].argmax()) if people else 0
        sure = people > 0 and overlap[value, 1 + best] >= MIN_SHARE * sizes[value]
        table[value] = best + 1 if sure else UNASSIGNED
        if sure:
            matched.append(f"{value} = p{best}")
    strangers = int(np.sum(table == UNASSIGNED))
    described = "numbers were matched by overlap with the bodies: " + (", ".join(matched) or "none")
    masks = (table[label] for label in labels)
    return masks, described + (f"; {strangers} overlap no fitted person" if strangers else "")


def count_overlaps(
    labels: Iterable[Integer[np.ndarray, "H W"]], depths_m: Iterable[Float[np.ndarray, "K H W"]], people: int
) -> Integer[np.ndarray, "256 1+people"]:
    """Pixels per number over all frames: outside of all bodies, and on the body of each person in front.

    Raises ValueError when there are not as many ``labels`` as ``depths_m``.
    """
    overlap = np.zeros((256, people + 1), np.int64)
    for label, depth_m in zip(labels, depths_m, strict=True):
        front = front_person(depth_m) if people else np.zeros(label.shape, np.int64)
        overlap += np.bincount(
            label.astype(np.int64).ravel() * (people + 1) + front.ravel(), minlength=256 * (people + 1)
        ).reshape(256, -1)
    return overlap
