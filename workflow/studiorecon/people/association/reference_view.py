# SPDX-License-Identifier: Apache-2.0
"""The paper's association: one frame, one reference view, and the Hungarian algorithm for every other view
(§association).

Kept for comparison. A person whom the reference view does not see at that frame never gets an identity (A15), and one
frame's noise decides (A11). Tracks that begin later go to the person nearest at their first frame, as the other views
see them then (A14).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studiorecon.keypoints.tracking import match
from studiorecon.people.association.affinity import AssociationLimits
from studiorecon.people.association.track_pairs import Sights, detection_affinities


def star_groups(seen: Sequence[Sights], limits: AssociationLimits) -> list[list[tuple[int, int]]]:
    """(view, track) pairs of every person with more than the reference view, in order of the reference view's
    tracks."""
    frames = [int(s.frame.min()) for s in seen if len(s.frame)]
    if not frames:
        return []
    start = min(frames)  # the paper's t₀ = 0, or the first frame with a person (U31)
    now = [np.flatnonzero(s.frame == start) for s in seen]
    reference = max(range(len(seen)), key=lambda v: (len(now[v]), -v))
    owner = {(reference, int(seen[reference].track[d])): k for k, d in enumerate(now[reference])}
    people = len(owner)
    for v in range(len(seen)):
        if v == reference:
            continue
        affinity = detection_affinities(seen[reference], now[reference], seen[v], now[v], limits)
        # No affinity is no match, whatever the assignment (A03, A13).
        for k, d in match(1 - affinity, 1.0):
            owner[v, int(seen[v].track[now[v][d]])] = k
    _later_tracks(seen, start, owner, people, limits)
    groups = [sorted(node for node, k in owner.items() if k == person) for person in range(people)]
    return [g for g in groups if len({v for v, _ in g}) >= 2]


def _later_tracks(
    seen: Sequence[Sights], start: int, owner: dict[tuple[int, int], int], people: int, limits: AssociationLimits
) -> None:
    """Add to ``owner`` the tracks that begin after ``start``, in order of their first frame."""
    waiting = []
    for v, s in enumerate(seen):
        for track in np.unique(s.track):
            first = int(s.frame[s.track == track].min())
            if first > start:
                waiting.append((first, v, int(track)))
    for frame in sorted({first for first, _, _ in waiting}):
        for v in range(len(seen)):
            new = [t for first, view, t in waiting if first == frame and view == v]
            here = np.array(
                [int(np.flatnonzero((seen[v].frame == frame) & (seen[v].track == t))[0]) for t in new], dtype=int
            )
            for i, person in match(1 - _to_people(seen, v, here, frame, owner, people, limits), 1.0):
                owner[v, new[i]] = person


def _to_people(
    seen: Sequence[Sights],
    view: int,
    detections: np.ndarray,
    frame: int,
    owner: dict[tuple[int, int], int],
    people: int,
    limits: AssociationLimits,
) -> np.ndarray:
    """(A, people) mean affinity of new detections of a view to every person in the other views of this frame; 0 if
    taken."""
    total, count = np.zeros((len(detections), people)), np.zeros(people)
    taken = {owner.get((view, int(t))) for t in seen[view].track[seen[view].frame == frame]}
    for v, s in enumerate(seen):
        for d in np.flatnonzero(s.frame == frame):
            person = owner.get((v, int(s.track[d])))
            if v != view and person is not None and person not in taken:
                total[:, person] += detection_affinities(seen[view], detections, s, np.array([d]), limits)[:, 0]
                count[person] += 1
    return total / np.maximum(count, 1)
