# SPDX-License-Identifier: Apache-2.0
"""``calibration.network``: estimates uncalibrated cameras by an upstream network (the paper's way), as a COLMAP model.

The network sees one picture of every camera. Its depth maps are stored too, in metres: people are lifted by them. Its
unit is converted to metres by people's torsos, measured between keypoints on its own depth. ``calibration.files`` then
reads the model like any other and determines the up direction; ``cameras.refine`` refines it on the people.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import open_source
from studiorecon.geometry.triangulation import Limits
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.resampling import resample_keypoints
from studiorecon.models.catalogue.registry import find_card as card_of
from studiorecon.models.choices import CalibrationSource
from studiorecon.models.loading import load
from studiorecon.models.protocols import Reconstruction
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Float

TORSO = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
# Torsos of one scene that differ by more than this factor do not measure the same unit.
_WIDEST = 1.6


@dataclass(frozen=True)
class Settings:
    """Which network, and the least confidence of a keypoint."""

    source: CalibrationSource = setting(
        "auto",
        "files; people = keypoints alone; a network on the first pictures; auto = files if there are any, else people.",
        paper="Pi3",
        paper_value="pi3",
    )
    limits: Limits = Limits()


def torso_lengths(
    found: Reconstruction, wh: Sequence[tuple[int, int]], detections: Sequence[Detections], sure: float
) -> Float[np.ndarray, " L"]:
    """Distances from the middle of the shoulders to that of the hips of all people at frame 0, in the network's unit.

    ``wh`` is the size of the pictures of the cameras ``found`` by the network, to which the keypoints refer. Both
    middles have the median depth of their points' surfaces, so a keypoint on a jump in depth does no harm.
    """
    lengths, at = [], {camera.name: k for k, camera in enumerate(found.cameras)}
    for seen in detections:
        k = at[seen.camera]
        camera, depth, size = found.cameras[k], found.depths[k], wh[k]
        layout = LAYOUTS[seen.layout]
        if not set(TORSO) <= set(layout.keypoints):
            continue
        chosen = [layout.index(name) for name in TORSO]
        for person in seen.keypoints[seen.frame == 0][:, chosen]:
            pixels = person[:, :2] * np.array(camera.wh) / np.array(size)
            inside = (person[:, 2] >= sure) & (pixels >= 0).all(-1) & (pixels < np.array(camera.wh)).all(-1)
            if not inside.all():
                continue
            columns, rows = np.floor(pixels).astype(int).T
            depths = depth[rows, columns]
            if (depths > 0).sum() < 3:
                continue
            points = camera.unproject(pixels, np.full(4, np.median(depths[depths > 0])))
            lengths.append(float(np.linalg.norm(points[:2].mean(axis=0) - points[2:].mean(axis=0))))
    return np.array(lengths)


def metres_per_unit(lengths: Float[np.ndarray, " L"], torso_m: float, metric: bool, title: str) -> tuple[float, str]:
    """Metres per unit of the network, and a sentence; UserError when undetermined."""
    usable = lengths[lengths > 0]
    if not len(usable):
        if metric:
            return (
                1.0,
                f"no person's torso could be measured, so {title}'s own metres are used; measure a "
                "length and set calibration.scale",
            )
        raise UserError(
            f"{title} has no unit, and no person's shoulders and hips are visible in the first "
            "frame: add keypoint files, set calibration.source to pi3x, which "
            "estimates metres, or add a calibration"
        )
    spread = float(np.percentile(usable, 75) / np.percentile(usable, 25))
    if spread > _WIDEST:
        raise UserError(
            f"lengths of torsos by {title} differ by a factor of {spread:.1f} within the scene, so "
            "its depth is wrong; bring a calibration"
        )
    factor = torso_m / float(np.median(usable))
    return (
        factor,
        f"one unit of {title} is {factor:.3g} m, by {len(usable)} torsos of "
        f"{torso_m:.2f} m; all lengths may be 5 % off",
    )


def in_metres(camera: Camera, wh: tuple[int, int], factor: float) -> Camera:
    """A network's camera at the size of the footage, with lengths multiplied by ``factor``."""
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= factor
    return replace(camera.resized(wh), camera_from_world=pose)


def run(
    settings: Settings,
    cameras: list[str],
    sources: list[Path],
    clocks: Path,
    sightings: list[Path],
    body: Path,
    weights: Place,
    device: str,
    model: Written,
    depths: list[Written],
) -> None:
    """Write a COLMAP text model of ``cameras`` from the first moment of their ``sources``.

    ``sightings`` may be empty, or one of each training camera. ``depths``: of every camera, EXR of that moment's depth
    in metres and the network's confidence, at its own size.
    """
    common = read_clocks(clocks)
    if common.refusal:
        raise UserError(common.refusal)
    pictures = [
        seek_frames(open_source(s, 0.0), [int(common.source_frames(c)[0])])[0]
        for c, s in zip(cameras, sources, strict=True)
    ]
    wh = [(picture.shape[1], picture.shape[0]) for picture in pictures]
    found = load("pose and depth", settings.source, weights, device).reconstruct(pictures, cameras)
    for camera, size, residual in zip(found.cameras, wh, found.focal_residuals_px):
        focal_px, share = camera.focal_px[0] * size[0] / camera.wh[0], residual / camera.wh[0]
        say(f"{camera.name}: focal length {focal_px:.0f} px, points off their pixels by {share:.2%} of the width")
    seen = [resample_keypoints(d, common, wh[cameras.index(d.camera)][1]) for d in map(read_detections, sightings)]
    lengths = torso_lengths(found, wh, seen, settings.limits.min_confidence)
    rest = BodyModel.load(body)
    torso = rest.keypoints(TORSO, np.zeros((1, 72)), np.zeros(rest.shapes), np.zeros((1, 3)))[0]
    torso_m = float(np.linalg.norm(torso[:2].mean(axis=0) - torso[2:].mean(axis=0)))
    factor, described = metres_per_unit(lengths, torso_m, found.metric, card_of(settings.source).title)
    say(described)
    for path, depth, sure in zip(depths, found.depths, found.confidences, strict=True):
        write_depth(path, factor * depth, sure)
    write_model(model.parent, [in_metres(camera, size, factor) for camera, size in zip(found.cameras, wh)])
