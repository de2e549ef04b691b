# SPDX-License-Identifier: Apache-2.0
"""Where a film's pixels are in the calibrated picture, by its size, its black bars and the people in it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.calibration.people_evidence import agreement, best_candidate
from studiorecon.geometry.crop_hypotheses import CropHypothesis, crop_hypotheses, place_inside_bars
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
    barred = None if area is None else place_inside_bars(lens, area, wh)
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
