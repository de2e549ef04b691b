# SPDX-License-Identifier: Apache-2.0
"""``people.bodies``: a network's bodies of one camera, or a file of them, as detections with 2D points, poses and pelvis depth.

It takes the place of ``people.detections`` where no keypoint files are there, and is what the paper's association works on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.video import read_frames
from studiorecon.libraries import remedy
from studiorecon.models import comotion
from studiorecon.models.comotion import Comotion
from studiorecon.models.protocols import Bodies
from studiorecon.progress import progress, say
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.people import Detections, write_detections

LAYOUT = "comotion27"
_KEYS = ("id", "frame_idx", "pose", "betas", "trans", "pred_2d", "pred_3d")


@dataclass(frozen=True)
class Settings:
    """Where bodies come from, and how few points are too few; see config.yaml."""

    source: Literal["auto", "keypoints", "detector", "comotion", "precomputed"]
    detection_confidence: float
    detection_keypoints: int


def detections_of(bodies: Iterable[tuple[int, Bodies]], footage: Footage, settings: Settings) -> Detections:
    """Detections from (frame, bodies); points outside the picture, and bodies with too few points inside, are left out."""
    frames, tracks, points, poses, pelvises, shapes = [], [], [], [], [], []
    for frame, found in bodies:
        for k in range(len(found.tracks)):
            inside = ((found.joints_px[k] >= 0) & (found.joints_px[k] <= footage.wh)).all(axis=-1)
            sure = float(found.confidences[k])
            if inside.sum() < settings.detection_keypoints or sure < settings.detection_confidence or found.pelvises_m[k, 2] <= 0:
                continue
            frames.append(frame)
            tracks.append(int(found.tracks[k]))
            pixels = np.where(inside[:, None], found.joints_px[k], np.nan)
            points.append(np.concatenate([pixels, np.where(inside, sure, 0.0)[:, None]], axis=-1))
            poses.append(found.poses_rad[k])
            shapes.append(found.shapes[k])
            pelvises.append([*found.joints_px[k, 0], found.pelvises_m[k, 2]])
    count = len(frames)
    turned = np.array(poses, dtype=np.float64).reshape(count, 24, 3)
    return Detections(
        footage.camera,
        LAYOUT,
        np.array(frames, dtype=np.int64),
        np.array(tracks, dtype=np.int64),
        np.array(points, dtype=np.float64).reshape(count, comotion.JOINTS, 3),
        turned[:, 1:],
        np.array(pelvises, dtype=np.float64).reshape(count, 3),
        turned[:, 0],
        np.array(shapes, dtype=np.float64).reshape(count, 10),
    )


def read_bodies(path: Path) -> list[tuple[int, Bodies]]:
    """(frame, bodies) of a file (npz, or a .pt of tensors) with CoMotion's names, one row per person and frame.

    Needed: id, frame_idx, pose (72), betas (10), trans (3), pred_2d (27, 2) in working pixels, pred_3d (27, 3); conf (logits) if there.
    CoMotion's own demo leaves the points out: they have to be written too. Raises Refusal naming the file.
    """
    rows = _rows(path)
    missing = [key for key in _KEYS if key not in rows]
    if missing:
        raise Refusal(f"{path} holds no {', '.join(missing)}; write them too (CoMotion's demo drops its 2D and 3D points)")
    count = len(rows["frame_idx"])
    logits = rows["conf"].reshape(count) if "conf" in rows else np.full(count, 10.0)
    found = []
    for frame in np.unique(rows["frame_idx"]):
        own = np.flatnonzero(rows["frame_idx"] == frame)
        slots = {key: rows[key][own] for key in _KEYS if key != "frame_idx"}
        slots["id"] = slots["id"].reshape(len(own))
        slots["pose"] = slots["pose"].reshape(len(own), -1)
        found.append((int(frame), comotion.post(slots, slots["pred_2d"], logits[own])))
    return found


def _rows(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    try:
        import torch
    except ModuleNotFoundError:
        raise Refusal(f"{path} is a torch file and torch is not installed ({remedy('torch')}); or save it as .npz") from None
    stored: Any = torch.load(path, map_location="cpu", weights_only=True)
    return {name: values.numpy() for name, values in stored.items()}


def run(
    settings: Settings, camera: str, video: Path, footage: Path, given: list[Path], weights: Path, device: str, detections: Path
) -> None:
    """Write the detections of one camera's working frames, by CoMotion or from ``given`` (none or one file)."""
    about = read_footage(footage)
    if given:
        bodies = read_bodies(given[0])
    else:
        network = Comotion(weights, device)
        frames = progress(read_frames(video), f"frames of {camera}", total=about.frames)
        bodies = list(enumerate(network.bodies(frames, np.array(about.intrinsics))))
    if beyond := [frame for frame, _ in bodies if not 0 <= frame < about.frames]:
        raise Refusal(
            f"{given[0] if given else camera} has bodies at frame {beyond[0]}, but {about.frames} frames are in use; they count from 0"
        )
    result = detections_of(bodies, about, settings)
    if not len(result.frame):
        say(f"camera {camera}: nobody in any of {about.frames} frames")
    seen = len(np.unique(result.frame))
    say(f"camera {camera}: {len(result.frame)} bodies in {seen} of {about.frames} frames, {len(np.unique(result.track))} tracks")
    write_detections(detections, result)
