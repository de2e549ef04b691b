# SPDX-License-Identifier: Apache-2.0
"""Groups of linked nodes, chosen whole by the sum of their affinities: beam search in each connected part."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.arrays import require

if TYPE_CHECKING:
    from jaxtyping import Bool, Num

_BEAM = 200
# Candidates examined before duplicates are dropped; a group of n nodes is reached from up to n others. Doubled until it
# suffices.
_CANDIDATES = 16 * _BEAM
# Sums of one group in different orders differ in their last digits: scores are rounded to so many digits, so that ties
# are ties.
_DIGITS = 9


def groups_by_affinity(affinity: Num[np.ndarray, "M M"], forbidden: Bool[np.ndarray, "M M"]) -> list[list[int]]:
    """Groups of nodes, best first, chosen greedily by the largest sum of ``affinity``, 0 = not linked.

    No two nodes of a group are ``forbidden`` together; nodes without a link are left out. Connected parts of the graph
    are searched separately: one search over hundreds of short tracks took minutes. Raises ValueError for other shapes,
    and for affinities that are not finite: a pair that was not measured has 0 (A02).
    """
    require("forbidden", forbidden, ("M", "M"), require("affinity", affinity, ("M", "M"), finite=True))
    forbidden = forbidden | np.eye(len(affinity), dtype=bool)
    # (negative score, nodes of the group, its connected part): the heap's top is the best group of all.
    heap: list[tuple[float, list[int], np.ndarray]] = []
    pieces, found = [np.arange(len(affinity))], []
    while pieces or heap:
        for piece in (p for whole in pieces for p in _connected_parts(whole, affinity, forbidden)):
            score, group = _best_group(affinity[np.ix_(piece, piece)], forbidden[np.ix_(piece, piece)])
            if len(group) > 1:
                heapq.heappush(heap, (-round(score, _DIGITS), piece[group].tolist(), piece))
        pieces = []
        if heap:
            _, best, piece = heapq.heappop(heap)
            found.append(best)
            pieces = [np.setdiff1d(piece, best)]
    return found


def _connected_parts(nodes: np.ndarray, affinity: np.ndarray, forbidden: np.ndarray) -> list[np.ndarray]:
    """The connected parts of the nodes, every part ascending."""
    block = np.ix_(nodes, nodes)
    graph = scipy.sparse.csr_array((affinity[block] > 0) & ~forbidden[block])
    labels = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    return [nodes[labels == label] for label in range(labels.max(initial=-1) + 1)]


def _best_group(affinity: np.ndarray, forbidden: np.ndarray) -> tuple[float, np.ndarray]:
    """(score, nodes) by beam search over groups grown by one node at a time; ties go to the lower nodes."""
    count = len(affinity)
    # A group's name is independent of the order in which it grew; two of a million groups collide once in ten million
    # searches.
    names = np.random.default_rng(0).integers(1, 2**63, count, dtype=np.uint64)
    first, second = np.nonzero(np.triu((affinity > 0) & ~forbidden, 1))
    members = np.zeros((len(first), count), dtype=bool)
    members[np.arange(len(first)), first] = members[np.arange(len(first)), second] = True
    scores, gains = affinity[first, second].astype(np.float64), affinity[first] + affinity[second]
    closed, name = forbidden[first] | forbidden[second], names[first] ^ names[second]
    best: tuple[float, np.ndarray] = (0.0, np.zeros(0, dtype=int))
    while len(scores):
        scores = np.round(scores, _DIGITS)
        order = _leaders(scores, members)
        members, scores, gains, closed, name = members[order], scores[order], gains[order], closed[order], name[order]
        if scores[0] > best[0]:
            best = float(scores[0]), np.flatnonzero(members[0])
        parent, node = np.nonzero((gains > 0) & ~closed)
        grown, named = scores[parent] + gains[parent, node], name[parent] ^ names[node]
        kept = _distinct(np.round(grown, _DIGITS), named)
        parent, node, scores, name = parent[kept], node[kept], grown[kept], named[kept]
        members, gains, closed = members[parent], gains[parent] + affinity[node], closed[parent] | forbidden[node]
        members[np.arange(len(node)), node] = True
    return best


def _distinct(scores: np.ndarray, names: np.ndarray) -> np.ndarray:
    """Indices of at least the ``_BEAM`` best groups (all that tie with the last of them), every group once."""
    wanted = _CANDIDATES
    while True:
        top = np.arange(len(scores)) if len(scores) <= wanted else np.argpartition(-scores, wanted)[:wanted]
        kept = top[np.unique(names[top], return_index=True)[1]]
        if len(top) == len(scores) or len(kept) >= _BEAM:
            break
        wanted *= 2
    if len(kept) > _BEAM:
        kept = kept[scores[kept] >= np.partition(scores[kept], len(kept) - _BEAM)[len(kept) - _BEAM]]
    return kept


def _leaders(scores: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Indices of the ``_BEAM`` best groups, best first; ties by their nodes in ascending order."""
    if len(scores) > _BEAM:
        candidates = np.flatnonzero(scores >= np.partition(scores, len(scores) - _BEAM)[len(scores) - _BEAM])
    else:
        candidates = np.arange(len(scores))
    order = candidates[np.argsort(-scores[candidates], kind="stable")]
    if len(np.unique(scores[order])) < len(order):
        order = np.array(
            sorted(order.tolist(), key=lambda i: (-scores[i], np.flatnonzero(members[i]).tolist())), dtype=int
        )
    return order[:_BEAM]
