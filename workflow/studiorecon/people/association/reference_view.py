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

from studiorecon.keypoints.tracking import match_detections
from studiorecon.people.association.affinity import AssociationLimits, track_pairs
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections


def star_groups(
    detections: Sequence[Detections], stable: Sequence[Detections], cameras: Sequence[Camera], limits: AssociationLimits
) -> list[list[tuple[int, int]]]:
    """(view, track) pairs of every person with more than the reference view, in order of the reference view's
    tracks."""
    first = {
        (v, int(t)): int(d.frame[d.track == t].min()) for v, d in enumerate(detections) for t in np.unique(d.track)
    }
    owner: dict[tuple[int, int], int] = {}
    people, start, reference = 0, min(first.values(), default=0), 0  # the paper's t₀ = 0, or the first person's (U31)
    for frame in sorted(set(first.values())):
        here, points = ([d.only(d.frame == frame) for d in own] for own in (detections, stable))
        now = track_pairs(here, points, cameras, limits)
        nodes = now.nodes
        if frame == start:
            reference = int(np.argmax(np.bincount(now.graph.view, minlength=len(cameras))))
            owner = {node: k for k, node in enumerate(node for node in nodes if node[0] == reference)}
            people = len(owner)
        for v in range(len(cameras)):
            new = [n for n, node in enumerate(nodes) if node[0] == v and first[node] == frame and node not in owner]
            taken = {owner.get(node) for node in nodes if node[0] == v}
            # Where the other views see each person now; at the first frame the reference view alone.
            shown = np.zeros((len(nodes), people))
            for n, node in enumerate(nodes):
                person = owner.get(node)
                if node[0] != v and person is not None and person not in taken:
                    shown[n, person] = frame > start or node[0] == reference
            affinity = np.nan_to_num(now.affinity[new]) @ shown / np.maximum(shown.sum(0), 1)
            # No affinity is no match, whatever the assignment (A03, A13).
            owner |= {nodes[new[i]]: k for i, k in match_detections(1 - affinity, 1.0)}
    groups = [sorted(node for node, k in owner.items() if k == person) for person in range(people)]
    return [g for g in groups if len({v for v, _ in g}) >= 2]
