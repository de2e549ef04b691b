# SPDX-License-Identifier: Apache-2.0
"""The user's own network for all people of a picture at once: RTMO, or another of its form.

It runs after BlazePose, as ``top_down`` does, on a square around each person. The square may show several people: the
one who agrees with BlazePose's landmarks counts, and without one BlazePose's landmarks stay. Form, as MMDeploy exports
it (Lu et al., "RTMO", 2023): a square of BGR from 0 to 255, grey beyond the picture; boxes with scores (1, N, 5), and
points of the same people (1, N, K, 3) in pixels of the square.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.detector.crops import Region, sample_region
from studiorecon.detector.top_down import network_layout
from studiorecon.errors import UserError
from studiorecon.keypoints.layouts import LAYOUTS

if TYPE_CHECKING:
    import onnxruntime
    from jaxtyping import Num

# Where its file leaves the size open it was trained on squares of so many pixels.
_USUAL_PX, _LARGEST_PX = 640, 2048
_BEYOND = 114
# Side of the square, in sides of the box around the landmarks: neighbours must be whole enough to be distinguished.
_MARGIN = 1.6
_MIN_SCORE = 0.3
# Points a tenth of the body from the landmarks agree to 0.37; this much in the mean is the same person.
_NEAR_SHARE, _MIN_AGREEMENT = 0.1, 0.4
_LANDMARKS = LAYOUTS["blazepose33"].keypoints
_BOX, _POINT = 5, 3


def is_one_stage(session: onnxruntime.InferenceSession) -> bool:
    """Whether a network's outputs are boxes (1, N, 5) and points (1, N, K, 3)."""
    shapes = [tuple(out.shape or ()) for out in session.get_outputs()]
    return len(shapes) == 2 and {(len(shape), shape[-1]) for shape in shapes if shape} == {(3, _BOX), (4, _POINT)}


class OneStage:
    """The network, on one core. Raises UserError for a file of another form, or whose points have no name.

    Args:
        session: the opened network, for which ``is_one_stage`` holds.
        path: its file, for messages.
        layout: name of its points (``keypoints.layouts``), or "auto" where their number determines it.
    """

    def __init__(self, session: onnxruntime.InferenceSession, path: Path, layout: str) -> None:
        self._session = session
        given = self._session.get_inputs()
        shape = tuple(given[0].shape)
        sides = {side if isinstance(side, int) else _USUAL_PX for side in shape[2:]}
        if len(given) != 1 or len(shape) != 4 or shape[1] != 3 or len(sides) != 1 or not 0 < max(sides) <= _LARGEST_PX:
            inputs = ", ".join(f"{one.name} {tuple(one.shape)}" for one in given)
            raise UserError(
                f"{path} takes {inputs}; a network for the whole picture must take a square (1, 3, side, side)"
            )
        (self._edge,) = sides
        self._input = given[0].name
        points = self._run(np.full((self._edge, self._edge, 3), _BEYOND, np.uint8))[1]
        self.layout = network_layout(points.shape[1], layout, path)
        self.note = path.stem
        theirs = LAYOUTS[self.layout].keypoints
        self._shared = np.array([(theirs.index(k), _LANDMARKS.index(k)) for k in theirs if k in _LANDMARKS]).reshape(
            -1, 2
        )

    def look(self, picture: Num[np.ndarray, "H W 3"], landmarks: Num[np.ndarray, "33 2"]) -> Num[np.ndarray, "K 3"]:
        """Points x, y in pixels of ``picture`` (RGB, centres at +0.5) and score in [0, 1] for the person with
        BlazePose's ``landmarks``; NaN where the network detects no such person."""
        low, high = landmarks.min(0), landmarks.max(0)
        side = max(_MARGIN * float((high - low).max()), 1.0)
        square = sample_region(picture, Region((low + high) / 2, side, 0.0), self._edge)
        scale, corner = side / self._edge, (low + high) / 2 - side / 2
        middles = corner + scale * (np.arange(self._edge)[:, None] + 0.5)
        beyond = (middles < 0) | (middles > [picture.shape[1], picture.shape[0]])
        square[:, beyond[:, 0]] = square[beyond[:, 1]] = _BEYOND
        boxes, found = self._run(square)
        found = found[boxes[:, 4] >= _MIN_SCORE]
        nobody = np.full((len(LAYOUTS[self.layout].keypoints), 3), np.nan)
        if not len(found):
            return nobody
        places = corner + scale * (found[..., :2] + 0.5)
        agreement = landmark_agreements(places[:, self._shared[:, 0]], landmarks[self._shared[:, 1]])
        best = int(agreement.argmax())
        if agreement[best] < _MIN_AGREEMENT:
            return nobody
        return np.column_stack([places[best], np.clip(found[best, :, 2], 0, 1)])

    def _run(self, square: np.ndarray) -> list[np.ndarray]:
        """Boxes (N, 5) and points (N, K, 3) in pixels of an RGB square, the first one's centre at 0."""
        bgr = square[..., ::-1].transpose(2, 0, 1)[None].astype(np.float32)
        answer = [out[0].astype(np.float64) for out in self._session.run(None, {self._input: bgr})]
        return sorted(answer, key=lambda out: out.ndim)


def landmark_agreements(places: Num[np.ndarray, "N S 2"], landmarks: Num[np.ndarray, "S 2"]) -> Num[np.ndarray, " N"]:
    """Agreement of N people's points with landmarks, 0 to 1: points off by a tenth of the body's extent give 0.37."""
    if not len(landmarks):
        return np.zeros(len(places))
    reach = _NEAR_SHARE * max(float(np.linalg.norm(np.ptp(landmarks, axis=0))), 1e-6)
    return np.exp(-(((places - landmarks) / reach) ** 2).sum(-1)).mean(-1)
