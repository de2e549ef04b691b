# SPDX-License-Identifier: Apache-2.0
"""Which found hand is a person's left and which the right one, in all cameras over the clip.

Arms show where hands are, but are taken for each other for seconds. Four witnesses are weighed: the arm, the hand
network's opinion of the side, the rays of the other cameras, and the hand's place a moment before. In each camera the
answers over time are a hidden Markov chain; a mean field couples the cameras' chains (Saul and Jordan, "Exploiting
tractable substructures in intractable networks", 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.relative_pose import essential_matrix
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

# The answers in one picture: the left hand, then the right one, is the hand found at the arm called left (0), at that
# called right (1), or neither (2). In the second half the picture's arms are exchanged.
_ANSWERS = np.array([(0, 1), (0, 2), (2, 1), (2, 2), (1, 0), (1, 2), (2, 0), (2, 2)])
_OF_ANSWERS = np.eye(3)[_ANSWERS].reshape(8, 6)
_EXCHANGED = np.arange(8) >= 4
# Arms are exchanged once in ten seconds, for about a second.
_EXCHANGED_HZ, _MENDED_HZ = 0.1, 1.0
# Share of cases in which a witness errs whatever it says: another's hand, a point on the wrong finger.
_ERRS = 0.03
# The network errs about one hand in five of the made studio, also where it is sure, and its errors last: so many of
# its opinions in a second are independent.
_MISTAKEN, _OPINIONS_HZ = 0.2, 4.0
# In lengths of a hand: deviation of its points from another camera's ray, and from their place a second before; the
# space in which the other hand may be; and how near two hands of a person do not come in a picture.
_OFF_RAY, _PER_SECOND, _SPACE, _APART = 0.1, 5.0, 3.0, 0.3
_SWEEPS = 4


def hand_sides(
    hands: Float[np.ndarray, "V T 2 21 3"],
    right: Float[np.ndarray, "V T 2"],
    cameras: Sequence[Camera],
    fps: float,
) -> Float[np.ndarray, "V T 2 3"]:
    """Probability that the left, then the right hand (third axis) is the one of the arm called left, of the arm called
    right, or not seen (fourth axis).

    ``hands`` are at the arms at which they were found; ``right`` is the network's probability of a right one, NaN where
    unknown.
    """
    pixels = np.where(hands[..., 2:] > 0, hands[..., :2], np.nan)
    lengths_px = [_usual_length(own) for own in pixels]
    alone = [_in_one_picture(r, own / n, fps) for r, own, n in zip(right, pixels, lengths_px)]
    steps = [_steps(own / n, fps) for own, n in zip(pixels, lengths_px)]
    belief = np.array([_chain(*one) for one in zip(alone, steps)])
    views = range(len(cameras))
    agree = {(a, b): _on_rays(pixels, a, b, cameras) / lengths_px[b] for a in views for b in views if a != b}
    same = {(a, b): _log_ratio(np.fmax(agree[a, b], agree[b, a].mT), _OFF_RAY, 1) for a, b in agree}
    for view in [*views] * _SWEEPS:
        expected = np.zeros((pixels.shape[1], 2, 3))
        for other in (v for v in views if v != view):
            theirs = (belief[other] @ _OF_ANSWERS).reshape(-1, 2, 3)[..., :2]
            expected[..., :2] += np.einsum("tij,tsj->tsi", same[view, other], theirs)
        belief[view] = _chain(alone[view] + expected.reshape(-1, 6) @ _OF_ANSWERS.T, steps[view])
    return (belief @ _OF_ANSWERS).reshape(*right.shape[:2], 2, 3)


def _in_one_picture(right: np.ndarray, places: np.ndarray, fps: float) -> np.ndarray:
    """(T, 8) log-likelihood of the answers by one picture alone; ``places`` (T, 2, 21, 2) in lengths of the hand."""
    seen = np.isfinite(places).any((2, 3))
    likely = _MISTAKEN + (1 - 2 * _MISTAKEN) * np.nan_to_num(right, nan=0.5)
    opinions_hz = fps * np.isfinite(right).any(1).sum() / max(1, seen.any(1).sum())
    opinion = min(1.0, _OPINIONS_HZ / max(opinions_hz, 1e-9)) * np.log(2 * np.stack([1 - likely, likely], axis=1))
    named = (_ANSWERS[:, :, None] == [0, 1]).any(1)  # (8, 2): which of the hands an answer uses
    one_hand = np.nan_to_num(np.exp(-0.5 * (_apart(places[:, 0], places[:, 1]) / _APART) ** 2))[:, None]
    return (
        np.concatenate([opinion, np.zeros((len(right), 2, 1))], axis=-1).reshape(-1, 6) @ _OF_ANSWERS.T
        + np.log(_ERRS) * np.maximum((seen[:, None] & ~named).sum(-1) - one_hand, 0)
        + np.log1p(_ERRS**2 - one_hand) * named.all(1)
        + np.where((~seen[:, None] & named).any(-1), -np.inf, 0.0)
    )


def _steps(places: np.ndarray, fps: float) -> np.ndarray:
    """(T − 1, 8, 8) log-likelihood of each answer after each answer of the picture before."""
    moved = _apart(places[:-1, :, None], places[1:, None, :])
    deviation = min(float(np.hypot(_OFF_RAY, _PER_SECOND / fps)), _SPACE)
    same = np.pad(_log_ratio(moved, deviation, 2), ((0, 0), (0, 1), (0, 1)))
    by_place = sum(same[:, _ANSWERS[:, None, side], _ANSWERS[:, side]] for side in (0, 1))
    change = 1 - np.exp(-np.where(_EXCHANGED, _MENDED_HZ, _EXCHANGED_HZ) / fps)
    return by_place + np.log(np.where(_EXCHANGED[:, None] == _EXCHANGED, 1 - change[:, None], change[:, None]))


def _chain(alone: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(T, 8) probability of each answer, given every picture's and every step's log-likelihood: forward, backward."""
    likelihood = np.exp(alone - alone.max(1, keepdims=True))
    likelihood[0] *= np.where(_EXCHANGED, _EXCHANGED_HZ, _MENDED_HZ)
    step = np.exp(steps - steps.max((1, 2), keepdims=True))
    forward, backward = likelihood.copy(), np.ones_like(likelihood)
    for t in range(1, len(alone)):
        forward[t] *= forward[t - 1] / forward[t - 1].sum() @ step[t - 1]
    for t in range(len(alone) - 2, -1, -1):
        backward[t] = step[t] @ (likelihood[t + 1] * backward[t + 1])
        backward[t] /= backward[t].sum()
    belief = forward * backward
    return belief / belief.sum(1, keepdims=True)


def _log_ratio(apart: np.ndarray, deviation: float, dimensions: int) -> np.ndarray:
    """Log-likelihood ratio of one hand against two that are anywhere near, from their distance; 0 where that is NaN."""
    peak = (_SPACE / deviation) ** dimensions
    return np.nan_to_num(np.log(_ERRS + (1 - _ERRS) * peak * np.exp(-0.5 * (apart / deviation) ** 2)))


def _apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Mean distance of the points that both hands (…, 21, 2) have, NaN without any."""
    off = np.linalg.norm(first - second, axis=-1)
    return np.nansum(off, axis=-1) / np.where(np.isfinite(off).any(-1), np.isfinite(off).sum(-1), np.nan)


def _usual_length(places: np.ndarray) -> float:
    """Median distance of the point furthest from the wrist, over a camera's hands (T, 2, 21, 2); 1 without hands."""
    from_wrist = np.linalg.norm(places - places[:, :, :1], axis=-1)
    seen = from_wrist[np.isfinite(from_wrist).any(-1)]
    return float(np.median(np.nanmax(seen, axis=-1))) if len(seen) else 1.0


def _on_rays(pixels: np.ndarray, a: int, b: int, cameras: Sequence[Camera]) -> np.ndarray:
    """(T, 2, 2) mean distance in ``b``'s pixels of its hands' points from the rays of ``a``'s; NaN where not seen."""
    relative = cameras[b].camera_from_world @ np.linalg.inv(cameras[a].camera_from_world)
    essential = essential_matrix(relative[:3, :3], relative[:3, 3])
    fundamental = np.linalg.inv(cameras[b].intrinsics).T @ essential @ np.linalg.inv(cameras[a].intrinsics)
    lines = np.concatenate([pixels[a], np.ones_like(pixels[a][..., :1])], -1) @ fundamental.T
    points = np.concatenate([pixels[b], np.ones_like(pixels[b][..., :1])], -1)
    off = np.abs(np.einsum("tikc,tjkc->tijk", lines, points)) / np.linalg.norm(lines[..., :2], axis=-1)[:, :, None]
    there = np.isfinite(off).sum(-1)
    return np.nansum(off, axis=-1) / np.where(there > 0, there, np.nan)
