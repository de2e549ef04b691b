# SPDX-License-Identifier: Apache-2.0
"""Labels of every pixel of a frame: 0 background, k + 1 person k, 255 foreground that belongs to no fitted person.

Three sources of evidence, added as log-odds: the difference from the clean plate, the distance inside a fitted body's
outline, and the detector's own mask, where it detected people. Where the plate is unknown, GrabCut, seeded by the body,
replaces it. Bodies in front hide those behind, by their depth at the pixel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.body.model import BodyModel
from studiorecon.configuration.setting import setting
from studiorecon.footage.video import read_frames, to_float
from studiorecon.images.palette import UNASSIGNED
from studiorecon.images.regions import signed_distance_px, without_holes, without_islands
from studiorecon.images.silhouette import front_person, mesh_depth
from studiorecon.masks.detector_masks import DetectorMasks
from studiorecon.masks.grabcut import CutSettings, cut_unknown
from studiorecon.masks.log_odds import (
    DifferenceSettings,
    Plate,
    body_evidence,
    colour_difference,
    difference_evidence,
    temporal_difference,
)
from studiorecon.masks.loose_objects import subtract_objects
from studiorecon.progress import progress
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import Factors
from studiorecon.scene.people import Person
from studiorecon.splatting.rigid_object import RigidObject

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class OutlineSettings:
    """Evidence of a fitted body.

    Attributes:
        sigma_m: distance from its outline that adds one to the log-odds: error of the fit plus thickness of clothes.
        gate_m: pixels farther from a body than this are not that person.
        inside, outside: largest log-odds of the body alone for, and against, a person.
    """

    sigma_m: float = 0.015
    gate_m: float = 0.2
    inside: float = 3.0
    outside: float = 3.0


@dataclass(frozen=True)
class Settings:
    """Settings of the masks.

    Attributes:
        difference: see ``DifferenceSettings``.
        outline: see ``OutlineSettings``.
        island_share, hole_share: parts of a person below this share of the person are removed, gaps filled.
        unassigned_share: foreground away from all bodies counts from this share of the picture on.
    """

    difference: DifferenceSettings = DifferenceSettings()
    outline: OutlineSettings = OutlineSettings()
    smooth_px: int = setting(
        1,
        "Radius of the edge-preserving average of the evidence; 0 = none.",
        unit="px",
        minimum=0,
        maximum=100,
    )
    cut: CutSettings = setting(CutSettings(), "GrabCut where the plate is unknown.")
    island_share: float = 0.02
    hole_share: float = 0.002
    unassigned_share: float = 0.0005


def person_evidence(
    depths_m: Float[np.ndarray, "K H W"], camera: Camera, valid: Sequence[bool], settings: OutlineSettings
) -> tuple[Float[np.ndarray, "K H W"], Float[np.ndarray, "K H W"]]:
    """Log-odds from each body's depth picture (0 = absent), and its signed distance in metres.

    A body that was filled in between measured frames (not ``valid``) is never evidence for a person, with doubled
    sigma.
    """
    evidence, distance = np.full(depths_m.shape, -np.inf, np.float32), np.full(depths_m.shape, -np.inf, np.float32)
    for k, depth_m in enumerate(depths_m):
        covered = depth_m > 0
        if not covered.any():
            continue
        metres_per_pixel = float(np.median(depth_m[covered])) / camera.focal_px[0]
        distance[k] = signed_distance_px(covered) * metres_per_pixel
        sigma_m = settings.sigma_m if valid[k] else 2 * settings.sigma_m
        evidence[k] = body_evidence(
            distance[k], sigma_m, settings.gate_m, settings.inside if valid[k] else 0.0, settings.outside
        )
    return evidence, distance


def segment_frame(
    rgb: Integer[np.ndarray, "H W 3"],
    difference: Float[np.ndarray, "H W"],
    plate: Plate,
    depths_m: Float[np.ndarray, "K H W"],
    camera: Camera,
    valid: Sequence[bool],
    settings: Settings,
    network: Float[np.ndarray, "H W"] | None = None,
) -> Integer[np.ndarray, "H W"]:
    """Labels of a picture; ``difference`` is its ``colour_difference`` to the plate, ``network`` the masks'
    log-odds."""
    seen = difference_evidence(difference, plate, settings.difference)
    bodies, distance_m = person_evidence(depths_m, camera, valid, settings.outline)
    labels = np.zeros(seen.shape, np.uint8)
    near_somebody = np.zeros(seen.shape, bool)
    if len(bodies):
        best = bodies.max(axis=0)
        near_somebody = np.isfinite(best)
        total = seen + best if network is None else seen + best + network
        total = cut_unknown(rgb, total, near_somebody & ~plate.measured, settings.cut)
        person = edge_aware_average(total, rgb, settings.smooth_px) > 0
        front = front_person(depths_m)
        owner = np.where(front > 0, front, distance_m.argmax(axis=0) + 1)
        for k in range(len(bodies)):
            own = person & (owner == k + 1)
            size = int(own.sum())
            labels[
                without_islands(without_holes(own, settings.hole_share * size), settings.island_share * size)
                & (labels == 0)
            ] = k + 1
    stranger = (seen > 2) & ~near_somebody
    stranger = cv2.morphologyEx(stranger.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    labels[without_islands(stranger, settings.unassigned_share * stranger.size) & (labels == 0)] = UNASSIGNED
    return labels


def edge_aware_average(
    evidence: Float[np.ndarray, "H W"], rgb: Integer[np.ndarray, "H W 3"], radius_px: int
) -> Float[np.ndarray, "H W"]:
    """Evidence averaged over ``radius_px`` without crossing edges of the picture; −inf stays −inf."""
    possible = np.isfinite(evidence)
    if radius_px <= 0 or not possible.any():
        return evidence
    bounded = np.where(possible, evidence, np.float32(-6))
    smooth = cv2.ximgproc.guidedFilter(rgb, bounded.astype(np.float32), radius_px, 0.02 * 255**2 / 100)
    return np.where(possible, smooth, -np.inf)


@dataclass(frozen=True)
class Film:
    """The frames of a camera, read again at every pass: a minute of them does not fit into memory.

    ``brightness`` has the factors, by ``camera``, to divide out of every frame.
    """

    video: Path
    camera: str
    count: int
    brightness: Factors

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Integer[np.ndarray, "H W 3"]]:
        return self.brightness.normalise_film(self.camera, read_frames(self.video, 0, self.count))


@dataclass(frozen=True)
class Bodies:
    """Depth of the fitted bodies of every frame, drawn again at every pass."""

    people: Sequence[Person]
    body: BodyModel
    camera: Camera
    count: int

    def __iter__(self) -> Iterator[Float[np.ndarray, "K H W"]]:
        return map(self.depths, range(self.count))

    def depths(self, frame: int) -> Float[np.ndarray, "K H W"]:
        """Z-depth of each body at one frame."""
        return body_depths(self.people, self.body, self.camera, frame)


def segment(
    frames: Film | Integer[np.ndarray, "T H W 3"],
    plate_rgb: Float[np.ndarray, "H W 3"],
    measured: Bool[np.ndarray, "H W"],
    bodies: Bodies,
    settings: Settings,
    things: Sequence[RigidObject] = (),
    seen: DetectorMasks | None = None,
) -> Iterator[Integer[np.ndarray, "H W"]]:
    """Labels of every frame; pixels of ``things`` are unassigned; ``seen``: the detector's masks."""
    plate = Plate(plate_rgb, measured, np.zeros(measured.shape, np.float32))
    # Number of pictures that measure the plate's unrest.
    chosen = spread_indices(len(frames), 12)
    free = []
    for t in chosen:
        distances = person_evidence(bodies.depths(t), bodies.camera, [True] * len(bodies.people), settings.outline)[1]
        free.append(measured & (distances.max(axis=0, initial=-np.inf) < -settings.outline.gate_m))
    wanted = set(chosen.tolist())
    picked = (frame for t, frame in enumerate(frames) if t in wanted)
    differences = np.stack([colour_difference(to_float(frame), plate_rgb, settings.difference) for frame in picked])
    plate = Plate(plate_rgb, measured, temporal_difference(differences, np.stack(free)))
    for t, frame in enumerate(progress(frames, "masks")):
        difference = colour_difference(to_float(frame), plate_rgb, settings.difference)
        depths_m = bodies.depths(t)
        network = seen.evidence(t, [p.name for p in bodies.people]) if seen else None
        fitted = [bool(p.valid[t]) for p in bodies.people]
        labels = segment_frame(frame, difference, plate, depths_m, bodies.camera, fitted, settings, network)
        yield subtract_objects(labels, things, depths_m, bodies.camera, t)


def body_depths(people: Sequence[Person], body: BodyModel, camera: Camera, frame: int) -> Float[np.ndarray, "K H W"]:
    """Float32 z-depth of each fitted body at one frame, 0 outside of it; empty for people who are away."""
    depths = np.zeros((len(people), *camera.hw), np.float32)
    for k, person in enumerate(people):
        if not person.present[frame]:
            continue
        vertices_m = body.vertices(person.poses[frame : frame + 1], person.betas, person.trans[frame : frame + 1])[0]
        depths[k] = mesh_depth(vertices_m, body.faces, camera)
    return depths
