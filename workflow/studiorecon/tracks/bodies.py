# SPDX-License-Identifier: Apache-2.0
"""``tracks.bodies``: converts a network's bodies of one camera, or a file of them, to detections with 2D points, poses
and pelvis depth.

It replaces ``tracks.keypoints`` when there are no keypoint files, and gives the input of the paper's association.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.video import read_frames
from studiorecon.keypoints.detections import DetectionLimits
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.resampling import at_working_moments
from studiorecon.machine.libraries import install_remedy
from studiorecon.models.catalogue.selection import CHOICES
from studiorecon.models.choices import DetectionSource
from studiorecon.models.loading import adapter, load
from studiorecon.models.protocols import Bodies, BodyEstimator
from studiorecon.progress import progress, say, warn
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.people import Detections, write_detections
from studiorecon.scene.user_files import file_size, first_line, read_npz, user_file_context
from studiorecon.signature import Place, Written


@dataclass(frozen=True)
class Settings(DetectionLimits):
    """The source of bodies, and the smallest number of points."""

    source: DetectionSource = setting(
        "auto",
        "auto = keypoint files where a camera has them, else the detector; detector, keypoints = "
        "always these; comotion = the paper's network; precomputed = its files.",
        paper="CoMotion",
        paper_value="comotion",
    )


def load_estimator(source: DetectionSource) -> type[BodyEstimator]:
    """The network of that name; the first one for precomputed files, which use its names."""
    networks = CHOICES["detect.source"].networks
    return adapter("body estimator", source if source in networks else networks[0])


def detections_from_bodies(
    bodies: Iterable[tuple[int, Bodies]], layout: str, footage: Footage, settings: Settings
) -> Detections:
    """Detections from (frame, bodies) whose points are those of ``layout``.

    Points outside the picture, and bodies with too few points inside, are left out.
    """
    frames, tracks, points, poses, pelvises, shapes = [], [], [], [], [], []
    outside, behind = 0, 0
    for frame, found in bodies:
        for k in range(len(found.tracks)):
            inside = ((found.joints_px[k] > 0) & (found.joints_px[k] < footage.wh)).all(axis=-1)
            sure = float(found.confidences[k])
            outside += int(inside.sum() < settings.min_keypoints)
            behind += int(found.pelvises_m[k, 2] <= 0)
            if inside.sum() < settings.min_keypoints or sure < settings.min_confidence or found.pelvises_m[k, 2] <= 0:
                continue
            frames.append(frame)
            tracks.append(int(found.tracks[k]))
            pixels = np.where(inside[:, None], found.joints_px[k], np.nan)
            points.append(np.concatenate([pixels, np.where(inside, sure, 0.0)[:, None]], axis=-1))
            poses.append(found.poses_rad[k])
            shapes.append(found.shapes[k])
            pelvises.append([*found.joints_px[k, 0], found.pelvises_m[k, 2]])
    count = len(frames)
    if outside or behind:
        warn(f"camera {footage.camera}: {outside} bodies outside of its picture and {behind} behind it were left out")
    turned = np.array(poses, dtype=np.float64).reshape(count, 24, 3)
    return Detections(
        footage.camera,
        layout,
        np.array(frames, dtype=np.int64),
        np.array(tracks, dtype=np.int64),
        np.array(points, dtype=np.float64).reshape(count, len(LAYOUTS[layout].keypoints), 3),
        turned[:, 1:],
        np.array(pelvises, dtype=np.float64).reshape(count, 3),
        turned[:, 0],
        np.array(shapes, dtype=np.float64).reshape(count, 10),
    )


def require_used_frames(bodies: Iterable[tuple[int, Bodies]], frames: int, what: str) -> Iterator[tuple[int, Bodies]]:
    """The same bodies, one by one; raises UserError for bodies of a frame that is not used."""
    for frame, found in bodies:
        if not 0 <= frame < frames:
            raise UserError(f"{what} has bodies at frame {frame}, but {frames} frames are in use; they count from 0")
        yield frame, found


def read_bodies(path: Path, estimator: type[BodyEstimator]) -> list[tuple[int, Bodies]]:
    """(frame, bodies) of a file (npz, or a .pt of tensors) with the network's own names, one row per person and frame.

    Raises UserError with the file's name.
    """
    rows = _rows(path)
    for name, values in rows.items():
        if values.dtype.kind not in "biuf" or not np.isfinite(values).all():
            raise UserError(f"{path}: {name} holds numbers that are not finite; remove those rows")
    with user_file_context(path, "a file of one row per person and frame"):
        return estimator.read_stored(rows, str(path))


def _rows(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".npz":
        return read_npz(path)
    try:
        import torch
    except ModuleNotFoundError:
        raise UserError(
            f"{path} is a torch file and torch is not installed ({install_remedy('torch')}); or save it as .npz"
        ) from None
    file_size(path)
    try:
        saved: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # damage can raise any error in the unpickler
        raise UserError(
            f"{path} is not a readable torch file ({first_line(error)}); save a dictionary of tensors, or an .npz"
        ) from None
    with user_file_context(path, "a dictionary of tensors"):
        return {str(name): values.numpy() for name, values in saved.items()}


def run(
    settings: Settings,
    camera: str,
    video: Path,
    footage: Path,
    clocks: Path,
    given: list[Path],
    weights: Place,
    device: str,
    detections: Written,
) -> None:
    """Write the detections of one camera's working frames, by the network or from ``given`` (none or one file).

    ``clocks`` give the time error of each picture: keypoints are corrected for it, bodies stay those of the picture.
    """
    about = read_footage(footage)
    estimator = load_estimator(settings.source)
    bodies: Iterable[tuple[int, Bodies]]
    if given:
        bodies = read_bodies(given[0], estimator)
    else:
        network = load("body estimator", settings.source, weights, device)
        frames = progress(read_frames(video), f"frames of {camera}", total=about.frames)
        bodies = enumerate(network.bodies(frames, np.array(about.intrinsics)))
    within = require_used_frames(bodies, about.frames, str(given[0]) if given else camera)
    seen_in_pictures = detections_from_bodies(within, estimator.layout, about, settings)
    result = at_working_moments(seen_in_pictures, read_clocks(clocks), about.wh[1])
    if not len(result.frame):
        say(f"camera {camera}: no person in {about.frames} frames")
    seen = len(np.unique(result.frame))
    say(
        f"camera {camera}: {len(result.frame)} bodies in {seen} of {about.frames} "
        f"frames, {len(np.unique(result.track))} tracks"
    )
    write_detections(detections, result)
