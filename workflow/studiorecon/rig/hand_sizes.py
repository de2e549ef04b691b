# SPDX-License-Identifier: Apache-2.0
"""How large hands are in the films, by people's arms, and whether that is enough to see fingers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.triangulation import Limits
from studiorecon.keypoints.hands import SIDES
from studiorecon.rig.body_points import Tracks, triangulate_tracks
from studiorecon.scene.camera import Camera
from studiorecon.scene.effects import HANDS, Effect

if TYPE_CHECKING:
    from jaxtyping import Float

# Length of a hand (wrist to the longest finger's tip) in forearms (elbow to wrist), and a person's deviation from it
# (Drillis and Contini, "Body segment parameters", 1966: 0.108 and 0.146 of the height).
_PER_FOREARM, _SPREAD = 0.74, 0.05
# Share of the moments in which hands are smaller than the statistic: one moment in ten decides, because the others
# then get the fingers between.
_SHARE = 0.9
# Keypoints are metres apart when a wrist is taken for another: cameras may be outdated, so this is wider than theirs.
_LIMITS = Limits(min_confidence=0.2, outlier_units=5.0)


def hand_sizes_px(found: Tracks, cameras: Sequence[Camera], film_px: Sequence[float]) -> Float[np.ndarray, "V P T 2"]:
    """Length in pixels of the film that every left and right hand has in a view where it is not foreshortened.

    0 where the wrist is outside the picture or its place unknown. From the wrist's distance and the person's median
    forearm. ``film_px``: pixels of the film per pixel of each camera.
    """
    names = [f"{side}_{joint}" for side in SIDES for joint in ("elbow", "wrist")]
    views, people, frames = found.pixels.shape[:3]
    sizes = np.zeros((views, people, frames, 2))
    if not set(names) <= set(found.names) or not sizes.size:
        return sizes
    points_m, _ = triangulate_tracks(found, names, cameras, _LIMITS)
    arms_m = np.linalg.norm(points_m[:, :, 0::2] - points_m[:, :, 1::2], axis=-1).reshape(people, -1)
    known = [arms[np.isfinite(arms)] for arms in arms_m]
    hand_m = _PER_FOREARM * np.array([np.median(arms) if len(arms) else np.nan for arms in known])
    for view, (camera, scale) in enumerate(zip(cameras, film_px, strict=True)):
        pixels, depth_m = camera.project(points_m[:, :, 1::2])
        with np.errstate(invalid="ignore", divide="ignore"):
            inside = ((pixels >= 0) & (pixels < camera.wh)).all(-1) & (depth_m > 0)
            size = scale * camera.focal_px[0] * hand_m[:, None, None] / depth_m
        sizes[view] = np.where(inside & np.isfinite(size), size, 0.0)
    return sizes


def second_best(sizes: Float[np.ndarray, "V ..."]) -> Float[np.ndarray, " ..."]:
    """The second largest size of all views: two views must see a hand."""
    return np.sort(sizes, axis=0)[-2] if len(sizes) > 1 else np.zeros(sizes.shape[1:])


def usual_size(sizes: Float[np.ndarray, "V P T 2"]) -> tuple[float, tuple[float, float]] | None:
    """Size in the second best view that hands reach in a tenth of the moments, and its interval; None without hands."""
    seen = second_best(sizes)
    if not (seen > 0).any():
        return None
    size = float(np.quantile(seen[seen > 0], _SHARE))
    spread = _SPREAD / _PER_FOREARM * size
    return size, (size - spread, size + spread)


def large_hands(sizes: Float[np.ndarray, "V P T 2"], use: str, effect: Effect = HANDS) -> Float[np.ndarray, "V P T 2"]:
    """``sizes`` of the hands whose fingers are searched for, 0 for all others.

    ``use``: "auto" = where the effect is on, those that reach its threshold in two views; "on" = all that two cameras
    see; "off" = none.
    """
    least = 1.0 if use == "on" else effect.threshold
    usual = usual_size(sizes)
    if usual is None or use == "off" or (use == "auto" and usual[1][0] <= least):
        return np.zeros_like(sizes)
    return np.where((sizes >= least) & (second_best(sizes) >= least), sizes, 0.0)
