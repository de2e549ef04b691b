# SPDX-License-Identifier: Apache-2.0
"""Whether films, recorded keypoints or both were undistorted before, by people's rays and the films' motion.

Rays of people meet only under the lens of the keypoints. Keypoints are on the film's motion only under the film's lens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from studiorecon.calibration.people_evidence import agreement, best_candidate
from studiorecon.geometry.lens import video_from_working
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.keypoints.motion import Motion
from studiorecon.keypoints.motion_agreement import Score, moving_keypoints, score_reading
from studiorecon.rig.lens_model import reinterpret_lens
from studiorecon.rig.starts import NOISE_SHARE
from studiorecon.scene.camera import Lens
from studiorecon.scene.people import Detections

# Standard deviations by which motion must contradict the keypoints' lens, as where keypoints have another reading.
_SIGMAS = 4.0


def without_second_undistortion(
    lenses: Sequence[Lens],
    sizes: Sequence[tuple[int, int]],
    people: Sequence[Detections],
    motions: Callable[[], Mapping[str, Motion]],
) -> tuple[list[Lens], list[str]]:
    """The lenses without distortion for films, or recorded keypoints, that are already undistorted; and sentences.

    ``motions`` returns those of the films whose keypoints are recorded; it is called only where people decide. A wrong
    model of the lens must not look like undistorted keypoints: people must also rule out the other model.
    """
    kept, straight = list(lenses), [replace(lens, distortion=np.zeros_like(lens.distortion)) for lens in lenses]
    if not any(_is_bent(*each) for each in zip(lenses, straight, sizes, people, strict=True)):
        return kept, []
    other = [reinterpret_lens(lens, "fisheye" if lens.model == "opencv" else "opencv") for lens in lenses]
    index, shown = best_candidate([lenses, straight, other], lambda way: agreement(way, sizes, people))
    if not shown or index == 2:
        return kept, []
    people_s, film_s = (straight, kept) if index == 1 else (kept, straight)
    moving = motions()
    moving_views = [v for v, lens in enumerate(lenses) if lens.name in moving]
    same, apart = (
        _merge_scores(
            [_score_on_motion(people[v], people_s[v], of[v], sizes[v], moving[lenses[v].name]) for v in moving_views]
        )
        for of in (people_s, film_s)
    )
    remedy = f"; if that is wrong, set calibration.lens to {', '.join(sorted({lens.model for lens in lenses}))}"
    if apart.enough and apart.over(same) > _SIGMAS:
        differing = [
            replace(film, keypoint_distortion=own.distortion) if lens.name in moving else own
            for lens, own, film in zip(lenses, people_s, film_s, strict=True)
        ]
        which = ("recorded keypoints", "films") if index == 1 else ("films", "recorded keypoints")
        return differing, [
            f"people and the films' motion show that the {which[0]} are already undistorted, and the {which[1]} are "
            f"not: the calibration's lens distortion is removed from the {which[1]} only{remedy}"
        ]
    if index == 0:
        return kept, []
    sure = not moving or (same.enough and same.over(apart) > _SIGMAS)
    doubt = "" if sure else ", which their motion does not confirm"
    return straight, [
        f"people show that the films are already undistorted{doubt}: the calibration's lens distortion is not removed "
        f"again{remedy}"
    ]


def _is_bent(lens: Lens, straight: Lens, wh: tuple[int, int], seen: Detections) -> bool:
    """Whether distortion moves people's joints by more than a detector's error in the median."""
    if not len(seen.frame) or not lens.distortion.any():
        return False
    one, two = (to_pinhole(seen, each, wh)[1].keypoints[..., :2] for each in (lens, straight))
    moved = np.linalg.norm(one - two, axis=-1)
    return bool(np.isfinite(moved).any() and np.nanmedian(moved) > NOISE_SHARE * max(wh))


def _score_on_motion(seen: Detections, of_keypoints: Lens, of_film: Lens, wh: tuple[int, int], motion: Motion) -> Score:
    """How well keypoints under one lens fit the motion of a film under another one."""
    camera, pinhole = to_pinhole(seen, of_keypoints, wh)
    pixels = video_from_working(pinhole.keypoints[..., :2], of_film, wh, camera.intrinsics)
    shown = np.concatenate([pixels, pinhole.keypoints[..., 2:]], axis=-1)
    return score_reading(moving_keypoints(shown, seen.frame), seen.frame, np.eye(2, 3), motion)


def _merge_scores(scores: Sequence[Score]) -> Score:
    """The scores of several films as one."""
    if not scores:
        return Score(0.0, 0.0, np.zeros(0), 0)
    lift, hit = np.mean([(one.lift, one.hit) for one in scores], axis=0)
    per_frame = np.concatenate([one.per_frame for one in scores])
    return Score(float(lift), float(hit), per_frame, sum(one.points for one in scores))
