# SPDX-License-Identifier: Apache-2.0
"""The survey's samples of a camera's film: short runs of small pictures over the clip, with a mask of people."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.body.person_boxes import people_regions
from studiorecon.footage.video import read_frames_from
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer

# People's outlines grow by this share of their height and last this many frames more: clothes are wide, and detectors
# miss single frames.
_MARGIN, _HOLD = 0.06, 1
# Pictures of a run are taken at about this rate, or the footage's own if that is less.
_RUN_FPS = 30.0


@dataclass(frozen=True)
class Film:
    """Pictures of one camera.

    Attributes:
        camera: of the working pictures.
        times: working frame of each picture, rising; pictures of one run follow one another in even steps.
        pictures: uint8, smaller than the working pictures by the factor ``scale``.
        free: pixels without people.
        step: working frames from one picture of a run to the next.
    """

    camera: Camera
    times: Integer[np.ndarray, " T"]
    pictures: Integer[np.ndarray, "T h w 3"]
    free: Bool[np.ndarray, "T h w"]
    scale: float
    step: int = 1

    @property
    def runs(self) -> list[slice]:
        """The stretches of pictures without a gap."""
        ends = [0, *(np.flatnonzero(np.diff(self.times) != self.step) + 1), len(self.times)]
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends) if b > a]


def run_starts(frames: int, pictures: int, run: int) -> list[int]:
    """First frames of runs of ``run`` pictures, spread evenly over ``frames``, ``pictures`` in all; the first is 0."""
    count = max(min(pictures, frames) // run, 1)
    return sorted({int(s) for s in np.linspace(0, max(frames - run, 0), count).round()})


def read_film(
    path: Path,
    camera: Camera,
    frames: int,
    fps: float,
    found: Detections | None,
    *,
    pictures: int,
    run: int,
    longest_px: int,
) -> Film:
    """At most ``pictures`` pictures of a film, ``longest_px`` long, in runs of ``run`` at about thirty a second.

    Outlines of people come from ``found``; it is None where the room is known to be empty, or where only silhouettes
    show people. Cost: 12 ms for a picture of 1280×704 on one core.
    """
    # At 120 frames per second things hardly move within a run, so frames are skipped.
    step = max(1, round(fps / _RUN_FPS))
    starts = run_starts(-(-frames // step), pictures, run)
    wanted = step * np.unique(np.concatenate([np.arange(s, min(s + run, -(-frames // step))) for s in starts]))
    held, free, scale = read_clip_pictures(path, camera, wanted, found, longest_px, step)
    return Film(camera, wanted, held, free, scale, step)


def read_clip_pictures(
    path: Path,
    camera: Camera,
    wanted: Integer[np.ndarray, " T"],
    found: Detections | None,
    longest_px: int,
    step: int = 1,
) -> tuple[Integer[np.ndarray, "T h w 3"], Bool[np.ndarray, "T h w"], float]:
    """The ``wanted`` frames, rising, shrunk to ``longest_px``; masks without people; and working pixels per pixel."""
    scale = max(max(camera.wh) / longest_px, 1.0)
    wh = (round(camera.wh[0] / scale), round(camera.wh[1] / scale))
    held: list[np.ndarray] = []
    for stretch in np.split(wanted, np.flatnonzero(np.diff(wanted) != step) + 1):
        for picture in itertools.islice(read_frames_from(path, int(stretch[0]), int(stretch[-1]) + 1), 0, None, step):
            held.append(cv2.resize(picture, wh, interpolation=cv2.INTER_AREA) if scale > 1 else picture)
    if found is None:
        free = np.ones((len(held), wh[1], wh[0]), bool)
    else:
        keypoints = found.keypoints / np.array([scale, scale, 1.0])
        small = Detections(found.camera, found.layout, found.frame, found.track, keypoints)
        free = ~people_regions(small, wanted, (wh[1], wh[0]), _MARGIN, _HOLD * step)
    return np.stack(held), free, scale


def halve_film(film: Film) -> Film:
    """The film at half its size, for things larger than a few pixels, in a quarter of the time."""
    wh = (film.pictures.shape[2] // 2, film.pictures.shape[1] // 2)
    pictures = np.stack([cv2.resize(p, wh, interpolation=cv2.INTER_AREA) for p in film.pictures])
    # A small pixel is free when all pixels that it covers are free.
    covered = np.stack([cv2.resize((~f).astype(np.float32), wh, interpolation=cv2.INTER_AREA) > 0 for f in film.free])
    return Film(film.camera, film.times, pictures, ~covered, film.scale * film.pictures.shape[2] / wh[0], film.step)
