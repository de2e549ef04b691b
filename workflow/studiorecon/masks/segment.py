# SPDX-License-Identifier: Apache-2.0
"""One camera's person masks: 0 background, k + 1 person k, 255 foreground that belongs to no fitted person.

Three sources of evidence, added as log-odds: the difference from the clean plate, the distance inside a fitted body's
outline, and the detector's own mask, where it detected people. Where the plate is unknown, GrabCut, seeded by the body,
replaces it. Bodies in front hide those behind, by their depth at the pixel. Given masks are used unchanged; only their
identities are matched to the fitted people.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import evenly_spread
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.calibration import find_lens
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames, to_float, write_lossless
from studiorecon.images.regions import signed_distance_px, without_holes, without_islands
from studiorecon.images.silhouette import front_person, mesh_depth
from studiorecon.masks.detector_masks import DetectorMasks, masks_by_frame
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
from studiorecon.masks.tracks import UNASSIGNED, assign_people
from studiorecon.masks.user_masks import label_given_masks, read_given
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_footage
from studiorecon.scene.factors import Factors, read_factors
from studiorecon.scene.people import Person, read_detections, read_identities
from studiorecon.scene.raw_detections import read_raw_detections
from studiorecon.signature import Written
from studiorecon.splatting.rigid_object import RigidObject, read_objects

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Number of pictures that measure the plate's unrest.
_UNREST_FRAMES = 12


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
        "Radius over which evidence is averaged without crossing edges of the picture; 0 = not at all.",
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
    """(K, H, W) log-odds from each body's depth picture (0 = absent), and (K, H, W) its signed distance in metres.

    A body that was filled in between measured frames (not ``valid``) is never evidence for a person, and its sigma is
    doubled.
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
    """(H, W) uint8 labels of a picture (H, W, 3) uint8; ``difference`` is its ``colour_difference`` to the plate.

    ``network``: (H, W) log-odds of the detector's masks, if there are any.
    """
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
    """(H, W) evidence averaged over ``radius_px`` without crossing edges of the picture; −inf stays −inf."""
    possible = np.isfinite(evidence)
    if radius_px <= 0 or not possible.any():
        return evidence
    bounded = np.where(possible, evidence, np.float32(-6))
    smooth = cv2.ximgproc.guidedFilter(rgb, bounded.astype(np.float32), radius_px, 0.02 * 255**2 / 100)
    return np.where(possible, smooth, -np.inf)


@dataclass(frozen=True)
class Film:
    """The frames of a camera, read again at every pass: a minute of them does not fit into memory.

    Attributes:
        video: the file.
        camera: its name in ``brightness``.
        count: number of frames.
        brightness: factors to divide out of every frame.
    """

    video: Path
    camera: str
    count: int
    brightness: Factors

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Integer[np.ndarray, "H W 3"]]:
        return self.brightness.even_all(self.camera, read_frames(self.video, 0, self.count))


@dataclass(frozen=True)
class Numbers:
    """A network's numbers of every frame (H, W), read again at every pass.

    Reading raises UserError for a film of another size or number of frames.
    """

    film: Path
    count: int
    hw: tuple[int, int]

    def __iter__(self) -> Iterator[Integer[np.ndarray, "H W"]]:
        number = -1
        for number, labels in enumerate(read_frames(self.film)):
            if labels.shape != self.hw or number >= self.count:
                break
            yield labels
        else:
            if number + 1 == self.count:
                return
        raise UserError(
            f"{self.film} is not of {self.count} frames of {self.hw[1]}×{self.hw[0]}, as the video is; run "
            "masks.network again"
        )


@dataclass(frozen=True)
class Bodies:
    """Depth (K, H, W) of the fitted bodies of every frame, drawn again at every pass."""

    people: Sequence[Person]
    body: BodyModel
    camera: Camera
    count: int

    def __iter__(self) -> Iterator[Float[np.ndarray, "K H W"]]:
        return (body_depths(self.people, self.body, self.camera, frame) for frame in range(self.count))


def segment(
    frames: Film | Integer[np.ndarray, "T H W 3"],
    plate_rgb: Float[np.ndarray, "H W 3"],
    measured: Bool[np.ndarray, "H W"],
    people: Sequence[Person],
    body: BodyModel,
    camera: Camera,
    settings: Settings,
    things: Sequence[RigidObject] = (),
    seen: DetectorMasks | None = None,
) -> Iterator[Integer[np.ndarray, "H W"]]:
    """(H, W) uint8 labels of every frame (T, H, W, 3) uint8; pixels of ``things`` are unassigned; ``seen``: the
    detector's masks."""
    plate = Plate(plate_rgb, measured, np.zeros(measured.shape, np.float32))
    chosen = evenly_spread(len(frames), _UNREST_FRAMES)
    free = []
    for t in chosen:
        distances = person_evidence(
            body_depths(people, body, camera, t), camera, [True] * len(people), settings.outline
        )[1]
        free.append(measured & (distances.max(axis=0, initial=-np.inf) < -settings.outline.gate_m))
    wanted = set(chosen.tolist())
    picked = (frame for t, frame in enumerate(frames) if t in wanted)
    differences = np.stack([colour_difference(to_float(frame), plate_rgb, settings.difference) for frame in picked])
    plate = Plate(plate_rgb, measured, temporal_difference(differences, np.stack(free)))
    for t, frame in enumerate(progress(frames, "masks")):
        difference = colour_difference(to_float(frame), plate_rgb, settings.difference)
        depths_m = body_depths(people, body, camera, t)
        network = seen.evidence(t, [p.name for p in people]) if seen else None
        labels = segment_frame(
            frame, difference, plate, depths_m, camera, [bool(p.valid[t]) for p in people], settings, network
        )
        yield subtract_objects(labels, things, depths_m, camera, t)


def body_depths(people: Sequence[Person], body: BodyModel, camera: Camera, frame: int) -> Float[np.ndarray, "K H W"]:
    """(K, H, W) float32 z-depth of each fitted body at one frame, 0 outside of it; empty for people who are away."""
    depths = np.zeros((len(people), *camera.hw), np.float32)
    for k, person in enumerate(people):
        if not person.present[frame]:
            continue
        vertices_m = body.vertices(person.poses[frame : frame + 1], person.betas, person.trans[frame : frame + 1])[0]
        depths[k] = mesh_depth(vertices_m, body.faces, camera)
    return depths


def run(
    settings: Settings,
    camera: str,
    model: Path,
    video: Path,
    plate: Path,
    footage: Path,
    calibration: Path,
    fits: list[Path],
    body: Path,
    given: list[Path],
    tracks: list[Path],
    masks: Written,
    objects: list[Path] | None = None,
    brightness: list[Path] | None = None,
    seen: list[Path] | None = None,
) -> None:
    """Write masks of ``camera`` for the fitted people, ``fits``, from frames divided by ``brightness``, if there is
    any.

    ``user_masks`` (none or one path) are the user's masks, which are kept; ``tracks`` (none or one) is a network's film
    of numbers. The pixels of ``objects`` (none or one path) are unassigned, except in given masks. ``seen`` (empty, or
    three files: the detector's, the camera's detections, identities.tsv) are the detector's own masks.
    """
    own = next((c for c in read_model(model.parent) if c.name == camera), None)
    if own is None:
        raise UserError(f"{model} has no camera {camera}; run cameras.refine again")
    persons = [read_person(path) for path in fits]
    body_model = BodyModel.load(body)
    about = read_footage(footage)
    frames = about.frames
    for path, fit in zip(fits, persons):
        if fit.body != body_model.identity or len(fit.poses) != frames:
            raise UserError(
                f"{path} holds {len(fit.poses)} frames of body {fit.body}, but the video "
                f"has {frames} frames and {body} is "
                f"{body_model.identity}; run people.fit again"
            )
    labels: Iterable[np.ndarray]
    if given:
        brought = read_given(given[0], footage, calibration, frames)
        depths = Bodies(persons, body_model, own, frames)
        labels, told = label_given_masks(brought, depths, len(persons), settings.outline.gate_m, own)
        say(f"{camera}: masks of {given[0].name} are used as they are; {told}")
    elif tracks:
        numbers = Numbers(tracks[0], frames, own.hw)
        labels, told = assign_people(numbers, Bodies(persons, body_model, own, frames), len(persons))
        say(f"{camera}: {told}")
    else:
        plate_rgb, measured = read_plate(plate, own.wh)
        film = Film(video, camera, frames, read_factors(brightness or [], frames))
        things = [thing for path in objects or () for thing in read_objects(path)]
        found = None
        if seen:
            whole, detections, who = (
                read_raw_detections(seen[0], masks=True),
                read_detections(seen[1]),
                read_identities(seen[2]),
            )
            found = masks_by_frame(whole, detections, who, find_lens(calibration, camera), about)
        labels = segment(film, plate_rgb, measured, persons, body_model, own, settings, things, found)
    pixels = np.zeros(256, np.int64)
    write_lossless(masks, count_labels(labels, pixels), persons[0].fps if persons else 30.0)
    if not given and not tracks:
        say(describe(camera, pixels, [f.name for f in persons], float(measured.mean())))


def count_labels(
    labels: Iterable[Integer[np.ndarray, "H W"]], pixels: Integer[np.ndarray, " 256"]
) -> Iterator[Integer[np.ndarray, "H W"]]:
    """Yields the labels unchanged; adds the number of pixels per label to ``pixels`` (256,)."""
    for own in labels:
        pixels += np.bincount(own.ravel(), minlength=256)
        yield own


def describe(camera: str, pixels: Integer[np.ndarray, " 256"], names: Sequence[str], measured: float) -> str:
    """One sentence about the masks, from the number of pixels per label (256,)."""
    shares = [f"{name} {pixels[k + 1] / pixels.sum():.1%}" for k, name in enumerate(names)]
    how = (
        "against the clean plate"
        if measured > 0.999
        else f"against the plate where known ({measured:.0%}), GrabCut elsewhere"
    )
    return (
        f"{camera}: {', '.join(shares) or 'nobody'}, unassigned "
        f"{pixels[UNASSIGNED] / pixels.sum():.2%} of the picture; {how}"
    )
