# SPDX-License-Identifier: Apache-2.0
"""Where a film's pixels are in the calibrated picture, by its size, its black bars and the people in it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.calibration.people_evidence import NOISE_SHARE, agreement, best_candidate
from studiorecon.geometry.crop_hypotheses import CropHypothesis, crop_hypotheses, inside_bars
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.rig.lens_model import as_model
from studiorecon.scene.camera import Lens
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float


def possible_places(
    lens: Lens, wh: tuple[int, int], area: Float[np.ndarray, " 4"] | None, recorded: bool
) -> list[CropHypothesis]:
    """Every place of a film of size ``wh`` in the calibrated picture, the usual one first.

    Black bars show the place; then only the picture that recorded keypoints refer to is open.
    """
    barred = None if area is None else inside_bars(lens, area, wh)
    if barred is None:
        return crop_hypotheses(lens, wh)
    if not recorded:
        return [barred]
    words = "; its recorded keypoints are in pixels of the"
    calibrated = replace(barred.lens, keypoints_calibrated=True)
    return [
        replace(barred, how=f"{barred.how}{words} film"),
        CropHypothesis(calibrated, f"{barred.how}{words} calibration"),
    ]


def choose_places(
    options: Sequence[list[CropHypothesis]], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> tuple[list[Lens], list[str]]:
    """The lenses with the position of each film, of its ``options``, and sentences about assumed ones.

    Films with the same pair of sizes have the same position: one program made them.
    """
    kind_of = [(of[0].lens.wh, wh, len(of)) for of, wh in zip(options, sizes, strict=True)]
    kinds = sorted({kind for kind in kind_of if kind[2] > 1})

    def of(choice: Sequence[int]) -> list[CropHypothesis]:
        at = dict(zip(kinds, choice))
        return [of[at.get(kind, 0)] for of, kind in zip(options, kind_of)]

    ways = [of(choice) for choice in itertools.product(*(range(count) for *_, count in kinds))]
    index, shown = (
        best_candidate(ways, lambda way: agreement([p.lens for p in way], sizes, people))
        if len(ways) > 1
        else (0, False)
    )
    why = "as people show" if shown else "the usual place, which people do not contradict"
    remedy = "" if shown else "; if that is wrong, give it in capture.yaml: pixel_maps"
    notes = [f"camera {p.lens.name}: {p.how} ({why}){remedy}" for p in ways[index] if p.how]
    return [p.lens for p in ways[index]], notes


def without_second_undistortion(
    lenses: Sequence[Lens], sizes: Sequence[tuple[int, int]], people: Sequence[Detections]
) -> tuple[list[Lens], list[str]]:
    """The lenses without their distortion where people show that the films are already undistorted; and a sentence.

    A wrong model of the lens must not look like that: people must also rule out the other model.
    """
    straight = [replace(lens, distortion=np.zeros_like(lens.distortion)) for lens in lenses]
    if not _bends(lenses, straight, sizes, people):
        return list(lenses), []
    other = [as_model(lens, "fisheye" if lens.model == "opencv" else "opencv") for lens in lenses]
    index, shown = best_candidate([lenses, straight, other], lambda way: agreement(way, sizes, people))
    if not shown or index != 1:
        return list(lenses), []
    model = ", ".join(sorted({lens.model for lens in lenses}))
    return straight, [
        "people show that the films are already undistorted: the calibration's lens distortion is not removed again; "
        f"if that is wrong, set calibration.lens to {model}"
    ]


def _bends(
    lenses: Sequence[Lens],
    straight: Sequence[Lens],
    sizes: Sequence[tuple[int, int]],
    people: Sequence[Detections],
) -> bool:
    """Whether distortion moves people's joints by more than a detector's error in the median of some camera."""
    for lens, without, wh, seen in zip(lenses, straight, sizes, people, strict=True):
        if not len(seen.frame) or not lens.distortion.any():
            continue
        one, two = (to_pinhole(seen, each, wh)[1].keypoints[..., :2] for each in (lens, without))
        moved = np.linalg.norm(one - two, axis=-1)
        if np.isfinite(moved).any() and np.nanmedian(moved) > NOISE_SHARE * max(wh):
            return True
    return False
