# SPDX-License-Identifier: Apache-2.0
"""A person without a body: Gaussians of their own for every frame, started in the masks' visual hull or anywhere;
bodies' rival."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from studiorecon.humans.crops import IGNORED, OUTSIDE, PERSON, Crop
from studiorecon.scene.gaussians import Gaussians, sh_from_rgb
from studiorecon.splatting.train.schedule import TrainingSettings
from studiorecon.splatting.train.still import train_still as train
from studiorecon.splatting.train.targets import Target

_TRIED, _OPACITY = 200_000, 0.5


@dataclass(frozen=True)
class FreePerson:
    """Frame → Gaussians in the world, with the two members of an avatar that pictures are made with."""

    at: dict[int, Gaussians]
    frames: int

    def posed(self, frame: float) -> Gaussians:
        return self.at[int(frame)]


def first_points(
    crops: Sequence[Crop], middle_m: np.ndarray, count: int, hull: bool, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Up to ``count`` points (N, 3) around ``middle_m``, with ``hull`` those no crop shows as empty; mean colours (N,
    3) in 0..1."""
    points = middle_m + rng.uniform([-1.0, -1.0, -1.3], [1.0, 1.0, 1.0], (_TRIED, 3))
    kept, sums, looks = np.ones(_TRIED, bool), np.zeros((_TRIED, 3)), np.zeros(_TRIED)
    for crop in crops:
        pixels, depth_m = crop.camera.project(points)
        column, row = (np.floor(np.nan_to_num(pixels, nan=-1)).astype(int)).T
        inside = (depth_m > 0) & (column >= 0) & (row >= 0) & (column < crop.camera.wh[0]) & (row < crop.camera.wh[1])
        verdict = np.full(_TRIED, OUTSIDE)
        verdict[inside] = crop.verdict[row[inside], column[inside]]
        kept &= verdict != OUTSIDE
        hit = verdict == PERSON
        sums[hit] += crop.rgb[row[hit], column[hit]] / 255
        looks[hit] += 1
    chosen = np.flatnonzero((kept | (not hull)) & (looks > 0))[:count]
    return points[chosen], sums[chosen] / looks[chosen, None]


def free_person(
    crops: Sequence[Crop],
    middles_m: np.ndarray,
    frames: Sequence[int],
    settings: TrainingSettings,
    count: int,
    hull: bool,
    seed: int,
) -> FreePerson:
    """One training per frame on that frame's crops, each before a black and a white ground so that alpha is learned
    too."""
    at = {}
    for frame in frames:
        here, rng = [crop for crop in crops if crop.frame == frame], np.random.default_rng([seed, frame])
        points, colours = first_points(here, middles_m[frame], count, hull, rng)
        if len(points) < 100:
            continue
        spacing_m = (np.prod(np.ptp(points, axis=0)) / len(points)) ** (1 / 3) / 2
        start = Gaussians(
            points.astype(np.float32),
            np.tile(np.float32([1, 0, 0, 0]), (len(points), 1)),
            np.full((len(points), 3), np.log(spacing_m), np.float32),
            np.full(len(points), np.log(_OPACITY / (1 - _OPACITY)), np.float32),
            sh_from_rgb(colours)[:, None].astype(np.float32),
        )
        targets = []
        for crop in here:
            weight = (crop.verdict != IGNORED).astype(np.float32)
            for level in (0.0, 1.0):
                rgb = np.where(
                    (crop.verdict == PERSON)[..., None],
                    crop.rgb.astype(np.float32) / np.float32(255),
                    np.float32(level),
                )
                targets.append(Target(crop.camera, rgb, weight, background_rgb=(level,) * 3))
        at[frame] = train(
            start, targets, replace(settings, largest_scale_m=0.1), rng, extent_m=1.0, threads=1, label=f"frame {frame}"
        ).gaussians
    return FreePerson(at, max(frames) + 1)
