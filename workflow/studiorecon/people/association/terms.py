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

from studiorecon.keypoints.correspondence import STABLE_KEYPOINTS
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float

    from studiorecon.people.association.grouping import Group


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
    """The log ratio of two normal densities of a measurement, or of its logarithm.

    Attributes:
        person, nobody: where a person is and where nobody is: (median, deviation of the logarithm), or (mean,
            deviation) where ``linear``.
        min_nats, max_nats: bounds of the ratio.
        places: number of independent places that are measured.
    """

    person: tuple[float, float]
    nobody: tuple[float, float]
    min_nats: float
    max_nats: float
    places: int = 1
    linear: bool = False

    def nats(self, value: float) -> float:
        """The ratio at a measured ``value`` (> 0 unless ``linear``); 0 where it is NaN."""
        if not np.isfinite(value):
            return 0.0
        off = [
            (value - middle if self.linear else np.log(max(value, 1e-9) / middle)) / sigma
            for middle, sigma in (self.person, self.nobody)
        ]
        ratio = self.places * (0.5 * (off[1] ** 2 - off[0] ** 2) + np.log(self.nobody[1] / self.person[1]))
        return float(np.clip(ratio, self.min_nats, self.max_nats))


Bones = Mapping[str, list[float]]
"""Part of the body → median length, m, of each of its bones that is known."""

# Keypoints alternate: left, right.
_OTHER_SIDE = [k ^ 1 for k in range(len(STABLE_KEYPOINTS))]
EXTREMITIES = ("nose", "left_ear", "right_ear", "left_heel", "right_heel", "left_big_toe", "right_big_toe")
"""Points off the plane of the joints of somebody who stands with hanging arms."""
# One candidate of ten is a person before anything is measured.
PRIOR_NATS = -2.2
# Time in which two cameras agree, s: people stay for seconds, agreement by chance ends after a moment.
_DURATION = Ratio((5.0, 1.2), (0.1, 0.8), -8, 3)
# A camera that looks at the place of a person detects one in 80 % of the frames, and one where nobody is in 20 %; from
# one camera of four furniture or a wall hides a person.
_HIT_NATS, _HIDDEN = np.log(0.8 / 0.2), 0.25
# Least deviation of the distance of two rays to one joint, m: landmarks mean points some centimetres apart from
# different sides.
_RAY_SIGMA_M = 0.03
# Share of the keypoints that agree in a camera: (mean, deviation); by chance any from half of them is as likely.
_AGREEMENT = (0.95, 0.15)
# Middle of the shoulders to that of the hips, m: people from children to giants, and anything.
_TRUNK = Ratio((0.5, 0.28), (0.5, 1.2), -12, 1.5)
# Bones as shares of the trunk. (Real people and the studio's: shoulders 0.65 to 0.71; dogs: 0.15 to 0.35.)
_PARTS = {
    "trunk": (1.0, [("middle_shoulder", "middle_hip")]),
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
# Angle between postures in two cameras, radians, of one person (0.2 to 0.6; with hidden legs 0.9) and of two skeletons.
_POSTURE = Ratio((0.5, 0.45), (0.9, 0.35), -4, 1)
# Deviation of joints and extremities from one plane, in trunks, of a person (0.17 to 0.54, arms hanging 0.14), and on
# posters and screens (0.03 to 0.05).
_DEPTH = Ratio((0.24, 0.3), (0.04, 0.35), -15, 0)
# Time over which joints are averaged before that, s: noise is no depth.
_CALM_S = 0.25
# Fewer known joints show neither a plane nor another person's place.
_MIN_JOINTS = 8
# Distance of joints from the reflection of another person's in each of three coordinates, m: of somebody in a like
# place, and of a mirror image, triangulated twice.
_REFLECTED = Ratio((0.0, 0.5), (0.0, 0.05), -7, 7, places=3, linear=True)
# Way, m, that makes one independent place of a reflection: one person in one place may only look symmetric.
_MOVED_M = 0.3
# Shorter, s, no reflection is known.
_LASTING_S = 1.0
# Distance of the joints of two people side by side, and of one person detected twice, m. Arms and legs of two people
# are as far apart as their trunks.
_OVERLAP = Ratio((0.8, 0.4), (0.05, 0.4), -30, 0, places=3)
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
    shares = []
    known = np.flatnonzero(np.isfinite(group.centres_m).all(1))
    for camera, seen in zip(cameras, group.seen):
        pixels, depth = camera.project(group.centres_m[known])
        inside = (depth > 0) & (pixels >= 0).all(-1) & (pixels < camera.wh).all(-1)
        if inside.any():
            shares.append(float(seen[known[inside]].mean()))
    often = sum(share >= 0.5 for share in shares)
    said = f"{often} of the {len(shares)} cameras in whose pictures it would be see it most of the time"
    # Less two cameras that see it always, without which there is no group.
    nats = np.log((1 - _HIDDEN) * np.exp(_HIT_NATS * (2 * np.array([*shares, 1.0, 1.0]) - 1)) + _HIDDEN)
    return Term("views", float(np.clip(nats[:-2].sum() - nats[-2:].sum(), -8, 3)), said)


def rays(group: Group, gaps: Float[np.ndarray, " N"], gate_m: float, rig_m: float) -> Term:
    """Term of the distances of rays of its members (``gaps``, m, one per shared frame), with the rig's own ``rig_m``,
    and of the share of keypoints that agree."""
    sigma_m = float(np.hypot(_RAY_SIGMA_M, rig_m))
    shares = group.agreement[np.isfinite(group.agreement)]
    nats, said = 0.0, []
    if len(gaps):
        nats += float(np.log(2 * gate_m / (sigma_m * np.sqrt(2 * np.pi))) - 0.5 * (np.median(gaps) / sigma_m) ** 2)
        said.append(f"rays pass each other at {100 * np.median(gaps):.0f} cm")
    if len(shares):
        mean, sigma = _AGREEMENT
        nats += float(-np.log(sigma * np.sqrt(2 * np.pi)) - 0.5 * ((shares.mean() - mean) / sigma) ** 2)
        said.append(f"{shares.mean():.0%} of its keypoints agree")
    return Term("rays", float(np.clip(nats, -4, 2)), " and ".join(said))


def size(bones: Bones) -> Term:
    """Term of the length of its trunk."""
    trunk_m = trunk_length_m(bones)
    return Term("size", _TRUNK.nats(trunk_m), f"its torso would be {trunk_m:.2f} m long")


def proportions(bones: Bones) -> Term:
    """Term of the lengths of its bones over its trunk, of a pair the less likely one: an animal has narrow shoulders
    and hips, and forelegs for arms."""
    shares = {
        part: min((_SHARE.nats(length_m / trunk_length_m(bones) / usual), length_m) for length_m in bones[part])
        for part, (usual, _) in _PARTS.items()
        if part in bones and part != "trunk"
    }
    off = [f"{part} {m / trunk_length_m(bones):.2f} of its trunk" for part, (own, m) in shares.items() if own < 0]
    nats = sum(own for own, _ in shares.values())
    return Term("proportions", nats, f"its proportions are not a person's: {', '.join(off)}")


def posture(angles_rad: Float[np.ndarray, " N"]) -> Term:
    """Term of the differences between cameras' postures, by the detector's guess, one per shared frame."""
    apart = float(np.median(angles_rad)) if len(angles_rad) else float("nan")
    return Term("posture", _POSTURE.nats(apart), f"the postures that cameras see are {np.degrees(apart):.0f}° apart")


def depth(
    points_m: Float[np.ndarray, "T 12 3"], extremities_m: Float[np.ndarray, "T 7 3"], bones: Bones, fps: float
) -> Term:
    """Term of joints and extremities in one plane, as on a picture or a screen.

    Joints alone do not decide: a person with spread arms is flat to 8 mm.
    """
    described = np.isfinite(extremities_m).all(-1).mean(0) >= 0.5
    share, trunk_m = float("nan"), trunk_length_m(bones)
    if described.any():
        flat_m = flatness_m(np.concatenate([points_m, extremities_m[:, described]], axis=1), fps)
        share = flat_m / (trunk_m if np.isfinite(trunk_m) else _TRUNK.person[0])
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
    nats = 0.0
    if (known.sum(1) >= _MIN_FRAMES).sum() >= _LASTING_S * fps:
        image, original = points_m[known], true[known]
        across, middle = image - original, (image + original) / 2
        normal = np.linalg.svd(across, full_matrices=False)[2][0]
        normal = normal * np.sign(np.median(across @ normal))
        offset = float(np.median(middle @ normal))
        expected = original - 2 * ((original @ normal) - offset)[:, None] * normal
        moved_m = float(np.linalg.norm(np.ptp(np.quantile(original[:, :2], [0.05, 0.95], axis=0), axis=0)))
        if (centres_m @ normal < offset).all() and moved_m >= _MOVED_M:
            # As many independent places as the way is long.
            off_m = float(np.median(np.linalg.norm(image - expected, axis=-1))) / np.sqrt(3)
            nats = min(moved_m / _MOVED_M, 3.0) * min(_REFLECTED.nats(off_m), 0.0)
    return Term("reflection", nats, said)


def overlap(points_m: Float[np.ndarray, "T 12 3"], other_m: Float[np.ndarray, "T 12 3"]) -> Term:
    """Term of two skeletons at one place wherever both are known: one person, detected twice."""
    apart = np.linalg.norm(points_m - other_m, axis=-1)
    apart = apart[np.isfinite(apart)]
    nats = _OVERLAP.nats(float(np.median(apart)) if len(apart) >= _MIN_JOINTS else np.nan)
    return Term("overlap", nats, "it is at the same place as another person: one person, detected twice")


def measure_bones(points_m: Float[np.ndarray, "T 12 3"]) -> Bones:
    """The bones of a skeleton (NaN unknown), without those that are hardly ever known."""
    joints = dict(zip(STABLE_KEYPOINTS, points_m.swapaxes(0, 1)))
    joints |= {f"middle_{j}": (joints[f"left_{j}"] + joints[f"right_{j}"]) / 2 for j in ("shoulder", "hip")}
    lengths = {p: [np.linalg.norm(joints[a] - joints[b], axis=-1) for a, b in ends] for p, (_, ends) in _PARTS.items()}
    least = max(_MIN_FRAMES, 0.5 * np.isfinite(lengths["trunk"][0]).sum())
    known = {part: [one[np.isfinite(one)] for one in own] for part, own in lengths.items()}
    medians = {part: [float(np.median(one)) for one in own if len(one) >= least] for part, own in known.items()}
    return {part: own for part, own in medians.items() if own}


def trunk_length_m(bones: Bones) -> float:
    """Median length of the trunk, NaN where it is unknown."""
    return bones.get("trunk", [float("nan")])[0]


def flatness_m(points_m: Float[np.ndarray, "T K 3"], fps: float) -> float:
    """RMS distance of joints of the whole clip from their best-fitting plane; NaN where too few are known."""
    moments = []
    for block in np.array_split(points_m, max(1, len(points_m) // max(1, round(_CALM_S * fps)))):
        often = np.isfinite(block).all(-1).mean(0) >= 0.5
        if often.sum() >= _MIN_JOINTS:
            moments.append(np.nanmedian(block[:, often], axis=0))
    if not moments:
        return float("nan")
    joints = np.concatenate(moments)
    return float(np.linalg.svd(joints - joints.mean(0), compute_uv=False)[2] / np.sqrt(len(joints)))
