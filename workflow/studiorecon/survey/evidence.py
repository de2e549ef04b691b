# SPDX-License-Identifier: Apache-2.0
"""The data that effects are measured on: a scene before training, its sampling, and values that effects share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.stills import shrink_plate
from studiorecon.geometry.triangulation import Limits
from studiorecon.images.exposure import Overlap
from studiorecon.images.plate import noise_levels
from studiorecon.rig.body_points import Tracks
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections
from studiorecon.survey import scene_change, stillness
from studiorecon.survey.clips import Film, halve_film
from studiorecon.survey.exposures import MIN_PIXELS, ExposureView, camera_overlaps, gain_disagreement

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Limits within which rays agree (U34, T01, T06).
LIMITS = Limits(min_confidence=0.0, huber_share=0.005, outlier_units=3.0, min_angle_deg=2.0, near_m=0.05)


@dataclass(frozen=True)
class Sampling:
    """The density of the survey's samples."""

    # Pictures read of every camera.
    pictures: int = 60
    # Number of pictures in a run without gaps; length of their longer side.
    run: int = 12
    longest_px: int = 480
    # Step and height of the points that make up the stage.
    grid_m: float = 0.25
    height_m: float = 2.0
    # Two depths belong to one surface within this share of them.
    depth_tolerance: float = 0.05
    # Keypoints below it are not used.
    min_confidence: float = 0.3


@dataclass(frozen=True)
class Recordings:
    """Every camera's whole film, for files with one entry per frame.

    ``found`` has every camera's keypoints; None when nothing detects people.
    """

    videos: Sequence[Path]
    found: Sequence[Detections | None]
    frames: int


@dataclass(frozen=True)
class SurveyInput:
    """A scene before training.

    Attributes:
        cameras: training cameras.
        people: ids of the people; None when the dataset says the room is empty.
        views: every camera's clean plate and depth.
        films: every camera's pictures over time.
        tracks: people's keypoints.
        floor_m: height of the floor.
        film_px: pixels of the film per pixel of each camera; empty = 1.
    """

    cameras: Sequence[Camera]
    people: Sequence[str] | None
    views: Sequence[ExposureView]
    films: Sequence[Film]
    tracks: Tracks
    floor_m: float
    fps: float
    film_px: Sequence[float] = ()


@dataclass(frozen=True)
class SmallFilm:
    """One camera's film at half its size, with its plate.

    Attributes:
        camera: of those pictures.
        plate, depth_m: the clean plate, and the empty room's depth.
        free: pixels without people where the plate was measured.
        ratio: log ratio to the plate, without the change of light.
        noise: standard deviation of a picture, levels of 255.
    """

    film: Film
    camera: Camera
    plate: Float[np.ndarray, "h w 3"]
    depth_m: Float[np.ndarray, "h w"]
    free: Bool[np.ndarray, "T h w"]
    ratio: Float[np.ndarray, "T h w 3"]
    noise: float


@dataclass(frozen=True)
class Evidence:
    """The material, and values that several effects share; each is computed once, at its first use."""

    material: SurveyInput
    sampling: Sampling

    @property
    def names(self) -> list[str]:
        """The cameras' names."""
        return [c.name for c in self.material.cameras]

    @cached_property
    def halves(self) -> list[Film]:
        """The films at half their size."""
        return [halve_film(film) for film in self.material.films]

    @cached_property
    def light(self) -> list[tuple[Float[np.ndarray, " T"], Float[np.ndarray, " T"]]]:
        """Per camera the log brightness of the light over time, and its standard error."""
        return [stillness.room_brightness(film.pictures, film.free) for film in self.halves]

    @cached_property
    def overlaps(self) -> tuple[list[Overlap], list[float]]:
        """Colour ratios of pairs of cameras on surfaces that both see, and their standard errors."""
        return camera_overlaps(self.material.views, self.sampling.depth_tolerance, MIN_PIXELS)

    @cached_property
    def gains(self) -> tuple[float, float, Float[np.ndarray, "V 3"]]:
        """Largest difference of a camera's gain from 1, its standard error, and the gains, 1 where unknown."""
        found, errors = self.overlaps
        if not found:
            return np.nan, np.nan, np.ones((len(self.material.views), 3))
        return gain_disagreement(len(self.material.views), found, errors)

    @cached_property
    def small_films(self) -> list[SmallFilm]:
        """The small films in which the survey searches for motion in the room."""
        found = []
        for small, view, (drift, _) in zip(self.halves, self.material.views, self.light, strict=True):
            hw = small.pictures.shape[1:3]
            wh = (hw[1], hw[0])
            plate, measured = shrink_plate(view.rgb, view.measured, wh)
            rows, columns = (((np.arange(n) + 0.5) * full / n).astype(int) for n, full in zip(hw, view.depth_m.shape))
            free = small.free & measured
            ratio = scene_change.log_ratio_to_plate(small.pictures, plate, drift, free)
            noise = noise_levels(small.pictures)
            depth_m = view.depth_m[rows][:, columns]
            found.append(SmallFilm(small, view.camera.resized(wh), plate, depth_m, free, ratio, noise))
        return found
