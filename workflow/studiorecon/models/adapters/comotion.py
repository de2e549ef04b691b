# SPDX-License-Identifier: Apache-2.0
"""CoMotion (Newell et al., ICLR 2025): the SMPL bodies of all people in every frame of one camera, tracked over time.

Used as a class, with the camera's own intrinsics: its command line assumes a focal length of twice the longer side,
which also determines depth. Upstream does not detect cuts, so a clip must have none. Its 2D points are projections of
its own bodies: a monocular prior, not evidence. Tracks are cleaned up after the whole clip, as upstream's demo does.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.models import smpl
from studiorecon.models.adapters.pi3 import sigmoid
from studiorecon.models.catalogue.card import Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    import_upstream,
    other_version,
    require_finite,
    staged_weights,
    torch_device,
)
from studiorecon.models.protocols import Bodies
from studiorecon.progress import warn
from studiorecon.scene.schema import check, metres, radians, real

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num, Shaped

CARD = Card(
    name="comotion",
    title="CoMotion",
    kind="body estimator",
    terms=Terms(
        code="Apple sample code licence",
        weights="Apple machine learning research model licence",
        commercial="no",
        condition="research-only weights; needs SMPL",
        alternative="keypoints, with files of a detector whose terms allow it",
    ),
    weights=(
        WeightFile(
            "comotion/comotion_detection_checkpoint.pt",
            "Apple, models/comotion/demo_checkpoints.tar.gz",
            how="hand",
        ),
        WeightFile(
            "comotion/comotion_refine_checkpoint.pt", "Apple, models/comotion/demo_checkpoints.tar.gz", how="hand"
        ),
        WeightFile("smpl/SMPL_NEUTRAL.pkl", "SMPL v1.1.0, by registration with MPI", how="hand", gated=True),
    ),
    runtime=Runtime(
        image="comotion",
        python="3.10",
        torch="2.5.1",
        pins=("transformers==4.48.0", "timm==1.0.13", "scenedetect<0.7", "chumpy from git"),
        commit="adb7e22",
    ),
    memory=Memory(6.0, "one 512 pixel frame at a time; our estimate"),
    tried="random weights",
    unchecked="SMPL's file",
    instead="set detect.source to keypoints and bring keypoint files",
)
CARDS = (CARD,)


JOINTS = 27
"""SMPL's first 22, then nose, right eye, left eye, right ear, left ear."""
UNSEEN = 0.1
"""Confidence of a body that is extrapolated where nothing was detected."""
# A detection belongs to a track when their points are this near, as a share of the body's box diagonal.
_SAME = 0.15
# Nobody is a hundred standard deviations from the mean shape.
_ROWS = {
    "pose": radians("N 72"), "betas": real("N 10", low=-100, high=100), "trans": metres("N 3"),
    "pred_2d": real("N 27 2"), "pred_3d": metres("N 27 3"),
}  # fmt: skip
# Ids become tracks, whose parts are numbered from a million on; a million frames are hours.
_MAX_NUMBER = 10**6 - 1
_STATE = ("id", "betas", "pose", "trans")
_STORED = ("id", "frame_idx", "pose", "betas", "trans", "pred_2d", "pred_3d")
_FIELDS = {"id": (), "pose": (72,), "betas": (10,), "trans": (3,), "pred_3d": (JOINTS, 3), "pred_2d": (JOINTS, 2)}


def preprocess(
    frame: Integer[np.ndarray, "H W 3"], intrinsics: Num[np.ndarray, "3 3"]
) -> tuple[Integer[np.ndarray, "3 H W"], Float[np.ndarray, "2 3"]]:
    """Uint8 RGB and float32 intrinsics; upstream's default principal point is W/2, so centres are at +0.5 as here."""
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
        raise ValueError(f"frame is {frame.dtype} of shape {frame.shape}, expected uint8 (H, W, 3)")
    return np.ascontiguousarray(frame.transpose(2, 0, 1)), np.asarray(intrinsics, dtype=np.float32)[:2]


def postprocess(
    tracks: dict[str, Shaped[np.ndarray, " ..."]], detected_px: Num[np.ndarray, "n 27 2"], logits: Num[np.ndarray, " n"]
) -> Bodies:
    """The bodies of one frame from the state of all track slots; slots with id 0 are empty.

    A track has the confidence (``logits``) of the detection in ``detected_px`` that it overlaps. Raises UserError for
    fields of another shape or non-finite values.
    """
    for name, shape in _FIELDS.items():
        if name not in tracks or tracks[name].shape[1:] != shape:
            found = tracks[name].shape if name in tracks else "nothing"
            raise other_version(CARD, f"returned {found} as {name}, expected (slots, {', '.join(map(str, shape))})")
    used = tracks["id"] > 0
    own = {name: require_finite(CARD, name, values[used]) for name, values in tracks.items()}
    joints = own["pred_2d"].astype(np.float64)
    sure = np.full(len(joints), UNSEEN)
    if len(detected_px) and len(joints):
        size = np.linalg.norm(joints.max(axis=1) - joints.min(axis=1), axis=-1)
        apart = np.median(np.linalg.norm(joints[:, None] - detected_px[None], axis=-1), axis=-1)
        nearest = apart.argmin(axis=1)
        is_same = apart[np.arange(len(joints)), nearest] <= _SAME * np.maximum(size, 1.0)
        sure = np.where(is_same, np.maximum(sigmoid(logits)[nearest], UNSEEN), UNSEEN)
    return Bodies(
        tracks=own["id"].astype(np.int64) - 1,
        shapes=own["betas"].astype(np.float64),
        poses_rad=own["pose"].astype(np.float64).reshape(-1, 24, 3),
        translations_m=own["trans"].astype(np.float64),
        pelvises_m=own["pred_3d"][:, 0].astype(np.float64),
        joints_px=joints,
        confidences=sure,
    )


def read_bodies(rows: Mapping[str, Shaped[np.ndarray, " ..."]], where: str) -> list[tuple[int, Bodies]]:
    """(frame, bodies) from arrays with one row per person and frame; ``where`` names them in messages.

    Needed: id, frame_idx, pose (72), betas (10), trans (3), pred_2d (27, 2) in working pixels, pred_3d (27, 3); conf
    (logits) is optional. CoMotion's own demo does not write the points. Raises UserError for missing arrays.
    """
    missing = [key for key in _STORED if key not in rows]
    if missing:
        raise UserError(
            f"{where} holds no {', '.join(missing)}; write them too (CoMotion's demo drops its 2D and 3D points)"
        )
    count, whole = len(rows["frame_idx"]), dict(rows)
    for key, shape in {"frame_idx": (), **_FIELDS}.items():
        if rows[key].size != count * math.prod(shape) or len(rows[key]) != count:
            raise UserError(f"{where}: {key} is {rows[key].shape}, expected {(count, *shape)}; write one row a body")
        whole[key] = rows[key].reshape(count, *shape)
        if shape:
            check(whole[key], _ROWS[key], key)
        if not shape and ((whole[key] % 1 != 0) | (whole[key] < 0) | (whole[key] > _MAX_NUMBER)).any():
            raise UserError(f"{where}: {key} must be whole numbers from 0 to {_MAX_NUMBER}; write the network's own")
    if empty := int((whole["id"] == 0).sum()):
        warn(f"{where}: {empty} of {count} rows have id 0, which is an empty slot, and are left out; count from 1")
    if "conf" not in rows:
        warn(f"{where} has no conf: all of its bodies count as sure")
    logits = rows["conf"].reshape(count) if "conf" in rows else np.full(count, 10.0)
    found = []
    for frame in np.unique(whole["frame_idx"]):
        own = np.flatnonzero(whole["frame_idx"] == frame)
        slots = {key: whole[key][own] for key in _FIELDS}
        found.append((int(frame), postprocess(slots, slots["pred_2d"], logits[own])))
    return found


@dataclass(frozen=True)
class _Arrays:
    """Replaces ``pickle`` where upstream reads SMPL's file: it returns arrays and runs no other code."""

    body: Path

    def load(self, stream: Any, **_: Any) -> dict[str, np.ndarray]:
        return smpl.postprocess(smpl.read_pickle(self.body), self.body)


class Comotion:
    """Detector and tracker, loaded once; satisfies ``BodyEstimator``. Weights: ``comotion/`` and ``smpl/``.

    Upstream searches its own package (``comotion_demo/data``) for its files: links there must point to the weights
    folder.
    """

    layout = "comotion27"

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        staged_weights(card, weights)
        try:
            # Upstream opens SMPL's file at import, and the checkpoints when the network is created.
            module = import_upstream(card, "comotion_demo.models.comotion")
            # Upstream unpickles SMPL's file unchecked, and would run any code in it.
            body = weights / "smpl/SMPL_NEUTRAL.pkl"
            import_upstream(card, "comotion_demo.utils.smpl_kinematics").pickle = _Arrays(body)
            self._device = torch_device(card, where)
            self._network = attribute(card, module, "CoMotion")(use_coreml=False, pretrained=True)
        except (FileNotFoundError, AssertionError) as error:
            reason = next(iter(str(error).splitlines()), "no reason given")
            raise UserError(
                f"CoMotion does not find its files in its own package ({reason}); link {weights / 'comotion'}/*.pt and "
                f"{weights / 'smpl/SMPL_NEUTRAL.pkl'} to comotion_demo/data and comotion_demo/data/smpl, which keeps "
                "what it holds"
            ) from None
        self._network.to(self._device).eval()

    @staticmethod
    def read_stored(rows: Mapping[str, Shaped[np.ndarray, " ..."]], where: str) -> list[tuple[int, Bodies]]:
        """The stored bodies; see ``models.protocols.BodyEstimator``."""
        return read_bodies(rows, where)

    def bodies(
        self, frames: Iterable[Integer[np.ndarray, "H W 3"]], intrinsics: Num[np.ndarray, "3 3"]
    ) -> Iterator[Bodies]:
        """The bodies of every frame; see ``models.protocols.BodyEstimator``. The clip is searched before the first."""
        states, inputs = [], None
        for frame in frames:
            if inputs is None:
                self._network.init_tracks(frame.shape[:2])
            picture, inputs = preprocess(frame, intrinsics)
            states.append(estimate_frame(self._network, picture, inputs))
        spans = {} if inputs is None else clean_up(self._network, states, inputs)
        for number, (slots, points, logits) in enumerate(states):
            kept = [start <= number < end for start, end in (spans.get(int(track), (0, 0)) for track in slots["id"])]
            yield postprocess({**slots, "id": np.where(kept, slots["id"], 0)}, points, logits)


def clean_up(
    network: Any,
    states: Sequence[tuple[dict[str, Shaped[np.ndarray, " ..."]], Num[np.ndarray, "n 27 2"], Num[np.ndarray, " n"]]],
    intrinsics: Float[np.ndarray, "2 3"],
) -> dict[int, tuple[int, int]]:
    """The first frame and the end of every track to keep, by upstream's ``cleanup_tracks`` with its demo's value.

    A track begins and ends with a detection that is no other track's; one without any is left out. ``states`` are
    those of ``estimate_frame``, one per frame of the clip.
    """
    if not any(len(points) for _, points, _ in states):
        return {}  # upstream's function needs one detection
    import torch

    clean = attribute(CARD, import_upstream(CARD, "comotion_demo.utils.track"), "cleanup_tracks")
    tracks = {name: torch.from_numpy(np.stack([slots[name] for slots, *_ in states]))[None] for name in _STATE}
    tracks["id"] = tracks["id"][..., None]
    detections = {
        "pred_2d": [torch.from_numpy(points)[None] for _, points, _ in states],
        "conf": [torch.from_numpy(logits)[None, :, None] for *_, logits in states],
    }
    # A copy, since upstream's ``.cpu()`` would take the decoder from a network on a GPU.
    decoder = copy.deepcopy(network.smpl_decoder).cpu()
    with torch.inference_mode():
        spans = clean(
            {"detections": detections, "tracks": tracks}, torch.from_numpy(intrinsics), decoder, min_matched_frames=1
        )
    return {int(track): (int(first), int(end)) for track, (first, end) in spans.items()}


def estimate_frame(
    network: Any, picture: Integer[np.ndarray, "3 H W"], intrinsics: Float[np.ndarray, "2 3"]
) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], Num[np.ndarray, "n 27 2"], Num[np.ndarray, " n"]]:
    """State of the track slots, and points and logits of the detections, of the next frame of a clip."""
    import torch

    with torch.inference_mode():
        detections, state = network(torch.from_numpy(picture), torch.from_numpy(intrinsics))
    slots = {name: getattr(state, name)[0].float().cpu().numpy() for name in _FIELDS}
    slots["id"] = slots["id"][:, 0]
    points, logits = (detections[key][0].float().cpu().numpy() for key in ("pred_2d", "conf"))
    return slots, points, logits[:, 0]


ADAPTER = Comotion
