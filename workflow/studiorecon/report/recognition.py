# SPDX-License-Identifier: Apache-2.0
"""``report.recognition``: scores how well a detector recognises people in the films: PCK and detection rate.

The reference is the same detector's keypoints in the photos of the same cameras and moments. The paper uses DWPose;
here it is the embedded detector, on a few moments of every camera. It needs no truth: people that it misses in the
photo do not count.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.detector.frame_detection import Detector
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.detector.tracking import keypoints_with_confidence
from studiorecon.footage.video import read_frames_from
from studiorecon.progress import progress, say
from studiorecon.report.metrics.films import ScoredFilmFiles
from studiorecon.report.metrics.pck import TruePerson, score_keypoints
from studiorecon.scene.files import write_json
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Moments of every camera, spread evenly: few suffice, because people move little between neighbouring frames.
_MOMENTS = 4
# Confidence from which a point of the photo counts as seen, and how many are needed to estimate a person's size.
_SEEN, _MIN = 0.5, 6


def run(files: ScoredFilmFiles, networks: list[Path], recognition: Written) -> None:
    """Write the scores of the film as rendered (``raw``) and as ``enhanced``, by the detector of ``networks``."""
    opened = DetectorFiles(networks)
    detector, worth = opened.detector(), opened.worth()
    scored = files.read()
    found: dict[str, list[tuple[list[np.ndarray], list[TruePerson]]]] = {name: [] for name in scored.films}
    for camera in progress(scored.cameras if scored.films else [], "cameras"):
        for frame in spread_indices(scored.capture.frames, _MOMENTS):
            photo = _picture(scored.footage[camera.name], int(frame))
            people = [
                person
                for one in detect_keypoints(detector, photo, worth)
                if (person := reference_person(one)) is not None
            ]
            compared: list[tuple[np.ndarray, list[np.ndarray]]] = []
            for name, film in scored.films.items():
                drawn = _picture(film, scored.starts[camera.name] + int(frame))[: photo.shape[0], : photo.shape[1]]
                # Where nothing was enhanced, the two films are one.
                points = next((points for other, points in compared if np.array_equal(other, drawn)), None)
                if points is None:
                    points = [one[:, :2] for one in detect_keypoints(detector, drawn, worth)]
                compared.append((drawn, points))
                found[name].append((points, people))
    scores = {name: add_reason(score_keypoints(pictures)) for name, pictures in found.items()}
    nothing = {"pck_0.05": None, "pck_0.1": None, "detection_rate": None, "reason": "no film shows a camera's own view"}
    for name, one in scores.items():
        if one["people"]:
            say(
                f"{name}: the detector detects {one['detection_rate']:.0%} of the photos' people in the film, "
                f"{one['pck_0.05']:.1%} of their points within 5 % of their size"
            )
    write_json(
        recognition,
        {name: scores.get(name, nothing) for name in ("raw", "enhanced")} | {"detector": detector.placer.title},
    )


def add_reason(scored: dict[str, Any]) -> dict[str, Any]:
    """The scores, with the reason when no person counted."""
    return scored | {"reason": None if scored["people"] else "the detector finds no person in the photos"}


def detect_keypoints(
    detector: Detector, picture: Integer[np.ndarray, "H W 3"], worth: dict[str, list[float]]
) -> list[Float[np.ndarray, "33 3"]]:
    """Keypoints of all people in a picture: x, y in pixels and confidence; searched as in photos, without hints."""
    wh = picture.shape[1], picture.shape[0]
    return [keypoints_with_confidence(one, wh, worth) for one in detector.detect_new_people(picture)]


def reference_person(keypoints: Float[np.ndarray, "33 3"]) -> TruePerson | None:
    """A person of a photo as reference for the film; None when too little of the person is seen."""
    visible = keypoints[:, 2] >= _SEEN
    if visible.sum() < _MIN:
        return None
    extent = np.ptp(keypoints[visible, :2], axis=0)
    return TruePerson(keypoints[:, :2], visible, (float(extent[0]), float(extent[1])))


def _picture(film: Path, index: int) -> np.ndarray:
    pictures: Iterator[np.ndarray] = read_frames_from(film, index, index + 1)
    return next(pictures)
