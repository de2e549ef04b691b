# SPDX-License-Identifier: Apache-2.0
"""In which cameras people are looked for, and by what: recorded keypoints, the detector, or a network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from studiorecon.models.catalogue.selection import CHOICES
from studiorecon.scene.dataset import Dataset

_LANDMARKS = {"blazepose": "pose_landmark_full.onnx", "blazepose_heavy": "pose_landmark_heavy.onnx"}


@dataclass(frozen=True)
class Sight:
    """How people are seen. Every list holds camera names, in the dataset's order.

    Attributes:
        bodies: the network that estimates bodies in every camera, or "precomputed"; "" = keypoints say who is where.
        detected: in whose pictures the detector looks for people: those without keypoint files, or all.
        measured: in whose pictures it looks only for what a network's cameras are put to metres by: bodies come from
            another network, which needs the calibration first.
        watched: in which people can be told before there is a calibration.
        checked: those of them that the doctor looks at: nobody is looked for in held-out pictures for its sake.
        timed: those whose people tell, before there is a calibration, when each was started.
        part_used: only a part of the footage is used, and the detector looks at that alone.
        somebody: there is anything that can show people.
        detector: names of the detector's files.
    """

    bodies: str
    detected: list[str]
    measured: list[str]
    watched: list[str]
    checked: list[str]
    timed: list[str]
    part_used: bool
    somebody: bool
    detector: list[str]


def sight_of(dataset: Dataset, config: Mapping[str, Any]) -> Sight:
    """How ``detect.source`` and ``clocks.sync`` have people looked for in this dataset."""
    source = config["detect"]["source"]
    looked_at = {"auto": [c for c in dataset.cameras if c not in dataset.keypoints], "detector": list(dataset.cameras)}
    bodies = "" if source in ("auto", "keypoints", "detector") else source
    detected = looked_at.get(source, []) if dataset.people else []
    unitless = (
        bool(bodies) and dataset.people and config["calibration"]["source"] in CHOICES["calibration.source"].networks
    )
    measured = [c for c in dataset.cameras if unitless and c not in dataset.keypoints]
    looked_for = [*detected, *measured]
    watched = [c for c in dataset.cameras if c in dataset.keypoints or c in looked_for]
    checked = [c for c in watched if c in dataset.training or c not in looked_for]
    part_used = bool(dataset.first_frame or dataset.frame_count)
    asked = dataset.people and config["clocks"]["sync"] != "never"
    return Sight(
        bodies=bodies,
        detected=detected,
        measured=measured,
        watched=watched,
        checked=checked,
        # Where only a part is used, the clocks must say first which part the detector is to look at.
        timed=[c for c in checked if c not in looked_for or not part_used] if asked else [],
        part_used=part_used,
        somebody=bool(watched) or bool(bodies),
        detector=["pose_detection.onnx", _LANDMARKS[config["detect"]["detector"]], "confidence.json"],
    )
