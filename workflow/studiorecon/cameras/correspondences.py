# SPDX-License-Identifier: Apache-2.0
"""Points that several cameras see, taken from people's keypoints before anybody knows who is who."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studiorecon.body.layouts import LAYOUTS
from studiorecon.errors import Refusal
from studiorecon.geometry.correspondence import TrackGraph, group_affinity, groups_of, track_graph
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

# Joints that a detector places within centimetres from every side; faces are seen from the front only.
STABLE_KEYPOINTS = tuple(f"{s}_{j}" for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for s in ("left", "right"))


@dataclass(frozen=True)
class Observations:
    """N points as V cameras saw them.

    Attributes:
        pixels: (V, N, 2), NaN where not seen.
        confidence: (V, N), 0 where not seen.
        frame: (N,) working frame.
        keypoint: (N,) index into ``STABLE_KEYPOINTS``.
        group: (N,) which group of tracks.
        affinity: summed affinity of all groups, 0..1 per pair: how well the cameras fit the people.
    """

    pixels: np.ndarray
    confidence: np.ndarray
    frame: np.ndarray
    keypoint: np.ndarray
    group: np.ndarray
    affinity: float


def stable_indices(layout: str) -> list[int]:
    """Where the stable keypoints stand in a layout; -1 for missing ones."""
    names = LAYOUTS[layout].keypoints
    return [names.index(k) if k in names else -1 for k in STABLE_KEYPOINTS]


def stable_detections(detections: Sequence[Detections], frames: np.ndarray) -> list[Detections]:
    """The detections of ``frames`` with the stable keypoints only, in their order, whatever the layout of each camera was."""
    chosen = []
    for d in detections:
        which = np.isin(d.frame, frames)
        padded = np.concatenate([d.keypoints[which], np.full((int(which.sum()), 1, 3), [np.nan, np.nan, 0.0])], axis=1)
        chosen.append(Detections(d.camera, d.layout, d.frame[which], d.track[which], padded[:, stable_indices(d.layout)]))
    return chosen


def observe(
    detections: Sequence[Detections], cameras: Sequence[Camera], frames: np.ndarray, gate_m: float
) -> tuple[Observations, TrackGraph]:
    """What the people in ``frames`` show the cameras, grouped by ray distance below ``gate_m``."""
    stable = stable_detections(detections, frames)
    if not len(STABLE_KEYPOINTS):
        raise Refusal("no keypoints are common to all layouts")
    graph = track_graph(stable, cameras, min_keypoints=4, keypoints=range(len(STABLE_KEYPOINTS)))
    groups = groups_of(graph.distance_m, graph.view, graph.together, gate_m)
    count, times = len(STABLE_KEYPOINTS), len(frames)
    pixels = np.full((len(cameras), len(groups), times, count, 2), np.nan)
    confidence = np.zeros((len(cameras), len(groups), times, count))
    place = {int(f): i for i, f in enumerate(frames)}
    for g, group in enumerate(groups):
        for node in group:
            view = int(graph.view[node])
            for d in np.flatnonzero(stable[view].track == graph.track[node]):
                t = place[int(stable[view].frame[d])]
                pixels[view, g, t], confidence[view, g, t] = stable[view].keypoints[d, :, :2], stable[view].keypoints[d, :, 2]
    group, frame, keypoint = (i.reshape(-1) for i in np.meshgrid(np.arange(len(groups)), frames, np.arange(count), indexing="ij"))
    pixels, confidence = pixels.reshape(len(cameras), -1, 2), confidence.reshape(len(cameras), -1)
    seen = (confidence > 0).sum(0) >= 2
    affinity = sum(group_affinity(g, graph.distance_m, gate_m) * len(g) for g in groups)
    return Observations(pixels[:, seen], confidence[:, seen], frame[seen], keypoint[seen], group[seen], affinity), graph


def spread_frames(frames: int, wanted: int) -> np.ndarray:
    """At most ``wanted`` working frames spread evenly over ``frames``."""
    return np.unique(np.linspace(0, frames - 1, min(wanted, frames)).round().astype(int))
