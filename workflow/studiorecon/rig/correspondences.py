# SPDX-License-Identifier: Apache-2.0
"""Points that several cameras see, from people's keypoints before their identities are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.correspondence import (
    STABLE_KEYPOINTS,
    TrackGraph,
    group_affinity,
    stable_detections,
    track_graph,
    track_groups,
)
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num


@dataclass(frozen=True)
class Observations:
    """N points as V cameras saw them.

    Attributes:
        pixels: (V, N, 2), NaN where not seen.
        confidence: (V, N), 0 where not seen.
        frame: working frame.
        keypoint: index into ``STABLE_KEYPOINTS``.
        group: index of the group of tracks.
        affinity: summed affinity of all groups, 0..1 per pair: how well the cameras fit the people.
    """

    pixels: Num[np.ndarray, "V N 2"]
    confidence: Num[np.ndarray, "V N"]
    frame: Num[np.ndarray, " N"]
    keypoint: Num[np.ndarray, " N"]
    group: Num[np.ndarray, " N"]
    affinity: float

    def by(self, views: Sequence[int]) -> Observations:
        """The observations of the chosen cameras."""
        return replace(self, pixels=self.pixels[list(views)], confidence=self.confidence[list(views)])

    def of(self, which: Bool[np.ndarray, " N"]) -> Observations:
        """The observations of the chosen points."""
        return Observations(
            self.pixels[:, which],
            self.confidence[:, which],
            self.frame[which],
            self.keypoint[which],
            self.group[which],
            self.affinity,
        )


def make_observations(
    detections: Sequence[Detections], cameras: Sequence[Camera], frames: Integer[np.ndarray, " F"], gate_m: float
) -> tuple[Observations, TrackGraph]:
    """The cameras' observations of people in ``frames``, grouped by ray distance below ``gate_m``."""
    stable = stable_detections(detections, frames)
    graph = track_graph(stable, cameras)
    groups = track_groups(graph.distance_m, graph.view, graph.moments, gate_m)
    count, times = len(STABLE_KEYPOINTS), len(frames)
    pixels = np.full((len(cameras), len(groups), times, count, 2), np.nan)
    confidence = np.zeros((len(cameras), len(groups), times, count))
    place = {int(f): i for i, f in enumerate(frames)}
    for g, group in enumerate(groups):
        for node in group:
            view = int(graph.view[node])
            for d in np.flatnonzero(stable[view].track == graph.track[node]):
                t = place[int(stable[view].frame[d])]
                pixels[view, g, t], confidence[view, g, t] = (
                    stable[view].keypoints[d, :, :2],
                    stable[view].keypoints[d, :, 2],
                )
    group, frame, keypoint = (
        i.reshape(-1) for i in np.meshgrid(np.arange(len(groups)), frames, np.arange(count), indexing="ij")
    )
    flat, sure = pixels.reshape(len(cameras), -1, 2), confidence.reshape(len(cameras), -1)
    seen = (sure > 0).sum(0) >= 2
    affinity = sum(group_affinity(g, graph.distance_m, gate_m) * len(g) for g in groups)
    return Observations(flat[:, seen], sure[:, seen], frame[seen], keypoint[seen], group[seen], affinity), graph
