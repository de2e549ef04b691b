# SPDX-License-Identifier: Apache-2.0
"""``clocks.moments``: lags by sound and motion, and the stretches of every film in which people are looked for first.

Cameras and clocks are checked on people at common moments, so every film's stretches are chosen by what sound and
motion say of the clocks. A short take is one stretch.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.clocks import motion, sound
from studiorecon.clocks.offsets import Settings as Settings
from studiorecon.clocks.offsets import applied_clock, open_films
from studiorecon.clocks.posterior import MAX_HALF_S, Lag, choose_reference, estimate_offsets, write_lags
from studiorecon.clocks.timeline import Timeline, clock_as_filmed, common_moments
from studiorecon.footage.sound_track import read_sound
from studiorecon.footage.source import FootageSource
from studiorecon.progress import progress
from studiorecon.scene.clocks import Clocks
from studiorecon.scene.moments import Stretch, write_moments
from studiorecon.signature import Written

# Seconds of a stretch: a person takes two or three steps.
_STRETCH_S = 1.5
# Seconds of the first one where neither sound nor motion give the clocks, and people have to: cameras started by hand,
# one after the other, must share a part of it.
_APART_S = 15.0
# Seconds from the start of the films in which motion is compared: the next ones where those before are not enough.
_MOTION_S = 20.0, 90.0
# Most stretches of a take: enough where somebody is in one of six.
_MOST = 20
# At least three stretches of a film are searched; a film of at most this multiple of their seconds is searched whole.
_WHOLE = 4 / 3
# Stretches of one film nearer than this are one: the pictures between are decoded anyway.
_JOINED_S = 0.5


def signal_lags(
    films: Sequence[FootageSource | None], lines: Sequence[Timeline], paths: Sequence[Path]
) -> tuple[list[Lag], dict[str, dict[int, str]]]:
    """Lags by sound, and by motion unless sound links all cameras; by source the reason for every camera without."""
    heard, why = sound.sound_lags([read_sound(p) if film else None for p, film in zip(paths, films)], lines)
    if linked(heard, len(films)):
        return heard, {"sound": why}
    clocks = [clock_as_filmed("", line) for line in lines]
    rate = float(np.median([clock.fps for clock in clocks]))
    for seconds in _MOTION_S:
        energies = [motion.read_motion_energy(f, seconds) if f else np.zeros(0) for f in progress(films, "motion")]
        moved, still = motion.motion_lags(energies, clocks, rate)
        if linked(heard + moved, len(films)) or all(line.frames <= seconds * line.fps for line in lines):
            break
    return heard + moved, {"sound": why, "motion": still}


def linked(lags: Sequence[Lag], cameras: int) -> bool:
    """Whether every camera has a known offset from the reference."""
    offsets = estimate_offsets(lags, cameras, choose_reference(lags, cameras))
    return all(offset.half_s <= MAX_HALF_S for offset in offsets)


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


def run(
    settings: Settings,
    cameras: list[str],
    sources: list[Path],
    starts: str,
    first_frame: int,
    frame_count: int,
    whole: int,
    lags: Written,
    moments: Written,
) -> None:
    """Write ``lags`` and ``moments`` (JSON) of the footage ``sources``.

    ``starts``, ``first_frame`` and ``frame_count`` as for ``clocks.offsets``. ``whole``: 1 to look at whole films.
    """
    films, lines = open_films(sources, settings.picture_fps)
    filmed = [clock_as_filmed(c, line) for c, line in zip(cameras, lines)]
    rate, given = float(np.median([clock.fps for clock in filmed])), json.loads(starts)
    found: list[Lag] = []
    why: dict[str, dict[int, str]] = {}
    if settings.sync != "never" and len(cameras) > 1:
        found, why = signal_lags(films, lines, sources)
    reference = choose_reference(found, len(cameras))
    offsets = estimate_offsets(found, len(cameras), reference)
    verdicts = [applied_clock(o, rate, clock.own_s[-1]) for o, clock in zip(offsets, filmed)]
    if given:
        made = [replace(c, offset_s=-float(given.get(c.camera, 0.0)) / c.fps) for c in filmed]
    else:
        made = [replace(c, offset_s=v.offset_s, drift_ppm=v.drift_ppm) for c, v in zip(filmed, verdicts)]
    common = common_moments(made, first_frame, frame_count)
    # Motion may be another person's: then the cameras may as well have been started together.
    sure = given or "motion" not in why
    likely = [common] if sure or common.refusal else [common, replace(common, cameras=tuple(filmed))]
    known = given or not why or linked(found, len(cameras))
    first_s = _STRETCH_S if known else _APART_S
    if whole or all(clock.own_s[-1] <= _WHOLE * (first_s + 2 * _STRETCH_S) for clock in filmed):
        first_s = math.inf
    if common.refusal or (first_s == math.inf and not first_frame and not frame_count):
        chosen = {c.camera: [(0, 0, c.frames)] for c in filmed}
    else:
        chosen = stretches(likely, first_s)
    write_lags(lags, found, why)
    write_moments(moments, chosen)
