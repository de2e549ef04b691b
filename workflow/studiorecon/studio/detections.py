# SPDX-License-Identifier: Apache-2.0
"""2D keypoints like a detector's: projected body points with occlusion, noise, drop-outs, phantoms, any order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.scene.camera import Lens
from studiorecon.studio.description import DetectionOptions
from studiorecon.studio.film import centre_m, project
from studiorecon.studio.tracing import Tracer

if TYPE_CHECKING:
    from jaxtyping import Float

_OWN_BODY_M = 0.22  # a keypoint is inside its body: the body's own surface may be this far in front of it
_OWN_HAND_M = 0.06  # the same of a hand's point: a palm and a finger are that thick
_MIN_SEEN = 5
_HIDDEN_NOISE = 3.0  # factor on the noise of hidden points, which a detector guesses


def detect(
    points_m: Float[np.ndarray, "P K 3"],
    lens: Lens,
    tracer: Tracer,
    first_actor: int,
    options: DetectionOptions,
    rng: np.random.Generator,
    body_points: int | None = None,
) -> list[Float[np.ndarray, "K 3"]]:
    """Detections of people in one camera and frame: pixels (centres at +0.5) and confidence each, 0 = missing.

    ``points_m`` are all people's keypoints, hands after the ``body_points`` of bodies; ``tracer`` holds the
    room and then, from index ``first_actor``, the people. Visible points get a confidence near 0.9, points behind the
    own body near 0.55. Points behind other people or objects have one near 0.2 or are missing; points outside the
    picture are missing. A person with fewer than five good points of the body is not reported.
    """
    people, body_points = [], points_m.shape[1] if body_points is None else body_points
    width, height = lens.wh
    for number, points in enumerate(points_m):
        pixels, depth = project(lens, points)
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < [width, height]).all(axis=1)
        behind_own, behind_other = _hidden(points, lens, tracer, first_actor + number, body_points)
        # Random numbers are drawn for every point, so that one planted fault does not change another's.
        jitter, dice = rng.standard_normal((len(points), 2)), rng.uniform(size=(len(points), 3))
        confidence = np.where(behind_other, 0.2, np.where(behind_own, 0.55, 0.9)) + 0.08 * (dice[:, 0] - 0.5)
        lost = (behind_other & (dice[:, 1] < 0.5)) | (dice[:, 2] < options.drop_outs) | ~inside
        spread = options.noise_px * np.where(behind_other, _HIDDEN_NOISE, 1.0)
        found = np.column_stack([pixels + spread[:, None] * jitter, confidence])
        found[lost] = 0.0
        overlooked = rng.uniform() < 0.1 * options.drop_outs
        if not overlooked and (found[:body_points, 2] > 0.4).sum() >= _MIN_SEEN:
            people.append(found)
    has_phantom = rng.uniform() < options.false_positives
    phantom = _phantom(points_m.shape[1], lens, rng)
    if has_phantom:
        people.append(phantom)
    order = rng.permutation(len(people))
    return [people[i] for i in order] if options.shuffled else people


def true_hands(
    points_m: Float[np.ndarray, "P 42 3"], lens: Lens, tracer: Tracer, first_actor: int
) -> Float[np.ndarray, "P 2 21 3"]:
    """Exact hand points of all people in one camera: pixels, and 1 where visible, 0 where hidden or outside."""
    found = np.zeros((len(points_m), 42, 3))
    for number, points in enumerate(points_m):
        pixels, depth = project(lens, points)
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < lens.wh).all(axis=1)
        behind_own, behind_other = _hidden(points, lens, tracer, first_actor + number, 0)
        found[number] = np.column_stack([pixels, inside & ~behind_own & ~behind_other])
    return found.reshape(-1, 2, 21, 3)


def openpose_json(people: list[Float[np.ndarray, "K 3"]], body_points: int) -> dict:
    """One frame in OpenPose's form, whose pixels count from 0 at the first pixel's centre."""
    entries = []
    for keypoints in people:
        shifted = keypoints - [0.5, 0.5, 0.0]
        triples = np.where(keypoints[:, 2:] > 0, shifted, 0.0)
        flat, hands = triples[:body_points].ravel(), triples[body_points:].reshape(-1, 63)
        rest: dict[str, list[float]] = {
            f"{part}_keypoints_{d}d": [] for part in ("face", "hand_left", "hand_right") for d in (2, 3)
        }
        rest |= {
            f"hand_{s}_keypoints_2d": [round(float(v), 4) for v in hand] for s, hand in zip(("left", "right"), hands)
        }
        entries.append(
            {
                "person_id": [-1],
                "pose_keypoints_2d": [round(float(v), 4) for v in flat],
                "pose_keypoints_3d": [],
                **rest,
            }
        )
    return {"version": 1.3, "people": entries}


def _hidden(
    points_m: np.ndarray, lens: Lens, tracer: Tracer, own: int, body_points: int
) -> tuple[np.ndarray, np.ndarray]:
    """Which points (K,) are behind their own body, and which behind anything else."""
    towards = points_m - centre_m(lens)
    hits = tracer.cast(centre_m(lens), towards)
    gap_m = (1 - hits.distance) * np.linalg.norm(towards, axis=1)
    other = hits.is_hit & (hits.solid != own) & (gap_m > 0.01)
    reach_m = np.where(np.arange(len(points_m)) < body_points, _OWN_BODY_M, _OWN_HAND_M)
    return hits.is_hit & (hits.solid == own) & (gap_m > reach_m), other


def _phantom(count: int, lens: Lens, rng: np.random.Generator) -> np.ndarray:
    """A false detection: points scattered upright around a random place, half of them missing."""
    width, height = lens.wh
    middle = rng.uniform([0.15 * width, 0.3 * height], [0.85 * width, 0.7 * height])
    pixels = middle + rng.standard_normal((count, 2)) * [0.04 * width, 0.15 * height]
    found = np.column_stack([pixels, rng.uniform(0.3, 0.6, count)])
    inside = (pixels >= 0).all(axis=1) & (pixels < [width, height]).all(axis=1)
    found[(rng.uniform(size=count) < 0.5) | ~inside] = 0.0
    return found
