# SPDX-License-Identifier: Apache-2.0
"""Names films with inverted colours or exchanged red and blue: people's skin and clothes differ from the other films'.

Colours on people's limbs are compared with the median of the other cameras, in logarithms. A film may be brighter by
any factor, and its white balance differs a little. The rest is noise, whose size the films themselves show.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import FootageSource
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.machine.threads import in_threads
from studiorecon.scene.camera import Lens
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Ends of the limbs in whose middle colours are read.
_LIMBS = (
    ("nose", "nose"), ("left_shoulder", "right_hip"), ("right_shoulder", "left_hip"),
    *((f"{side}_{a}", f"{side}_{b}") for side in ("left", "right")
      for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))),
)  # fmt: skip
_SURE = 0.3
# Pictures per film: a few people in different poses.
_PICTURES = 8
# Added before logarithms, of 1: below it noise rules.
_DARK = 0.05
# Standard deviations of exposure and of a channel's white balance between cameras, and the least of a limb's colour,
# natural logarithms: a factor of 1.6, 20 %, 10 %.
_EXPOSURE, _BALANCE, _MIN_NOISE = 0.5, 0.2, 0.1
# Odds against a wrong film: one in a thousand, and a hundred times that, as people are not the same in every film.
_ODDS = 1e5
_MIN_LIMBS = 3
_READINGS = {
    "red and blue exchanged": lambda rgb: rgb[..., ::-1],
    "its colours inverted": lambda rgb: 1 - rgb,
    "its colours inverted, and red and blue exchanged": lambda rgb: 1 - rgb[..., ::-1],
}


def colour_notes(
    films: Mapping[str, FootageSource], seen: Iterable[Detections], lenses: Mapping[str, Lens] | None = None
) -> list[str]:
    """Warnings of films in whose people the colours are inverted or exchanged; ``seen`` by the films' own frames, in
    their pixels or, as ``lenses`` say, the calibration's. Unreadable films are left out: decoding refuses them."""

    def colours_of(found: Detections) -> np.ndarray | None:
        frames, film = np.unique(found.frame), films.get(found.camera)
        if film is None or not len(frames):
            return None
        wanted = frames[np.unique(np.linspace(0, len(frames) - 1, _PICTURES).round().astype(int))].tolist()
        try:
            pictures = seek_frames(film, wanted)
        except UserError:
            return None
        lens, keypoints = (lenses or {}).get(found.camera), found.keypoints
        if lens is not None and lens.keypoints_calibrated:
            turn, shift = lens.calibration_from_video[:, :2], lens.calibration_from_video[:, 2]
            at = (keypoints[..., :2] - shift) @ np.linalg.inv(turn).T
            keypoints = np.concatenate([at, keypoints[..., 2:]], axis=-1)
        people = [keypoints[found.frame == t] for t in wanted]
        return limb_colours(pictures, people, LAYOUTS[found.layout].keypoints)

    known = list(seen)
    colours = {d.camera: own for d, own in zip(known, in_threads(colours_of, known)) if own is not None}
    return [
        f"people in the film of camera {camera} have the colours of the other films with {what}: export it again in "
        "the colours that the camera recorded"
        for camera, what in unlike_colours(colours).items()
    ]


def limb_colours(
    pictures: Sequence[Integer[np.ndarray, "H W 3"]], people: Sequence[Num[np.ndarray, "D K 3"]], names: Sequence[str]
) -> Float[np.ndarray, "L 3"]:
    """(L, 3) median colour, 0 to 1, in the middle of every limb of the ``people`` in each picture; NaN unseen."""
    at = {name: k for k, name in enumerate(names)}
    found = np.full((sum(map(len, people)), len(_LIMBS), 3), np.nan)
    for row, (picture, keypoints) in enumerate((p, k) for p, each in zip(pictures, people) for k in each):
        for limb, ends in enumerate(_LIMBS):
            if not all(name in at and keypoints[at[name], 2] > _SURE for name in ends):
                continue
            column, line = np.floor(np.mean([keypoints[at[name], :2] for name in ends], axis=0)).astype(int)
            patch = picture[max(line - 1, 0) : line + 2, max(column - 1, 0) : column + 2]
            if min(line, column) >= 0 and patch.size:
                found[row, limb] = patch.reshape(-1, 3).mean(0) / 255
    seen = [found[np.isfinite(found[:, limb, 0]), limb] for limb in range(len(_LIMBS))]
    return np.stack([np.median(one, axis=0) if len(one) else np.full(3, np.nan) for one in seen])


def unlike_colours(colours: Mapping[str, Num[np.ndarray, "L 3"]]) -> dict[str, str]:
    """Camera → reading under which its limbs have the other cameras' colours, and as they are they have not.

    Nothing of fewer than three cameras: of two, nobody knows which is wrong.
    """
    logs = {camera: np.log(rgb + _DARK) for camera, rgb in colours.items()}
    usual = {}
    for camera in logs:
        rest = np.stack([logs[other] for other in logs if other != camera]) if len(logs) > 2 else np.zeros((0, 0, 3))
        shared = np.isfinite(rest).any((0, 2)) & np.isfinite(logs[camera]).all(-1) if len(rest) else np.zeros(0, bool)
        if shared.sum() >= _MIN_LIMBS:
            usual[camera] = shared, np.nanmedian(rest[:, shared], axis=0)
    if not usual:
        return {}
    apart = [logs[camera][shared] - median for camera, (shared, median) in usual.items()]
    # Half of a normal distribution is within 0.6745 sigma; the median over cameras ignores a wrong one.
    noise = float(np.median([np.median(np.abs(one - one.mean(0))) for one in apart])) / 0.6745
    gains = []
    for (camera, (shared, median)), as_read in zip(usual.items(), apart):
        for words, read in _READINGS.items():
            other = np.log(read(colours[camera][shared]) + _DARK)
            # A reading that squeezes colours together must not win by that, as densities change with the scale. One
            # that spreads them wins nothing: the pictures' noise is not known so well.
            squeezed = min(logs[camera][shared].sum() - other.sum(), 0.0)
            likelier = _log_likelihood(other - median, noise) - _log_likelihood(as_read, noise)
            gains.append((likelier + squeezed, camera, words))
    gain, camera, words = max(gains)
    if not gain > np.log(_ODDS):
        return {}
    # A wrong film is among the others of the right ones: the next one is sought without it.
    return {camera: words} | unlike_colours({c: rgb for c, rgb in colours.items() if c != camera})


def _log_likelihood(apart: Num[np.ndarray, "L 3"], noise: float) -> float:
    """Of limbs' differences from the usual colours, up to a constant: exposure, balance and noise are Gaussian."""
    limbs = len(apart)
    shared = np.ones((3, 3)) * _EXPOSURE**2 + np.eye(3) * _BALANCE**2
    covariance = np.kron(np.ones((limbs, limbs)), shared) + np.eye(3 * limbs) * max(noise, _MIN_NOISE) ** 2
    values = apart.reshape(-1)
    return -0.5 * float(values @ np.linalg.solve(covariance, values))
