# SPDX-License-Identifier: Apache-2.0
"""CoMotion (Newell et al., ICLR 2025): everybody's SMPL body in every frame of one camera, followed through time.

Called as a class, with the camera's own intrinsics: its command line assumes a focal length of twice the longer side, and depth with it.
Cuts are not noticed upstream, so a clip must have none. Its 2D points are projections of its own bodies: a monocular prior, not evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.models.pi3 import probability
from studiorecon.models.preflight import attribute, device, finite, staged, upstream
from studiorecon.models.protocols import Bodies

JOINTS = 27
"""SMPL's first 22, then nose, right eye, left eye, right ear, left ear."""
UNSEEN = 0.1
"""Confidence of a body that is carried on where nothing was detected."""
_LOWER = "set people.source to keypoints and bring keypoint files"
# A detection is a track's own when their points are this near, as a share of the body's box diagonal.
_SAME = 0.15
_FIELDS = {"id": (), "pose": (72,), "betas": (10,), "trans": (3,), "pred_3d": (JOINTS, 3), "pred_2d": (JOINTS, 2)}


def pre(frame: np.ndarray, intrinsics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3, H, W) uint8 RGB and (2, 3) float32 intrinsics; upstream's default principal point is W/2, so centres are at +0.5 as here."""
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
        raise ValueError(f"frame is {frame.dtype} of shape {frame.shape}, expected uint8 (H, W, 3)")
    return np.ascontiguousarray(frame.transpose(2, 0, 1)), np.asarray(intrinsics, dtype=np.float32)[:2]


def post(tracks: dict[str, np.ndarray], detected_px: np.ndarray, logits: np.ndarray) -> Bodies:
    """The bodies of one frame from the state of all track slots, of which those with id 0 are empty.

    ``detected_px`` (n, 27, 2) and ``logits`` (n,) are the frame's detections: a track is as sure as the detection it lies on.
    Raises Refusal for fields of another shape or values that are no numbers.
    """
    for name, shape in _FIELDS.items():
        if name not in tracks or tracks[name].shape[1:] != shape:
            found = tracks[name].shape if name in tracks else "nothing"
            raise Refusal(
                f"CoMotion's tracks hold {found} as {name}, expected (slots, {', '.join(map(str, shape))}); use upstream at its pin"
            )
    used = tracks["id"] > 0
    own = {name: finite("comotion", name, values[used]) for name, values in tracks.items()}
    joints = own["pred_2d"].astype(np.float64)
    sure = np.full(len(joints), UNSEEN)
    if len(detected_px) and len(joints):
        size = np.linalg.norm(joints.max(axis=1) - joints.min(axis=1), axis=-1)
        apart = np.median(np.linalg.norm(joints[:, None] - detected_px[None], axis=-1), axis=-1)
        nearest = apart.argmin(axis=1)
        lies_on = apart[np.arange(len(joints)), nearest] <= _SAME * np.maximum(size, 1.0)
        sure = np.where(lies_on, np.maximum(probability(logits)[nearest], UNSEEN), UNSEEN)
    return Bodies(
        tracks=own["id"].astype(np.int64) - 1,
        shapes=own["betas"].astype(np.float64),
        poses_rad=own["pose"].astype(np.float64).reshape(-1, 24, 3),
        translations_m=own["trans"].astype(np.float64),
        pelvises_m=own["pred_3d"][:, 0].astype(np.float64),
        joints_px=joints,
        confidences=sure,
    )


class Comotion:
    """Detector and tracker, loaded once; satisfies ``BodyEstimator``. Weights: ``comotion/`` and ``smpl/`` below ``weights``.

    Upstream looks for its files in its own package (``comotion_demo/data``): links there have to point at the weights folder.
    """

    def __init__(self, weights: Path, where: str) -> None:
        staged("comotion", weights)
        module = upstream("comotion", "comotion_demo.models.comotion")
        self._device = device("comotion", where, _LOWER)
        try:
            self._network = attribute("comotion", module, "CoMotion")(use_coreml=False, pretrained=True)
        except (FileNotFoundError, AssertionError) as error:
            raise Refusal(
                f"CoMotion does not find its files in its own package ({str(error).splitlines()[0]}); link {weights / 'comotion'}/*.pt and "
                f"{weights / 'smpl'} into comotion_demo/data"
            ) from None
        self._network.to(self._device).eval()

    def bodies(self, frames: Iterable[np.ndarray], intrinsics: np.ndarray) -> Iterator[Bodies]:
        """See ``models.protocols.BodyEstimator``."""
        started = False
        for frame in frames:
            if not started:
                self._network.init_tracks(frame.shape[:2])
                started = True
            yield post(*estimated(self._network, *pre(frame, intrinsics)))


def estimated(network: Any, picture: np.ndarray, intrinsics: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """State of the track slots, and points and logits of the detections, of the next frame of a clip."""
    import torch

    with torch.inference_mode():
        detections, state = network(torch.from_numpy(picture), torch.from_numpy(intrinsics))
    slots = {name: getattr(state, name)[0].float().cpu().numpy() for name in _FIELDS}
    slots["id"] = slots["id"][:, 0]
    points, logits = (detections[key][0].float().cpu().numpy() for key in ("pred_2d", "conf"))
    return slots, points, logits[:, 0]
