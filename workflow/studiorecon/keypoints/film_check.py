# SPDX-License-Identifier: Apache-2.0
"""Checks recorded keypoints against their film: the reading that fits best, or why none is usable."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.keypoints.coordinate_readings import (
    Reading,
    affine,
    apply_reading,
    convert_keypoints,
    share_readings,
    size_readings,
    turned_readings,
)
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.motion import Motion
from studiorecon.keypoints.motion_agreement import (
    MAX_MISSING,
    MIN_SHIFT,
    Movers,
    Score,
    best_score,
    is_frozen,
    moving_keypoints,
    score_reading,
    shift_change,
)
from studiorecon.keypoints.numbering import Numbering, Numberings
from studiorecon.keypoints.unmatched import (
    upside_down,
    with_missing_frames,
    without_match,
    without_motion,
    without_people,
)
from studiorecon.scene.recorded_keypoints import RecordedKeypoints

if TYPE_CHECKING:
    from jaxtyping import Float, Num

# Another reading is right when keypoints are this much nearer to motion, as a lift and as a share of its own, and so
# many standard deviations more surely. Set by judgement, checked by `python -m benchmarks.keypoints --takes 8`.
_LIFT, _GAIN, _SHARE_LEFT, _SIGMAS = 0.4, 0.2, 0.65, 4.0
# Of two likely numberings one is right when it is so many deviations better.
_NUMBER_SIGMAS = 3.0
BORNE_OUT = 0.3
"""Lift from which a film bears keypoints out; below it, other cameras' keypoints are compared with it too."""
# No reading fits: lift is no better than chance although people move in keypoints and film.
_CHANCE, _CHANCE_SIGMAS, _CHANCE_POINTS = 0.1, 2.0, 200
_SHIFTS = 60
# Detectors guess somewhat beyond the border; more keypoints than this share beyond it are from another picture.
_OUTSIDE = 0.5
# Shares may be somewhat beyond the border too, and slightly below 0; pixels of a film are far larger.
_SHARES_WITHIN, _BELOW_0, _SMALLEST_PX = 3.0, -0.1, 32


@dataclass(frozen=True)
class Verdict:
    """How keypoints are read.

    Attributes:
        recorded: the keypoints in the film's frames, in the pixels in which they should have been written.
        notes: sentences about the decisions, or about what could not be decided.
        refusal: why they cannot be used; "" where they can.
        lift: of the chosen reading; None where too little moves to decide.
    """

    recorded: RecordedKeypoints
    notes: tuple[str, ...]
    refusal: str
    lift: float | None


@dataclass(frozen=True)
class Film:
    """The film that keypoints are compared with.

    Attributes:
        motion: in it, None where it cannot be measured.
        map, centre: from recorded pixels, centres at +0.5, to the film's; offset to add to reach +0.5.
        stored_wh: size with pixels as stored, None where they are square.
        layout: of the keypoints by the configuration; path: of their file, for messages.
    """

    camera: str
    wh: tuple[int, int]
    frames: int
    motion: Motion | None
    map: Float[np.ndarray, "2 3"]
    centre: float
    stored_wh: tuple[int, int] | None = None
    layout: str = "auto"
    path: str = ""

    def sizes(self) -> list[Reading]:
        """Readings in pixels of the film's picture at other sizes."""
        return size_readings(self.wh, self.centre, self.stored_wh)


@dataclass(frozen=True)
class _Hypothesis:
    reading: Reading
    numbering: Numbering
    shift: int
    score: Score


def _clearly_better(one: Score, other: Score) -> bool:
    """Whether keypoints are on motion under one reading, and not under the other."""
    return (
        one.enough
        and one.lift > _LIFT
        and one.lift - other.lift > _GAIN
        and other.lift < _SHARE_LEFT * one.lift
        and one.over(other) > _SIGMAS
    )


Others = Callable[[], Mapping[str, RecordedKeypoints]]


def check_against_film(recorded: RecordedKeypoints, numbers: Numberings, film: Film, others: Others) -> Verdict:
    """The verdict on ``recorded`` from its film; raises UserError where no layout fits.

    ``others`` returns the other cameras' keypoints by name, in frames of their own films, if nothing else explains
    these.
    """
    usual = numbers.possible[0]
    if not len(recorded.frame):
        return Verdict(recorded.renumbered(usual.frame_of, film.frames), (), "", None)
    as_read = Reading("pixels of the film", film.map @ np.vstack([affine(1, 1, film.centre, film.centre), [0, 0, 1]]),
                      True)  # fmt: skip
    plain = _plain(recorded.keypoints, as_read, film)
    judge = _Judge(recorded, film, moving_keypoints(recorded.keypoints, recorded.frame), plain[0] is not as_read)
    numbering, described = judge.numbering(numbers, plain)
    if numbering is None:
        return Verdict(recorded.renumbered(usual.frame_of, film.frames), (), described, None)
    chosen = judge.best(plain, numbering)
    said, refusal = ([described] if described else []), ""
    wrong = judge.alternative(chosen, as_read) if chosen.score.enough else None
    if wrong is not None:
        chosen, refusal = judge.taken(wrong, chosen)
    elif is_frozen(recorded.keypoints, recorded.frame) and film.motion is not None and film.motion.busy:
        refusal = (
            f"the keypoints of camera {film.camera} are the same numbers in every picture, and its pictures change; "
            "write every frame's own"
        )
    elif chosen.score.enough and chosen.score.lift < BORNE_OUT:
        refusal = judge.of_another(chosen, others) or judge.unexplained(chosen)
    if chosen.reading is not as_read and not refusal:
        said.append(f"the keypoints of camera {film.camera} are read as {chosen.reading.words}{judge.evidence(chosen)}")
    if chosen.shift and not refusal:
        said.append(judge.shifted(chosen))
    if not refusal:
        said += judge.unmatched(chosen)
    points = convert_keypoints(recorded.keypoints, chosen.reading, as_read)
    # Limbs are compared in the film's pixels: shares of a wide picture stretch them.
    layout, of_limbs = choose_layout(points, film.layout, film.path or f"keypoints of camera {film.camera}")
    said += [of_limbs] if of_limbs else []
    if not refusal and not (chosen.score.enough and chosen.score.lift > _LIFT):
        said += upside_down(film.camera, recorded.keypoints, LAYOUTS[layout].keypoints)
    refusal = refusal or _outside(recorded.keypoints, chosen.reading, film)
    frame_of = chosen.numbering.frame_of - chosen.shift
    if (
        not refusal
        and not ((frame_of >= 0) & (frame_of < film.frames))[np.searchsorted(recorded.pictures, recorded.frame)].any()
    ):
        refusal = (
            f"no person of the keypoints of camera {film.camera} (numbers {recorded.frame[0]} to {recorded.frame[-1]}) "
            f"is in one of its film's {film.frames} frames; write the number of its first frame into capture.yaml: "
            f"keypoint_first_frame: {{{film.camera}: {recorded.frame[0]}}}"
        )
    lift = chosen.score.lift if chosen.score.enough else None
    read = replace(recorded, keypoints=points, layout=layout).renumbered(frame_of, film.frames)
    return Verdict(read, tuple(said), refusal, lift)


@dataclass(frozen=True)
class _Judge:
    """Scores of one camera's keypoints under any reading."""

    recorded: RecordedKeypoints
    film: Film
    moving: Movers
    in_shares: bool

    def under(self, reading: Reading, numbering: Numbering, shift: int = 0) -> _Hypothesis:
        motion = self.film.motion
        if motion is None:
            return _Hypothesis(reading, numbering, shift, Score(0.0, 0.0, np.zeros(0), 0))
        frame = numbering.frame_of[np.searchsorted(self.recorded.pictures, self.recorded.frame)] - shift
        return _Hypothesis(
            reading, numbering, shift, score_reading(self.moving, frame, reading.film_from_recorded, motion)
        )

    def best(self, readings: Sequence[Reading], numbering: Numbering) -> _Hypothesis:
        """The best of ``readings``; the first where the film does not decide."""
        tried = [self.under(reading, numbering) for reading in readings]
        index, top = best_score(enumerate(h.score for h in tried))
        return tried[index] if top.enough and top.over(tried[0].score) > _NUMBER_SIGMAS else tried[0]

    def numbering(self, numbers: Numberings, plain: Sequence[Reading]) -> tuple[Numbering | None, str]:
        """The numbering that fits the film, and a sentence where there was a choice; else None and the reason."""
        camera, first = self.film.camera, numbers.possible[0]
        tried = [self.best(plain, one) for one in numbers.possible]
        index, top = best_score(enumerate(h.score for h in tried))
        if index == 0:
            sure = top.enough and all(top.over(h.score) > _NUMBER_SIGMAS for h in tried[1:])
        elif numbers.certain:
            sure = _clearly_better(top, tried[0].score)
        else:
            sure = top.enough and top.over(tried[0].score) > _NUMBER_SIGMAS
        by = "" if index == 0 and numbers.certain else ", by the motion in its pictures"
        index, sure, by = (0, True, "") if numbers.certain and not sure else (index, sure, by)
        pictures = self.recorded.pictures
        span = f"the keypoints of camera {camera} are numbered {pictures[0]} to {pictures[-1]}, and its film has "
        span += f"{self.film.frames} frames"
        remedy = f"write keypoint_first_frame: {{{camera}: NUMBER}} into capture.yaml"
        if sure:
            words = numbers.possible[index].words
            return numbers.possible[index], f"{span}: {words}{by}" if words else ""
        if not numbers.is_plausible:
            return None, f"{span}, which leaves its first frame open: {remedy}, such as {first.first}"
        how = first.words or "number 0 is used as its first frame"
        return first, f"{span}: {how}, which its pictures do not confirm; if that is wrong, {remedy}"

    def alternative(self, now: _Hypothesis, as_read: Reading) -> _Hypothesis | None:
        """Another reading that clearly fits while ``now`` clearly does not; None without one."""
        wh, unit = self.film.wh, now.reading.film_from_recorded
        on_its_side = affine(wh[1], wh[0]) if self.in_shares else unit
        readings = turned_readings(wh, unit, on_its_side)
        if not self.in_shares:
            readings += self.film.sizes()
        tried = [self.under(reading, now.numbering) for reading in readings]
        tried += [self.under(now.reading, now.numbering, s) for s in range(-_SHIFTS, _SHIFTS + 1) if s]
        index, top = best_score(enumerate(h.score for h in tried))
        right = _clearly_better(top, now.score)
        found = tried[index]
        return found if right and (not found.shift or abs(found.shift) >= MIN_SHIFT) else None

    def taken(self, right: _Hypothesis, now: _Hypothesis) -> tuple[_Hypothesis, str]:
        """The hypothesis to use, and a refusal where it may swap left and right or is not exact; "" otherwise."""
        camera = self.film.camera
        if right.shift:
            near = [self.under(right.reading, right.numbering, right.shift + s) for s in (-1, 1)]
            if all(right.score.over(h.score) > _NUMBER_SIGMAS for h in near):
                return right, ""
            first = right.numbering.first + right.shift
            return now, (
                f"the keypoints of camera {camera} match the motion in its pictures if they are numbered about "
                f"{abs(right.shift)} frames {'later' if right.shift > 0 else 'earlier'}{self.evidence(right, now)}; "
                f"write the number of its first frame into capture.yaml: keypoint_first_frame: {{{camera}: {first}}}"
            )
        if right.reading.lossless:
            rivals = [
                h for r in self.film.sizes() if (h := self.under(r, right.numbering)).score.enough
                and h.reading.words != right.reading.words and not right.score.over(h.score) > 1.0
            ]  # fmt: skip
            if not rivals:
                return right, ""
            return now, (
                f"the keypoints of camera {camera} are of another picture size: {right.reading.words}, or "
                f"{rivals[0].reading.words}{self.evidence(right, now)}; write them in pixels of its film, "
                f"{self.film.wh[0]}×{self.film.wh[1]}"
            )
        return now, (
            f"the keypoints of camera {camera} seem {right.reading.words}{self.evidence(right, now)}; write them as "
            "in its film, x from the left and y from the top, and run again"
        )

    def by_chance(self, found: Score) -> bool:
        """Whether keypoints of moving people fit the film's motion no better than chance."""
        motion = self.film.motion
        return (
            motion is not None
            and motion.busy
            and found.points >= _CHANCE_POINTS
            and found.lift < _CHANCE
            and found.sigmas < _CHANCE_SIGMAS
        )

    def of_another(self, now: _Hypothesis, others: Others) -> str:
        """The camera whose film these keypoints fit clearly better, as a refusal; "" where there is none."""
        camera, motion = self.film.camera, self.film.motion
        assert motion is not None
        for other, seen in others().items():
            fits = score_reading(
                moving_keypoints(seen.keypoints, seen.frame), seen.frame, now.reading.film_from_recorded, motion
            )
            if _clearly_better(fits, now.score):
                return (
                    f"the film of camera {camera} matches the keypoints of camera {other} ({fits.hit:.0%} of them "
                    f"are on moving pixels, {now.score.hit:.0%} of its own): exchange the films or the keypoints of "
                    "the two"
                )
        return ""

    def unexplained(self, now: _Hypothesis) -> str:
        """A refusal where the keypoints fit the motion no better than chance; "" where they fit, if poorly."""
        if not self.by_chance(now.score):
            return ""
        camera = self.film.camera
        return (
            f"the keypoints of camera {camera} do not match the motion in its pictures ({now.score.hit:.0%} on "
            "moving pixels, as by chance), in any order of frames, size or rotation that was tried: bring the "
            "keypoints of this film, in the order of its frames, or leave the camera out (train: [...] in "
            "capture.yaml)"
        )

    def unmatched(self, now: _Hypothesis) -> list[str]:
        """Warnings of people without motion in the film, and of motion without people."""
        motion, seen, camera = self.film.motion, self.recorded, self.film.camera
        if motion is None:
            return []
        if not motion.busy and now.score.points >= _CHANCE_POINTS:
            shown = apply_reading(now.reading.film_from_recorded, seen.keypoints[..., :2])
            share = len(self.moving.person) / max(len(_points(seen.keypoints)), 1)
            return without_motion(camera, shown[..., 1] / self.film.wh[1], seen.keypoints, share)
        shifts = range(now.shift - MAX_MISSING - 1, now.shift + MAX_MISSING + 2)
        lift = {s: self.under(now.reading, now.numbering, s).score.per_frame for s in shifts}
        change = shift_change(motion.frame, lift, now.shift) if now.score.enough else None
        partly = with_missing_frames(camera, change, _NUMBER_SIGMAS, _CHANCE) or without_match(
            camera, motion.frame, now.score.per_frame, _CHANCE, _LIFT
        )
        if partly or not (now.score.enough and now.score.lift > _LIFT):
            return partly
        recorded = now.numbering.frame_of - now.shift
        return without_people(camera, motion, recorded[np.searchsorted(seen.pictures, seen.frame)], recorded)

    def evidence(self, right: _Hypothesis, now: _Hypothesis | None = None) -> str:
        """The film's evidence, in brackets."""
        if not right.score.enough:
            return ""
        before = f", {now.score.hit:.0%} as they are" if now else ""
        return f" ({right.score.hit:.0%} of moving people are on moving pixels{before})"

    def shifted(self, right: _Hypothesis) -> str:
        """A sentence that frames were counted otherwise."""
        first = right.numbering.first + right.shift
        return (
            f"the keypoints of camera {self.film.camera} are read so that number {first} is its film's first "
            f"frame{self.evidence(right)}"
        )


def _plain(keypoints: Num[np.ndarray, "D K 3"], as_read: Reading, film: Film) -> list[Reading]:
    """Possible units of keypoints by their extent, the likeliest first."""
    points = np.abs(_points(keypoints))
    if not len(points) or np.quantile(points, 0.99) > _SHARES_WITHIN or min(film.wh) < _SMALLEST_PX:
        return [as_read]
    both = share_readings(film.wh, film.centre)
    return [both[1], both[0]] if np.quantile(_points(keypoints), 0.05) < _BELOW_0 else both


def _outside(keypoints: Num[np.ndarray, "D K 3"], reading: Reading, film: Film) -> str:
    """A refusal where most keypoints are beyond the film's border under ``detections``; "" otherwise."""
    points = _points(keypoints)
    shown = apply_reading(reading.film_from_recorded, points)
    outside = float(((shown < 0) | (shown > film.wh)).any(-1).mean()) if len(points) else 0.0
    if outside <= _OUTSIDE:
        return ""
    high = points.max(0)
    return (
        f"{outside:.0%} of the keypoints of camera {film.camera} are outside of its {film.wh[0]}×{film.wh[1]} film "
        f"(they reach {high[0]:.0f}, {high[1]:.0f}): they are of another picture size; write them in pixels of the "
        "film"
    )


def _points(keypoints: Num[np.ndarray, "D K 3"]) -> Float[np.ndarray, "N 2"]:
    """The keypoints that are present."""
    there = np.isfinite(keypoints).all(-1) & (keypoints[..., 2] > 0) & (keypoints[..., :2] != 0).any(-1)
    return keypoints[there][:, :2]
