# SPDX-License-Identifier: Apache-2.0
"""Predicts a person's keypoints in one camera from the other cameras, and plans where to detect again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.fitting.points import Triangulation, person_keypoints, triangulate_keypoints
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

# A landmark agrees when it is this near to the other cameras' joint, as a share of the person's extent in the picture
# (about 10 cm when standing).
_NEAR_SHARE = 0.06
# Less confident landmarks do not count.
_SURE = 0.3
# Shares of landmarks that agree: above the first a detection is left unchanged, above the second a new one is accepted,
# below the third it is another person.
_GOOD, BELIEVED, _ELSEWHERE = 0.6, 0.6, 0.3
# By how much a new detection, or exchanged left and right, must agree better.
BETTER = 0.25
# A skeleton without a person is a mixture if this share of it is within so much of known people's extent of their
# limbs: the network's region jumped between two people. (The demo: 0.68 to 1; other false detections: 0.)
_MIXED, _BESIDE_SHARE = 0.65, 0.1
# So many joints must be known and inside the picture.
_MIN = 8


@dataclass(frozen=True)
class ExpectedKeypoints:
    """One person's predicted pixels (T, K, 2) from the other cameras, NaN where unknown, in the camera's layout.

    A landmark agrees within ``near_share`` of the person's extent.
    """

    person: str
    pixels: Float[np.ndarray, "T K 2"]
    near_share: float = _NEAR_SHARE

    def at(self, frame: int, late_frames: Float[np.ndarray, " K"] | float = 0.0) -> Float[np.ndarray, "K 2"] | None:
        """Pixels ``late_frames`` after a frame, interpolated to the neighbouring frame; None with too few joints.

        The delay is one number or one per keypoint, at most one frame.
        """
        pixels = self.pixels[frame]
        late = np.broadcast_to(late_frames, len(pixels))
        for way in (-1, 1):
            if 0 <= frame + way < len(self.pixels):
                step = self.pixels[frame + way] - self.pixels[frame]
                moved = (late * way > 0) & np.isfinite(step).all(-1)
                pixels = np.where(moved[:, None], self.pixels[frame] + np.abs(late)[:, None] * step, pixels)
        return pixels if np.isfinite(pixels[:, 0]).sum() >= _MIN else None


def project_expected(
    person: str,
    view: int,
    cameras: Sequence[Camera],
    detections: Sequence[Detections],
    identities: dict[tuple[str, int], str],
    body: BodyModel,
    frames: int,
    limits: Triangulation,
) -> ExpectedKeypoints:
    """The joints of ``person`` from all cameras but ``view``, projected into that camera."""
    names, keypoints = person_keypoints(person, list(detections), identities, body, frames)
    others = [v for v in range(len(cameras)) if v != view]
    points = triangulate_keypoints(names, keypoints[others], [cameras[v] for v in others], limits, 0.0)
    pixels, depth = cameras[view].project(points.points_m)
    layout = LAYOUTS[detections[view].layout].keypoints
    out = np.full((frames, len(layout), 2), np.nan)
    for k, name in enumerate(layout):
        if name in names:
            column = names.index(name)
            out[:, k] = np.where((depth[:, column] > 0)[:, None], pixels[:, column], np.nan)
    return ExpectedKeypoints(person, out)


def agreement(
    keypoints: Num[np.ndarray, "K 3"], pixels: Num[np.ndarray, "K 2"], near_share: float = _NEAR_SHARE
) -> float:
    """Share of the confident landmarks that are near their predictions, within ``near_share`` of the extent.

    0 with too few to compare.
    """
    known = (keypoints[:, 2] >= _SURE) & np.isfinite(pixels[:, 0])
    if known.sum() < _MIN:
        return 0.0
    extent = np.linalg.norm(np.nanmax(pixels, axis=0) - np.nanmin(pixels, axis=0))
    return float((np.linalg.norm(keypoints[known, :2] - pixels[known], axis=1) < near_share * extent).mean())


def share_on_others(keypoints: Num[np.ndarray, "K 3"], people: Sequence[Num[np.ndarray, "K 2"]], layout: str) -> float:
    """Share of the confident landmarks that are near a limb of ``people`` (K, 2 each, NaN unknown); 0 with too few."""
    sure = keypoints[keypoints[:, 2] >= _SURE, :2]
    if len(sure) < _MIN:
        return 0.0
    nearest = np.full(len(sure), np.inf)
    ends = np.array(LAYOUTS[layout].edges)
    for pixels in people:
        first, second = pixels[ends[:, 0]], pixels[ends[:, 1]]
        known = np.isfinite(first).all(1) & np.isfinite(second).all(1)
        extent = np.linalg.norm(np.nanmax(pixels, axis=0) - np.nanmin(pixels, axis=0))
        if not known.any() or not extent:
            continue
        first, along = first[known], (second - first)[known]
        reached = ((sure[:, None] - first) * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-9)
        off = sure[:, None] - first - np.clip(reached, 0, 1)[..., None] * along
        nearest = np.minimum(nearest, np.linalg.norm(off, axis=-1).min(1) / extent)
    return float((nearest < _BESIDE_SHARE).mean())


def swap_left_right(layout: str, values: Num[np.ndarray, "... K C"]) -> Num[np.ndarray, "... K C"]:
    """Values of a layout's keypoints with left and right exchanged."""
    order = np.arange(values.shape[-2])
    for left, right in LAYOUTS[layout].pairs:
        order[[left, right]] = right, left
    return values[..., order, :]


@dataclass(frozen=True)
class Plan:
    """Changes of one camera's detections before it detects again.

    Attributes:
        track: tracks, some given to the person that they agree with.
        swap_sides, drop: (D,) bool: left and right are to be exchanged; another person, a duplicate, or a mixture of
            two.
        searches: (frame, index of the person, detection to replace or -1) where the network is to run again.
    """

    track: Integer[np.ndarray, " D"]
    swap_sides: Bool[np.ndarray, " D"]
    drop: Bool[np.ndarray, " D"]
    searches: list[tuple[int, int, int]]


def plan_second_look(
    found: Detections, people: Sequence[ExpectedKeypoints], identities: dict[tuple[str, int], str], frames: int
) -> Plan:
    """The plan of a camera: detections that stay, are mirrored or removed, and places to detect again."""
    count = len(found.frame)
    track, swapped, dropped = found.track.copy(), np.zeros(count, bool), np.zeros(count, bool)
    owner = [identities.get((found.camera, int(t)), "") for t in found.track]
    usual = {p.person: np.unique(track[[o == p.person for o in owner]]) for p in people}
    looks: list[tuple[int, int, int]] = []
    for frame in range(frames):
        here = np.flatnonzero(found.frame == frame)
        places = [p.at(frame) for p in people]
        scores = np.array(
            [
                [
                    agreement(found.keypoints[d], q, p.near_share) if q is not None else 0.0
                    for p, q in zip(people, places)
                ]
                for d in here
            ]
        )
        scores = scores.reshape(len(here), len(people))
        for k, (person, place) in enumerate(zip(people, places)):
            if place is None:
                continue
            own = [i for i, d in enumerate(here) if owner[d] == person.person]
            free = [i for i, d in enumerate(here) if not owner[d] and scores[i, k] >= BELIEVED]
            best = max(own, key=lambda i: scores[i, k], default=None)
            if best is None and free and len(usual[person.person]):
                # Detected, but not associated: it goes to the person's track nearest in number.
                best = max(free, key=lambda i: scores[i, k])
                track[here[best]] = usual[person.person][0]
            if best is None:
                looks.append((frame, k, -1))
                continue
            dropped[[here[i] for i in [*own, *free] if i != best and scores[i, k] >= _GOOD]] = True
            if scores[best, k] >= _GOOD:
                continue
            other_way = agreement(swap_left_right(found.layout, found.keypoints[here[best]]), place, person.near_share)
            if other_way >= max(BELIEVED, scores[best, k] + BETTER):
                swapped[here[best]] = True
            elif scores[best, k] < _GOOD:
                rivals = np.delete(scores[best], k)
                dropped[here[best]] |= scores[best, k] < _ELSEWHERE and bool((rivals >= _GOOD).any())
                looks.append((frame, k, int(here[best])))
        around = [place for place in places if place is not None]
        for d in here:
            nobodys = not owner[d] and track[d] == found.track[d] and not dropped[d]
            if nobodys and share_on_others(found.keypoints[d], around, found.layout) >= _MIXED:
                dropped[d] = True
    return Plan(track, swapped, dropped, looks)
