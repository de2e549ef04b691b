# SPDX-License-Identifier: Apache-2.0
"""Evidence for a person at a pixel, as log-odds: from the difference to the clean plate, and from the fitted bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.images.difference import plate_difference

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Largest log-odds of one pixel's difference: a single pixel is never certain.
_MAX = 4.0
# Width of the neighbourhood that measures the difference just inside the outline: two pixels each way.
_EDGE_PX = 5


@dataclass(frozen=True)
class DifferenceSettings:
    """How a colour difference becomes evidence. Differences are in CIELAB units (1 = just visible).

    Attributes:
        threshold: difference that is neutral.
        softness: further difference that adds one to the log-odds.
        edge: an outline is where the difference has fallen to this share of its value just inside.
        chroma_weight: colour differences count this much more than lightness.
        shadow: darkest shadow, as a share of the unshadowed light; 1 = no shadow is expected.
        shadow_weight: weight of the part of a difference that a shadow would explain.
    """

    threshold: float = 6.0
    softness: float = 3.0
    edge: float = 0.4
    chroma_weight: float = 1.5
    shadow: float = 0.5
    shadow_weight: float = 0.2


@dataclass(frozen=True)
class Plate:
    """A clean plate prepared for comparison: float32 in [0, 1], where it is measured, and its ``variability``.

    That is the difference of its pixels in pictures without people (noise, compression at edges).
    """

    rgb: Float[np.ndarray, "H W 3"]
    measured: Bool[np.ndarray, "H W"]
    variability: Float[np.ndarray, "H W"]


def colour_difference(
    rgb: Float[np.ndarray, "H W 3"], plate_rgb: Float[np.ndarray, "H W 3"], settings: DifferenceSettings
) -> Float[np.ndarray, "H W"]:
    """Float32 difference between a picture and the plate, both float32 in [0, 1], in CIELAB units.

    A shadow darkens all channels by one factor. The best such factor, no darker than ``settings.shadow``, is removed
    first and counts only by ``shadow_weight``.
    """
    squared, left = plate_difference(rgb, plate_rgb, chroma_weight=settings.chroma_weight, shadow=settings.shadow)
    return np.sqrt(squared + np.square(settings.shadow_weight * 100 * (1 - left)))


def difference_evidence(
    difference: Float[np.ndarray, "H W"], plate: Plate, settings: DifferenceSettings
) -> Float[np.ndarray, "H W"]:
    """Float32 log-odds from the difference to the plate; 0 where the plate is not measured.

    An outline is where the difference has fallen to a share ``edge`` of its value just inside: optics and chroma
    subsampling spread a person's colour one or two pixels beyond it. Positive evidence is a pixel's own. Negative
    evidence needs a whole neighbourhood that matches the plate: there the room is visible, even at a fitted body
    (behind furniture), while a single matching pixel inside a shirt is chance.
    """
    # Unrest is noise; a larger difference than a person needs is an object that left, not noise.
    quiet = difference - np.minimum(plate.variability, settings.threshold)
    own = cv2.GaussianBlur(quiet, (3, 3), 0)
    strongest = cv2.dilate(own, np.ones((_EDGE_PX, _EDGE_PX), np.uint8))
    threshold = np.maximum(settings.threshold, settings.edge * strongest)
    around = cv2.boxFilter(np.maximum(quiet, 0), -1, (7, 7))
    score = np.where(own > settings.threshold, own, np.maximum(own, np.minimum(around, settings.threshold)))
    # A perfect match is at least as strong against a person as a body's inside is for one.
    evidence = np.where(
        score > threshold, (score - threshold) / settings.softness, -_MAX * (1 - np.maximum(score, 0) / threshold)
    )
    evidence = np.minimum(evidence, _MAX)
    return np.where(plate.measured, evidence, 0).astype(np.float32)


def temporal_difference(
    differences: Float[np.ndarray, "T H W"], free: Bool[np.ndarray, "T H W"]
) -> Float[np.ndarray, "H W"]:
    """Float32 80th percentile of differences over the pictures in which a pixel is ``free``, else their median."""
    sorted_differences = np.sort(np.where(free, differences, np.inf), axis=0)
    count = free.sum(axis=0)
    rank = np.clip(np.ceil(0.8 * count).astype(int) - 1, 0, None)
    unrest = np.take_along_axis(sorted_differences, rank[None], axis=0)[0]
    known = count > 0
    fallback = float(np.median(unrest[known])) if known.any() else 0.0
    return np.where(known, unrest, fallback).astype(np.float32)


def body_evidence(
    signed_distance_m: Float[np.ndarray, " ..."], sigma_m: float, gate_m: float, inside: float, outside: float
) -> Float[np.ndarray, " ..."]:
    """Float32 log-odds from the signed distance to a fitted body's outline, metres at the body's depth.

    One per ``sigma_m``, the typical error of outline and clothes, at most ``inside`` and at least −``outside``; −inf
    beyond ``gate_m``.
    """
    evidence = np.clip(signed_distance_m / sigma_m, -outside, inside)
    return np.where(signed_distance_m < -gate_m, -np.inf, evidence).astype(np.float32)
