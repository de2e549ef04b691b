# SPDX-License-Identifier: Apache-2.0
"""Terms of the log-likelihood ratio "is a person here" of a group of tracks, in nats: positive speaks for a person.

Each term compares what was measured with what a person gives and with what nobody gives: furniture, an animal, a
picture, tracks that fit by chance. No term alone decides: each has bounds, because each has exceptions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.association.group import Group
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class Term:
    """One measurement's evidence about a group.

    Attributes:
        name: what was measured.
        nats: log-likelihood ratio of a person to nobody.
        text: the measurement, as the end of a sentence.
    """

    name: str
    nats: float
    text: str


@dataclass(frozen=True)
class Ratio:
    """The log ratio of two log-normal densities, each given as (median, deviation of the logarithm).

    Attributes:
        person, nobody: of what was measured, where a person is and where nobody is.
        min_nats, max_nats: bounds of the ratio, nats.
    """

    person: tuple[float, float]
    nobody: tuple[float, float]
    min_nats: float
    max_nats: float

    def nats(self, value: float) -> float:
        """The ratio at a measured ``value`` > 0, nats; 0 where it is NaN."""
        if not np.isfinite(value):
            return 0.0
        ends = self.person, self.nobody
        first, second = ((np.log(max(value, 1e-9) / median) / sigma, sigma) for median, sigma in ends)
        ratio = 0.5 * (second[0] ** 2 - first[0] ** 2) + np.log(second[1] / first[1])
        return float(np.clip(ratio, self.min_nats, self.max_nats))


_AT = {name: k for k, name in enumerate(STABLE_KEYPOINTS)}
_OTHER_SIDE = [
    _AT[name.replace(*("left", "right") if name.startswith("left") else ("right", "left"))] for name in STABLE_KEYPOINTS
]
# One candidate of twenty is a person before anything is measured.
PRIOR_NATS = -3.0
# Time in which two cameras agree, s: people stay for seconds, agreement by chance ends after a moment.
_DURATION = Ratio((5.0, 1.2), (0.1, 0.8), -8, 3)
# A camera that looks at the place of a person detects one in 80 % of the frames, and one where nobody is in 20 %.
_HIT_NATS = np.log(0.8 / 0.2)
# Least deviation of the distance of two rays to one joint, m: landmarks mean points some centimetres apart from
# different sides.
_RAY_SIGMA_M = 0.03
# Share of the keypoints that agree in a camera: (mean, deviation); by chance any from half of them is as likely.
_AGREEMENT = (0.95, 0.15)
# Middle of the shoulders to that of the hips, m: people from children to giants, and anything.
_TRUNK = Ratio((0.5, 0.28), (0.5, 1.2), -12, 1.5)
# Bones as shares of the trunk. (Real people and the studio's: shoulders 0.65 to 0.71; dogs: 0.15 to 0.35.)
_SHARES = {
    "shoulders": (0.68, [("left_shoulder", "right_shoulder")]),
    "hips": (0.4, [("left_hip", "right_hip")]),
    "upper arms": (0.53, [("left_shoulder", "left_elbow"), ("right_shoulder", "right_elbow")]),
    "forearms": (0.5, [("left_elbow", "left_wrist"), ("right_elbow", "right_wrist")]),
    "thighs": (0.82, [("left_hip", "left_knee"), ("right_hip", "right_knee")]),
    "shins": (0.8, [("left_knee", "left_ankle"), ("right_knee", "right_ankle")]),
}
# Such a share over its median, of people and of anything else. Rarely is one of somebody's bones mismeasured; and a
# pair of limbs and the trunk they are measured against are wrong together: fit says less than misfit.
_SHARE = Ratio((1.0, 0.18), (1.0, 0.6), -5, 0.4)
# Median relative change of the lengths of bones (filmed people: 0.01 to 0.06; dogs and false landmarks: 0.08 to 0.3).
_STEADINESS = Ratio((0.035, 0.7), (0.16, 0.5), -4, 1)
# Angle between postures in two cameras, radians, of one person (0.2 to 0.6; with hidden legs 0.9) and of two skeletons.
_POSTURE = Ratio((0.5, 0.45), (0.9, 0.35), -4, 1)
# Deviation of joints and extremities from one plane, in trunks, of a person (0.17 to 0.54, arms hanging 0.14), and on
# posters and screens (0.03 to 0.05).
_DEPTH = Ratio((0.24, 0.3), (0.04, 0.35), -15, 0)
_DEEP = ("nose", "left_ear", "right_ear", "left_heel", "right_heel", "left_big_toe", "right_big_toe")
# Time over which joints are averaged before that, s: noise is no depth.
_CALM_S = 0.25
# Fewer known joints show neither a plane nor another person's place.
_MIN_JOINTS = 8
# Deviation of a mirror image from the reflection of the person, m: two triangulations.
_REFLECTED_M = 0.05
# The same of another person in a like place.
_SYMMETRIC_M = 0.5
# Way, m, that makes one independent place of a reflection: one person in one place may only look symmetric.
_MOVED_M = 0.3
# Shorter, s, no reflection is known.
_LASTING_S = 1.0
# Distance of the joints of two people side by side, and of one person detected twice, m.
_OVERLAP = Ratio((0.8, 0.4), (0.05, 0.4), -10, 0)
# A length needs so many frames, or half of those with any known point.
_MIN_FRAMES = 3


def total_nats(terms: Sequence[Term]) -> float:
    """The log-likelihood ratio of a group: the prior and all its terms."""
    return PRIOR_NATS + float(sum(term.nats for term in terms))


def strongest_objections(terms: Sequence[Term]) -> str:
    """The two terms with the strongest evidence against a person, as the end of a sentence."""
    against = sorted((term for term in terms if term.nats < 0), key=lambda term: term.nats)[:2]
    return "; ".join(f"{term.text} ({term.nats:+.1f} nats)" for term in against) or "too little is known of it"


def duration(group: Group, fps: float) -> Term:
    """Term of the time in which two cameras agree; half of a short clip counts against nobody."""
    seconds, clip = len(group.frames) / fps, group.seen.shape[1] / fps
    nats = _DURATION.nats(seconds)
    if seconds >= 0.5 * clip:
        nats = max(nats, 0.0)
    return Term("duration", nats, f"two cameras agree for {seconds:.2f} s of {clip:.1f} s only")


def views(group: Group, cameras: Sequence[Camera]) -> Term:
    """Term of the cameras that see a group among those in whose picture it is, without the two that see it most."""
    nats, names, counted = [], [], 0
    known = np.flatnonzero(np.isfinite(group.centres_m).all(1))
    for camera, seen in zip(cameras, group.seen):
        pixels, depth = camera.project(group.centres_m[known])
        inside = (depth > 0) & (pixels >= 0).all(-1) & (pixels < camera.wh).all(-1)
        if inside.any():
            share = float(seen[known[inside]].mean())
            nats.append(_HIT_NATS * (2 * share - 1))
            counted += 1
            names += [camera.name] * (share >= 0.5)
    said = f"{len(names)} of the {counted} cameras in whose pictures it would be see it most of the time"
    return Term("views", float(np.clip(sum(nats) - 2 * _HIT_NATS, -8, 3)), said)


def rays(group: Group, distance_m: Float[np.ndarray, "M M"], gate_m: float, rig_m: float) -> Term:
    """Term of the distance of rays of its members (``distance_m``, NaN unknown), with the rig's own ``rig_m``, and of
    the share of keypoints that agree."""
    sigma_m = float(np.hypot(_RAY_SIGMA_M, rig_m))
    gaps = distance_m[np.isfinite(distance_m)]
    share = float(np.nanmean(group.agreement)) if np.isfinite(group.agreement).any() else np.nan
    nats = 0.0
    if len(gaps):
        nats += float(np.log(2 * gate_m / (sigma_m * np.sqrt(2 * np.pi))) - 0.5 * (np.median(gaps) / sigma_m) ** 2)
    if np.isfinite(share):
        mean, sigma = _AGREEMENT
        nats += float(np.log(1 / (sigma * np.sqrt(2 * np.pi))) - 0.5 * ((share - mean) / sigma) ** 2)
    gap = f"rays pass each other at {100 * np.median(gaps):.0f} cm and " if len(gaps) else ""
    return Term("rays", float(np.clip(nats, -4, 2)), f"{gap}{share:.0%} of its keypoints agree")


def size(lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]]) -> Term:
    """Term of the length of its trunk."""
    trunk_m = float(np.median(lengths["trunk"][0])) if "trunk" in lengths else float("nan")
    return Term("size", _TRUNK.nats(trunk_m), f"its torso would be {trunk_m:.2f} m long")


def proportions(lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]]) -> Term:
    """Term of the lengths of its bones over its trunk: an animal has narrow shoulders and hips, and forelegs for
    arms."""
    shares = trunk_shares(lengths)
    nats = {part: _SHARE.nats(share / _SHARES[part][0]) for part, share in shares.items()}
    off = ", ".join(f"{part} {shares[part]:.2f} of its trunk" for part in shares if nats[part] < 0)
    return Term("proportions", sum(nats.values()), f"its proportions are not a person's: {off}")


def steadiness(lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]]) -> Term:
    """Term of the changes of its bones' lengths."""
    own = [np.median(np.abs(v - np.median(v))) / np.median(v) for values in lengths.values() for v in values]
    wavers = float(np.median(own)) if own else float("nan")
    return Term("steadiness", _STEADINESS.nats(wavers), f"its bones change their length by {wavers:.0%}")


def posture(pose_rad: Float[np.ndarray, "M M"]) -> Term:
    """Term of the difference between cameras' postures, by the detector's guess (``pose_rad`` of its members, NaN
    unknown)."""
    known = pose_rad[np.isfinite(pose_rad)]
    apart = float(np.median(known)) if len(known) else float("nan")
    return Term("posture", _POSTURE.nats(apart), f"the postures that cameras see are {np.degrees(apart):.0f}° apart")


def depth(
    points_m: Float[np.ndarray, "T 12 3"],
    deep_m: Float[np.ndarray, "T D 3"],
    lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]],
    fps: float,
) -> Term:
    """Term of joints and extremities in one plane, as on a picture or a screen.

    Joints alone do not decide: a person with spread arms is flat to 8 mm.
    """
    described = np.isfinite(deep_m).all(-1).mean(0) >= 0.5
    share = float("nan")
    trunk_m = float(np.median(lengths["trunk"][0])) if "trunk" in lengths else _TRUNK.person[0]
    if described.any():
        share = flatness_m(np.concatenate([points_m, deep_m[:, described]], axis=1), fps) / trunk_m
    said = "it is flat: all its points are in one plane, as on a poster or a screen"
    return Term("depth", _DEPTH.nats(share), said)


def reflection(
    points_m: Float[np.ndarray, "T 12 3"],
    other_m: Float[np.ndarray, "T 12 3"],
    centres_m: Float[np.ndarray, "V 3"],
    fps: float,
) -> Term:
    """Term of ``points_m`` as the mirror image of ``other_m``, left for right, with all cameras ``centres_m`` on the
    other's side.

    Only a person who moved in front of the mirror can be distinguished from two people in symmetric positions.
    """
    said = "it is another person's mirror image: left and right exchanged, and behind the mirror for every camera"
    true = other_m[:, _OTHER_SIDE]
    known = np.isfinite(points_m).all(-1) & np.isfinite(true).all(-1)
    if (known.sum(1) >= _MIN_FRAMES).sum() < _LASTING_S * fps:
        return Term("reflection", 0.0, said)
    image, original = points_m[known], true[known]
    across, middle = image - original, (image + original) / 2
    normal = np.linalg.svd(across, full_matrices=False)[2][0]
    normal = normal * np.sign(np.median(across @ normal))
    offset = float(np.median(middle @ normal))
    expected = original - 2 * ((original @ normal) - offset)[:, None] * normal
    moved_m = float(np.linalg.norm(np.ptp(np.quantile(original[:, :2], [0.05, 0.95], axis=0), axis=0)))
    if not (centres_m @ normal < offset).all():
        return Term("reflection", 0.0, said)
    off_m = float(np.median(np.linalg.norm(image - expected, axis=-1)))
    # As many independent places as the way is long, and three coordinates each.
    places = min(moved_m / _MOVED_M, 3.0)
    nearer = 3 * np.log(_SYMMETRIC_M / _REFLECTED_M) - 0.5 * off_m**2 * (_REFLECTED_M**-2 - _SYMMETRIC_M**-2)
    return Term("reflection", float(np.clip(-places * nearer if places >= 1 else 0.0, -20, 0)), said)


def overlap(points_m: Float[np.ndarray, "T 12 3"], other_m: Float[np.ndarray, "T 12 3"]) -> Term:
    """Term of two skeletons at one place wherever both are known: one person, detected twice."""
    apart = np.linalg.norm(points_m - other_m, axis=-1)
    apart = apart[np.isfinite(apart)]
    # Arms and legs of two people are as far apart as their trunks: three places.
    nats = 3 * _OVERLAP.nats(float(np.median(apart)) if len(apart) >= _MIN_JOINTS else np.nan)
    return Term("overlap", nats, "it is at the same place as another person: one person, detected twice")


def bone_lengths_m(points_m: Float[np.ndarray, "T 12 3"]) -> dict[str, list[Float[np.ndarray, " F"]]]:
    """Lengths of a skeleton's bones (T, 12, 3; NaN unknown), metres, in the frames in which they are known; "trunk" as
    well.

    Bones that are hardly ever known are left out.
    """
    middles = [
        np.mean([points_m[:, _AT[f"{side}_{joint}"]] for side in ("left", "right")], axis=0)
        for joint in ("shoulder", "hip")
    ]
    ends = {"trunk": [(middles[0], middles[1])]}
    for part, (_, limbs) in _SHARES.items():
        ends[part] = [(points_m[:, _AT[first]], points_m[:, _AT[second]]) for first, second in limbs]
    known = {part: [np.linalg.norm(a - b, axis=-1) for a, b in limbs] for part, limbs in ends.items()}
    least = max(_MIN_FRAMES, 0.5 * float(np.isfinite(known["trunk"][0]).sum()))
    long = {part: [v[np.isfinite(v)] for v in values] for part, values in known.items()}
    return {part: kept for part, values in long.items() if (kept := [v for v in values if len(v) >= least])}


def trunk_shares(lengths: Mapping[str, Sequence[Float[np.ndarray, " F"]]]) -> dict[str, float]:
    """Medians over time as shares of the trunk, {} without a trunk; of a pair of limbs the less likely length
    counts."""
    if "trunk" not in lengths:
        return {}
    trunk_m = float(np.median(lengths["trunk"][0]))
    found = {}
    for part, (median, _) in _SHARES.items():
        own = [float(np.median(values)) / trunk_m for values in lengths.get(part, [])]
        if own:
            found[part] = max(own, key=lambda share: abs(np.log(max(share, 1e-9) / median)))
    return found


def flatness_m(points_m: Float[np.ndarray, "T K 3"], fps: float) -> float:
    """RMS distance of joints of the whole clip from their best-fitting plane; NaN where too few are known."""
    length = max(1, round(_CALM_S * fps))
    moments = []
    for block in np.array_split(points_m, max(1, len(points_m) // length)):
        known = np.isfinite(block).all(-1)
        enough = known.sum(0) >= max(1, 0.5 * len(block))
        if enough.sum() >= _MIN_JOINTS:
            moments.append(np.array([np.median(block[known[:, k], k], axis=0) for k in np.flatnonzero(enough)]))
    if not moments:
        return float("nan")
    joints = np.concatenate(moments)
    return float(np.linalg.svd(joints - joints.mean(0), compute_uv=False)[2] / np.sqrt(len(joints)))


def extremities_m(
    members: Sequence[tuple[int, int]],
    detections: Sequence[Detections],
    cameras: Sequence[Camera],
    frames: int,
    agree: Limits,
) -> Float[np.ndarray, "T 7 3"]:
    """Nose, ears, heels and toes of the tracks ``members`` (view, track), NaN unless two cameras determine them."""
    pixels = np.full((len(cameras), frames, len(_DEEP), 3), [np.nan, np.nan, 0.0])
    for view, track in members:
        found = detections[view]
        which = np.flatnonzero(found.track == track)
        names = LAYOUTS[found.layout].keypoints
        for k, name in enumerate(_DEEP):
            if name in names:
                pixels[view, found.frame[which], k] = found.keypoints[which, names.index(name)]
    flat = pixels.reshape(len(cameras), -1, 3)
    return triangulate(flat[..., :2], flat[..., 2], cameras, agree).points_m.reshape(frames, len(_DEEP), 3)
