# SPDX-License-Identifier: Apache-2.0
"""Terms of "is a person here" from pictures: changes where joints move, the detector's masks, clean plates.

A false skeleton moves over an unchanged picture. A person who keeps still changes no picture either, and their
jittering keypoints resemble false ones; then a camera's mask, or a difference from the empty room, confirms them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.people.association.grouping import Group, TrackComparison
from studiorecon.people.association.terms import Ratio, Term
from studiorecon.people.pictures.change import LIMB_ENDS, PICTURES, motion_support, pictures_at, sample_frames, steps_m
from studiorecon.people.pictures.coverage import CameraEvidence, mask_coverage, plate_difference_share
from studiorecon.progress import progress

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# Share of the places that joints left or reached which changed, where a person moves and where nobody does.
_CHANGED, _UNCHANGED = 0.95, 0.35
# Landmarks jump to so many places in a camera without anybody's motion; the next 20 count as 5 independent ones.
_JUMPS, _PLACES, _INDEPENDENT = 8, 20, 5
# Of a person a camera shows all that moves, or one arm or leg alone, or, rarely, nothing of it.
_WHOLE, _HIDDEN = 0.95, 0.005
# Somebody else may move where a single limb is taken to be.
_ELSEWHERE = 0.15
# A camera's film is trusted where somebody's motion is confirmed by this.
_TRUSTED_NATS = 2.0
# One camera's film says no more than this: a shadow or a shaking camera changes pixels too.
_MAX_VIEW_NATS = 3.0
# Someone who keeps still, whose landmarks wander, is so unlikely in nats; a mask or a plate over them adds its own.
_STILL_NATS = -12.0
# Share of the places of joints that a mask covers, or that differ from the empty room. Several joints are covered for
# themselves.
_COVERED = Ratio((0.95, 0.15), (0.3, 0.3), -99, 99, places=3, linear=True)
# The detector's confidence that a person is there, as log-odds, of people and of furniture.
_PRESENT = Ratio((5.0, 2.0), (2.0, 2.0), -3, 1, linear=True)
# Networks draw a mask over whatever they take for somebody: it says little else.
_MIN_COVERED_NATS, _MAX_COVERED_NATS = -3.0, 1.0


def picture_terms(
    groups: Sequence[Group],
    compared: TrackComparison,
    videos: Sequence[Path],
    witnesses: Sequence[CameraEvidence | None],
) -> list[list[Term]]:
    """Terms of every group from pictures: motion, the detector's masks and confidence, clean plates."""
    moved, shares = _motion(groups, compared, videos)
    out = []
    for group, nats, share in zip(groups, moved.tolist(), shares):
        mask, presence, plate = _coverage(group, compared, videos, witnesses)
        if nats <= 0:
            confirmed = max(_COVERED.nats(mask), _COVERED.nats(plate), 0.0)
            nats = min(float(np.logaddexp(nats, _STILL_NATS + confirmed)), 0.0)
        seen = ", ".join(f"{s:.0%} ({c.name})" for s, c in zip(share, compared.cameras) if np.isfinite(s))
        said = f"the pictures show no person there: of the pixels that its joints moved over only {seen} changed"
        covered = [np.clip(_COVERED.nats(s), _MIN_COVERED_NATS, _MAX_COVERED_NATS) for s in (mask, plate)]
        odds = np.log(np.clip(presence, 1e-4, 1 - 1e-4) / (1 - np.clip(presence, 1e-4, 1 - 1e-4)))
        out.append(
            [
                Term("motion", nats, said),
                Term("mask", float(covered[0]), f"the detector's masks cover {mask:.0%}"),
                Term("plate", float(covered[1]), f"{plate:.0%} differ from a clean plate"),
                Term("presence", _PRESENT.nats(odds), f"the detector is sure by {presence:.0%} only"),
            ]
        )
    return out


def _motion(
    groups: Sequence[Group], compared: TrackComparison, videos: Sequence[Path]
) -> tuple[Float[np.ndarray, " G"], Float[np.ndarray, "G V"]]:
    """Nats of whether pictures change where joints move, and only there, and shares that changed.

    A camera in which nobody's motion is confirmed contradicts nobody: its film may be dark, or out of step.
    """
    cameras = compared.cameras
    picked = [sample_frames(group.frames, PICTURES) for group in groups]
    points_m = np.stack([group.points_m for group in groups])
    least = [steps_m(group.points_m, compared.fps) for group in groups]
    nats, shares = np.zeros((len(groups), len(cameras))), np.full((len(groups), len(cameras)), np.nan)
    for v, camera in enumerate(progress(cameras, "cameras")):
        pictures = pictures_at(videos[v], np.concatenate(picked))
        for g, frames in enumerate(picked):
            counts = motion_support([pictures[t] for t in frames.tolist()], points_m[:, frames], g, least[g], camera)
            nats[g, v] = view_nats(counts)
            if counts[:, 1].sum():
                shares[g, v] = counts[:, 0].sum() / counts[:, 1].sum()
    others = np.array([np.delete(nats, g, axis=0).max(0, initial=0.0) for g in range(len(groups))])
    trusted = (others >= _TRUSTED_NATS) | (nats > 0)
    return np.clip(np.where(trusted, nats, 0.0).sum(1), -14, 6), shares


def view_nats(counts: Num[np.ndarray, "12 2"]) -> float:
    """Log-likelihood ratio from one camera's ``counts`` of changed places and of all places, per joint; 0 with too
    few."""
    if counts[:, 1].sum() <= _JUMPS:
        return 0.0
    limbs = [counts[ends].sum(0) for ends in LIMB_ENDS]
    moving = [min(np.exp(_ratio(*limb)), 1 / _ELSEWHERE) if limb[1] else 0.0 for limb in limbs]
    odds = _WHOLE * np.exp(_ratio(*counts.sum(0))) + (1 - _WHOLE) * float(np.mean(moving))
    return float(min(np.log(odds + _HIDDEN), _MAX_VIEW_NATS))


def _ratio(changed: float, places: float) -> float:
    """Log-likelihood ratio of ``changed`` of ``places``."""
    independent = _INDEPENDENT * min(max(places - _JUMPS, 0) / _PLACES, 1.0)
    share = changed / max(places, 1)
    yes, no = np.log(_CHANGED / _UNCHANGED), np.log((1 - _CHANGED) / (1 - _UNCHANGED))
    return float(independent * (share * yes + (1 - share) * no))


def _coverage(
    group: Group, compared: TrackComparison, videos: Sequence[Path], witnesses: Sequence[CameraEvidence | None]
) -> Float[np.ndarray, " 3"]:
    """Share covered by the detector's masks, its confidence, and share that differs from a plate: each camera's best,
    NaN unknown."""
    found = [
        [*mask_coverage(group, v, given, camera, one), plate_difference_share(group, camera, video, one)]
        for v, (given, camera, video, one) in enumerate(zip(compared.detections, compared.cameras, videos, witnesses))
        if one is not None
    ]
    return np.fmax.reduce(np.array([[np.nan] * 3, *found]))
