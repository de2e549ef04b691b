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
        body_network: the network that estimates bodies in every camera, or "precomputed"; "" = keypoints are used.
        detector_cameras: cameras in which the detector runs: those without keypoint files, or all.
        scale_cameras: cameras in which it only scales a network's calibration to metres, where bodies come from another
            network, which needs the calibration first.
        cameras: cameras with detections of people before there is a calibration.
        searched_cameras: those of them in which the detector runs.
        file_cameras: those of them with keypoints from files.
        doctor_cameras: those of them that the doctor checks: the detector never runs in held-out ones just for it.
        clock_cameras: those whose people determine the time offsets before there is a calibration.
        uses_part: only a part of the footage is used, and the detector reads only that part.
        can_show_people: at least one source can show people.
        detector_files: names of the detector's files.
    """

    body_network: str
    detector_cameras: list[str]
    scale_cameras: list[str]
    cameras: list[str]
    searched_cameras: list[str]
    file_cameras: list[str]
    doctor_cameras: list[str]
    clock_cameras: list[str]
    uses_part: bool
    can_show_people: bool
    detector_files: list[str]


def choose_person_sources(dataset: Dataset, config: Mapping[str, Any]) -> PersonSources:
    """The cameras and method of detection for this dataset, by ``detect.source`` and ``clocks.sync``."""
    source = config["detect"]["source"]
    by_source = {"auto": [c for c in dataset.cameras if c not in dataset.keypoints], "detector": list(dataset.cameras)}
    body_network = "" if source in ("auto", "keypoints", "detector") else source
    detector_cameras = by_source.get(source, []) if dataset.people else []
    unitless = (
        bool(body_network)
        and dataset.people
        and config["calibration"]["source"] in CHOICES["calibration.source"].networks
    )
    scale_cameras = [c for c in dataset.cameras if unitless and c not in dataset.keypoints]
    searched = [*detector_cameras, *scale_cameras]
    cameras = [c for c in dataset.cameras if c in dataset.keypoints or c in searched]
    doctor_cameras = [c for c in cameras if c in dataset.training or c not in searched]
    uses_part = bool(dataset.first_frame or dataset.frame_count)
    needs_clocks = dataset.people and config["clocks"]["sync"] != "never"
    return PersonSources(
        body_network=body_network,
        detector_cameras=detector_cameras,
        scale_cameras=scale_cameras,
        cameras=cameras,
        searched_cameras=searched,
        file_cameras=[c for c in cameras if c not in searched],
        doctor_cameras=doctor_cameras,
        # Where only a part is used, the clocks must first determine which part the detector reads.
        clock_cameras=[c for c in doctor_cameras if c not in searched or not uses_part] if needs_clocks else [],
        uses_part=uses_part,
        can_show_people=bool(cameras) or bool(body_network),
        detector_files=["movenet_multipose.onnx", _LANDMARKS[config["detect"]["detector"]], "confidence.json"],
    )
