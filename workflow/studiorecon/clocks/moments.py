# SPDX-License-Identifier: Apache-2.0
"""``clocks.moments``: lags by sound and motion, and people in as many moments as clocks and calibration need.

Evidence is sequential. Sound comes first, then people in a short stretch in the middle of the films and two more, at
moments that the cameras share by the clocks so far. While an offset is undetermined, motion is compared, then the
stretch is doubled; while a camera has shown people too seldom, more stretches follow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from studiorecon.clocks import motion, sound
from studiorecon.clocks.offsets import Settings as Settings
from studiorecon.clocks.offsets import Take, applied_clock, open_films
from studiorecon.clocks.people import people_lags
from studiorecon.clocks.posterior import MAX_HALF_S, Lag, choose_reference, estimate_offsets, write_lags
from studiorecon.clocks.timeline import Timeline, clock_as_filmed, common_moments
from studiorecon.detector.film_search import Search, search_on
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.footage.sound_track import read_sound
from studiorecon.footage.source import FootageSource
from studiorecon.machine.threads import in_threads
from studiorecon.progress import progress
from studiorecon.scene.clocks import Clock, Clocks
from studiorecon.scene.raw_detections import write_raw_detections
from studiorecon.signature import Written

# Seconds of a stretch: a person takes two or three steps.
_STRETCH_S = 1.5
# Seconds of the first one where people have to give the clocks: it is doubled up to the second while they do not.
_FIRST_S, _LONGEST_S = 5.0, 20.0
# Seconds from the start of the films in which motion is compared: the next ones where those before are not enough.
_MOTION_S = 20.0, 90.0
# Stretches that are searched in any case, the start, the middle and the end of a take; and the most of a take, enough
# where somebody is in one of six.
_MIN_STRETCHES, _MOST = 3, 20
# A film of at most this multiple of their seconds is searched whole.
_WHOLE = 4 / 3
# Stretches of one film nearer than this are one: the pictures between are decoded anyway.
_JOINED_S = 0.5

Stretch = tuple[int, int, int]
"""Number of a stretch of the take, the first frame of a part of it in a film, and the number of its frames."""


@dataclass(frozen=True)
class Evidence:
    """Lags by sound and motion, and by source the reason for every camera without one."""

    lags: list[Lag]
    without: dict[str, dict[int, str]]


def unlinked(lags: Sequence[Lag], cameras: int) -> list[int]:
    """The cameras without a known offset from the reference."""
    offsets = estimate_offsets(lags, cameras, choose_reference(lags, cameras))
    return [c for c, offset in enumerate(offsets) if offset.half_s > MAX_HALF_S]


def stretches(likely: Sequence[Clocks], first_s: float) -> dict[str, list[Stretch]]:
    """camera → stretches of its film at moments of the ``likely`` clocks, which have the same; the first one, of
    ``first_s`` seconds, in the middle.

    The order of stretches is that in which they are looked at: any first few of them are spread over the take.
    """
    common = likely[0]
    first, short = (max(1, round(min(seconds * common.fps, common.frames))) for seconds in (first_s, _STRETCH_S))
    count = min(_MOST, common.frames // short)
    found: dict[str, list[Stretch]] = {clock.camera: [] for clock in common.cameras}
    # Numbers with their binary digits reversed are spread, wherever their sequence ends.
    order = sorted(range(count), key=lambda k: f"{(k - count // 2) % count:08b}"[::-1])
    for number, k in enumerate(order):
        length = short if number else first
        begin = min(max(round((k + 0.5) * common.frames / count - length / 2), 0), common.frames - length)
        for camera, own in found.items():
            frames = np.unique([clocks.source_frames(camera)[begin : begin + length] for clocks in likely])
            for part in np.split(frames, np.flatnonzero(np.diff(frames) > _JOINED_S * common.fps) + 1):
                own.append((number, int(part[0]), int(part[-1] - part[0]) + 1))
    return found


def chosen_stretches(
    likely: Sequence[Clocks], films: Sequence[Clock], first_s: float, part: bool
) -> dict[str, list[Stretch]]:
    """camera → ``stretches``; whole ``films`` where these are asked for and not a ``part``, or share no moment."""
    if likely[0].refusal or (first_s == math.inf and not part):
        return {c.camera: [(0, 0, c.frames)] for c in films}
    return stretches(likely, first_s)


@dataclass(frozen=True)
class OffsetSearch:
    """The search of a take's films for people, until all offsets are determined.

    Attributes:
        films, lines, filmed: of every camera: its footage, None where it cannot be read, with its times, and its clock
            as filmed.
        uses_people: people give offsets that sound does not.
        first_s: seconds of the first stretch; inf: the whole films.
    """

    take: Take
    films: Sequence[FootageSource | None]
    lines: Sequence[Timeline]
    filmed: Sequence[Clock]
    uses_people: bool = False
    first_s: float = math.inf

    @property
    def rate(self) -> float:
        """Frames per second of the median camera."""
        return float(np.median([clock.fps for clock in self.filmed]))

    def sound(self) -> Evidence:
        """The lags by sound."""
        tracks = [read_sound(p) if film else None for p, film in zip(self.take.sources, self.films)]
        heard, why = sound.sound_lags(tracks, self.lines)
        return Evidence(heard, {"sound": why})

    def with_motion(self, before: Evidence, people: Sequence[Lag]) -> Evidence:
        """The evidence with lags by motion, from as much of the films as links all cameras with ``people``'s help."""
        clocks = [clock_as_filmed("", line) for line in self.lines]
        unread = [motion.read_motion_energy(film, max(_MOTION_S)) if film else iter(()) for film in self.films]
        energies = [np.zeros(0) for _ in self.films]
        for seconds in _MOTION_S:
            more = [max(round(seconds * line.fps) - 1 - len(own), 0) for line, own in zip(self.lines, energies)]
            read = progress(in_threads(lambda own, n: list(islice(own, n)), unread, more), "motion", len(more))
            energies = [np.append(own, new) for own, new in zip(energies, read)]
            moved, still = motion.motion_lags(energies, clocks, self.rate)
            with_it = Evidence([*before.lags, *moved], {**before.without, "motion": still})
            compared = all(line.frames <= seconds * line.fps for line in self.lines)
            if compared or not unlinked([*with_it.lags, *people], len(self.films)):
                break
        return with_it

    def likely(self, known: Sequence[Lag]) -> list[Clocks]:
        """The clocks by the ``known`` lags; and as filmed, where these may be wrong."""
        filmed, given = self.filmed, self.take.starts_frames
        offsets = estimate_offsets(known, len(filmed), choose_reference(known, len(filmed)))
        verdicts = [applied_clock(o, self.rate, clock.own_s[-1]) for o, clock in zip(offsets, filmed)]
        if given:
            made = [replace(c, offset_s=-float(given.get(c.camera, 0.0)) / c.fps) for c in filmed]
        else:
            made = [replace(c, offset_s=v.offset_s, drift_ppm=v.drift_ppm) for c, v in zip(filmed, verdicts)]
        common = common_moments(made, self.take.first_frame, self.take.frame_count)
        # Motion may be another person's: then the cameras may as well have been started together.
        sure = given or common.refusal or not any(lag.source == motion.MOTION for lag in known)
        return [common] if sure else [common, replace(common, cameras=tuple(filmed))]

    def run(self, searches: dict[str, Search], signals: Evidence) -> tuple[list[Search], Evidence]:
        """The ``searches`` and the evidence once every offset is determined and every searched film shows people, or
        once more of the films would add neither."""
        first_s, upto, people = self.first_s, _MIN_STRETCHES, list[Lag]()
        while True:
            likely = self.likely([*signals.lags, *people])
            chosen = chosen_stretches(likely, self.filmed, first_s, self.take.is_part)
            searches = search_on(searches, {c: [one[1:] for one in chosen[c] if one[0] < upto] for c in searches})
            unknown = []
            if self.uses_people:
                seen = [one.tracked() for one in searches.values() if len(one.found.frame)]
                people, _ = people_lags(seen, self.filmed, self.rate)
                unknown = unlinked([*signals.lags, *people], len(self.filmed))
            shown = [c for c in unknown if (own := searches.get(self.filmed[c].camera)) and len(own.found.frame)]
            if unknown and "motion" not in signals.without:
                signals = self.with_motion(signals, people)
            elif shown and first_s < _LONGEST_S:
                first_s *= 2
            elif upto < len(next(iter(chosen.values()))) and any(one.shows_few() for one in searches.values()):
                upto += 1
            else:
                return list(searches.values()), signals


def run(
    settings: Settings,
    take: Take,
    whole: int,
    lags: Written,
    searched: list[str],
    detector: DetectorFiles,
    found: list[Written],
) -> None:
    """Write ``lags`` (JSON) of the ``take``'s footage, and who was ``found`` (npz) in moments of each ``searched``
    camera's. ``whole``: 1 to search whole films."""
    films, lines = open_films(take.sources, settings.picture_fps)
    filmed = [clock_as_filmed(c, line) for c, line in zip(take.cameras, lines)]
    search = OffsetSearch(take, films, lines, filmed)
    wanted, signals = settings.sync != "never" and len(filmed) > 1, Evidence([], {})
    uses_people = wanted and bool(searched) and not take.starts_frames and not take.is_part
    if wanted:
        signals = search.sound()
        if not uses_people and unlinked(signals.lags, len(filmed)):
            signals = search.with_motion(signals, [])
    first_s = _FIRST_S if uses_people and unlinked(signals.lags, len(filmed)) else _STRETCH_S
    if whole or all(clock.own_s[-1] <= _WHOLE * (first_s + 2 * _STRETCH_S) for clock in filmed):
        first_s = math.inf
    search = replace(search, uses_people=uses_people, first_s=first_s)
    network, worth = (detector.detector(), detector.worth()) if searched else (None, {})
    searches = {c: Search.of(c, film, network, worth) for c, film in zip(take.cameras, films) if c in searched}
    done, signals = search.run(searches, signals) if searches else ([], signals)
    write_lags(lags, signals.lags, signals.without)
    for one, path in zip(done, found, strict=True):
        write_raw_detections(path, one.found)
        one.log()
