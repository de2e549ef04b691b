# SPDX-License-Identifier: Apache-2.0
"""Chooses the keypoint layout of a detector's output that does not name it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.layouts import BY_COUNT, LAYOUTS, USUAL, WITH_HANDS

if TYPE_CHECKING:
    from jaxtyping import Num

_LIMBS = tuple(
    (f"{side}_{a}", f"{side}_{b}")
    for side in ("left", "right")
    for a, b in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("hip", "knee"),
        ("knee", "ankle"),
        ("eye", "ear"),
        ("ankle", "heel"),
    )
)
_CLEAR = 1.25


def choose_layout(keypoints: Num[np.ndarray, "D K 3"], given: str, where: str) -> tuple[str, str | None]:
    """Name of the layout of detections in the film's pixels, and a sentence when the limbs decided it or contradict the
    ``given`` one.

    Under the wrong order limbs run across the whole body, so the layout with clearly shorter limbs is right. Raises
    UserError for an unknown name, a count that does not fit, and an unclear choice.
    """
    count, auto = keypoints.shape[1], given == "auto"
    if not auto and given not in LAYOUTS:
        raise UserError(
            f"{where}: keypoint_layout {given!r} is unknown; known layouts are {', '.join(sorted(LAYOUTS))}"
        )
    if f"{given}{WITH_HANDS}" in LAYOUTS and len(LAYOUTS[f"{given}{WITH_HANDS}"].keypoints) == count:
        given += WITH_HANDS
    if not auto and len(LAYOUTS[given].keypoints) != count:
        raise UserError(
            f"{where}: has {count} keypoints per person, but keypoint_layout {given} "
            f"has {len(LAYOUTS[given].keypoints)}"
        )
    candidates = BY_COUNT.get(count, ())
    if not candidates:
        listed = ", ".join(f"{name} ({len(LAYOUTS[name].keypoints)})" for name in sorted(LAYOUTS))
        raise UserError(f"{where}: no layout has {count} keypoints; write them in the order of one of {listed}")
    if len(candidates) == 1:
        return candidates[0], None
    usual = USUAL.get(count) if auto else given
    asked = keypoints[(keypoints[..., 2] > 0).all(-1)] if auto and usual else keypoints
    limbs = {name: _limbs(asked, LAYOUTS[name].keypoints) for name in candidates}
    short, *rest = sorted(candidates, key=lambda name: limbs[name][0])
    long = rest[0] if auto else given
    ratio = limbs[long][0] / max(limbs[short][0], 1e-9)
    # Bodies of which parts are missing have shorter limbs by chance in the layout that loses more of them.
    clear = bool(np.isfinite(ratio) and ratio > _CLEAR and limbs[short][1] >= limbs[long][1])
    if not auto:
        wrong = f"keypoint_layout is {given}, but limbs are {ratio:.1f} times shorter under {short}: see which one the "
        return given, f"{wrong}detector wrote" if clear else None
    if usual and (not clear or short == usual):
        return usual, None
    if not clear:
        raise UserError(
            f"{where}: {count} keypoints may be {' or '.join(candidates)}, and the limbs do not show which; set "
            "keypoint_layout in capture.yaml"
        )
    return (
        short,
        f"{count} keypoints were read as {short}: its limbs are {ratio:.1f} times shorter than those of {long}",
    )


def _limbs(keypoints: np.ndarray, names: tuple[str, ...]) -> tuple[float, float]:
    """Median over detections of their mean limb length in pixels, and the share of the layout's limbs that is present;
    inf and 0 without any.

    The mean within one person, because the wrong order leaves some limbs short and makes others as long as the body.
    """
    index = {name: i for i, name in enumerate(names)}
    ends = np.array([(index[a], index[b]) for a, b in _LIMBS if a in index and b in index], dtype=int).reshape(-1, 2)
    first, second = keypoints[:, ends[:, 0]], keypoints[:, ends[:, 1]]
    present = (first[..., 2] > 0) & (second[..., 2] > 0)
    lengths = np.where(present, np.linalg.norm(first[..., :2] - second[..., :2], axis=-1), 0.0)
    seen = present.any(-1)
    means = lengths[seen].sum(-1) / present[seen].sum(-1)
    return (float(np.median(means)), float(present.mean())) if len(means) else (np.inf, 0.0)
