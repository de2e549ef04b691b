# SPDX-License-Identifier: Apache-2.0
"""The cameras in which people are detected, and the method: recorded keypoints, the detector, or a network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from studiorecon.models.catalogue.selection import CHOICES
from studiorecon.scene.dataset import Dataset

_LANDMARKS = {"blazepose": "pose_landmark_full.onnx", "blazepose_heavy": "pose_landmark_heavy.onnx"}


@dataclass(frozen=True)
class PersonSources:
    """How people are detected. Every list holds camera names in the dataset's order.

    Attributes:
        bodies: the network that estimates bodies in every camera, or "precomputed"; "" = keypoints locate people.
        detected: cameras in which the detector runs: those without keypoint files, or all.
        measured: cameras in which it runs only to scale a network's calibration to metres: bodies come from another
            network, which needs the calibration first.
        watched: cameras with detections of people before there is a calibration.
        recorded: those of them with keypoints from files.
        checked: those of them that the doctor checks: the detector never runs in held-out cameras only for a check.
        timed: those whose people determine the time offsets before there is a calibration.
        part_used: only a part of the footage is used, and the detector reads only that part.
        finds_people: at least one source can show people.
        detector: names of the detector's files.
    """

    bodies: str
    detected: list[str]
    measured: list[str]
    watched: list[str]
    recorded: list[str]
    checked: list[str]
    timed: list[str]
    part_used: bool
    finds_people: bool
    detector: list[str]


def choose_person_sources(dataset: Dataset, config: Mapping[str, Any]) -> PersonSources:
    """The cameras and method of detection for this dataset, by ``detect.source`` and ``clocks.sync``."""
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
    return PersonSources(
        bodies=bodies,
        detected=detected,
        measured=measured,
        watched=watched,
        recorded=[c for c in watched if c not in looked_for],
        checked=checked,
        # Where only a part is used, the clocks must first determine which part the detector reads.
        timed=[c for c in checked if c not in looked_for or not part_used] if asked else [],
        part_used=part_used,
        finds_people=bool(watched) or bool(bodies),
        detector=["movenet_multipose.onnx", _LANDMARKS[config["detect"]["detector"]], "confidence.json"],
    )
