# SPDX-License-Identifier: Apache-2.0
"""``clocks.offsets``: the start time of every camera, from its sound, people and motion.

It runs before decoding, because the clocks decide which frames are used. Inputs are raw footage and raw keypoints, so
that no result depends on the clocks already.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from studiorecon.camera_files.calibration import read_lenses
from studiorecon.clocks import people
from studiorecon.clocks.posterior import (
    MAX_HALF_S,
    Lag,
    Offset,
    choose_reference,
    estimate_offsets,
    read_lags,
)
from studiorecon.clocks.stretches import lost_frames_notes
from studiorecon.clocks.timeline import Timeline, clock_as_filmed, common_moments, read_timeline
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.duplicate_films import compare_views
from studiorecon.footage.source import FootageSource, PictureRate, open_source, timing_irregularities
from studiorecon.keypoints.film_colours import colour_notes
from studiorecon.machine.threads import in_threads
from studiorecon.progress import say, warn
from studiorecon.scene.clocks import Clock, write_clocks
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

# A smaller offset, frames, is not worth resampling; a smaller drift over the whole clip counts as none.
_NEGLIGIBLE_FRAMES = 0.1


@dataclass(frozen=True)
class Settings(PictureRate):
    """How clocks are estimated, and the rate of footage that has none."""

    sync: Literal["auto", "report", "never"] = setting(
        "auto",
        "Time offsets from sound, people and motion: auto applies them, report only reports, never "
        "skips. starts in capture.yaml takes precedence.",
    )


@dataclass(frozen=True)
class Take:
    """The films of a capture, and the part of them that is used.

    Attributes:
        cameras, sources: names and footage, in the same order.
        starts: JSON, camera → frame of its footage at one common moment, from the user; empty: unknown.
        first_frame, frame_count: chosen among the moments that all cameras have (0: all).
    """

    cameras: list[str]
    sources: list[Path]
    starts: str = "{}"
    first_frame: int = 0
    frame_count: int = 0

    @property
    def starts_frames(self) -> Mapping[str, float]:
        """``starts`` as numbers."""
        given: dict[str, float] = json.loads(self.starts)
        return given

    @property
    def is_part(self) -> bool:
        """Whether only a part of the films is used."""
        return bool(self.first_frame or self.frame_count)


@dataclass(frozen=True)
class ClockVerdict:
    """The correction of a camera's clock, with its reason.

    Attributes:
        kind: "reference", "in step", "found", or "undetermined": then the camera stays as filmed.
        offset_s, half_s, drift_ppm: to be applied, with half of the 95 % interval (inf: unknown).
        method: the sharpest source that agrees.
        reason: why it is undetermined.
    """

    kind: str
    offset_s: float = 0.0
    half_s: float = math.inf
    drift_ppm: float = 0.0
    method: str = ""
    reason: str = ""


def applied_clock(offset: Offset, fps: float, seconds: float, triggered: bool = True) -> ClockVerdict:
    """The correction for an estimated offset; "in step" where the interval does not exclude the camera as filmed.

    Where cameras were not ``triggered`` together there is no such prior: then any estimated offset counts, however
    small.
    """
    if not math.isfinite(offset.half_s):
        return ClockVerdict("undetermined", reason="no estimate")
    if offset.rival_s is not None:
        both = f"{signed(offset.seconds)} s and {signed(offset.rival_s)} s"
        return ClockVerdict("undetermined", reason=f"{both} explain the estimates about equally well")
    if offset.half_s > MAX_HALF_S:
        return ClockVerdict("undetermined", reason=f"the estimate is only known to ± {offset.half_s:.2f} s")
    drift = offset.drift_ppm if abs(offset.drift_ppm) * 1e-6 * seconds * fps > _NEGLIGIBLE_FRAMES else 0.0
    # An interval wider than a frame determines a frame and no fraction; and a fraction may be too small to matter.
    whole = round(offset.seconds * fps) / fps
    beside = abs(offset.seconds - whole) * fps
    on_the_beat = not drift and (offset.half_s > 1 / fps or beside <= _NEGLIGIBLE_FRAMES)
    applied = whole if on_the_beat else offset.seconds
    if not drift and abs(offset.seconds) <= max(offset.half_s if triggered else 0.0, _NEGLIGIBLE_FRAMES / fps):
        applied = 0.0
    # The interval around the applied value still covers the estimated one.
    half_s = offset.half_s + abs(applied - offset.seconds)
    return ClockVerdict("found" if drift or applied else "in step", applied, half_s, drift)


def clock_sentence(
    camera: str, verdict: ClockVerdict, alone: Mapping[str, Offset], why: Mapping[str, str], reference: str, fps: float
) -> str:
    """One sentence about one camera's clock, with the estimate of every source ``alone``."""
    text = [f"{source} {signed(o.seconds)} ± {o.half_s:.3f} s" for source, o in alone.items()]
    text += [f"{source}: {reason}" for source, reason in why.items()]
    if verdict.kind == "in step":
        return f"{camera}: in step with {reference} within {verdict.half_s:.3f} s ({'; '.join(text)})"
    if verdict.kind == "found":
        frames, ppm = verdict.offset_s * fps, verdict.drift_ppm
        drift = f", its clock {abs(ppm):.0f} ppm {'slow' if ppm > 0 else 'fast'}" if ppm else ""
        return (
            f"{camera}: started {abs(verdict.offset_s):.3f} ± {verdict.half_s:.3f} s ({abs(frames):.2f} frames) "
            f"{'after' if frames > 0 else 'before'} {reference}{drift} ({'; '.join(text)})"
        )
    return f"{camera}: time offset undetermined: {verdict.reason} ({'; '.join(text) or 'nothing to compare'})"


def signed(seconds: float) -> str:
    return f"{'+' if seconds >= 0 else '−'}{abs(seconds):.3f}"


def estimate_clocks(
    cameras: Sequence[str],
    lines: Sequence[Timeline],
    signals: Sequence[Lag],
    without: Mapping[str, dict[int, str]],
    seen: Sequence[Detections],
    lenses: people.Lenses,
) -> tuple[list[ClockVerdict], list[dict[str, Any]], int]:
    """A verdict with its evidence for every camera, and the index of the reference.

    ``signals`` are the lags by sound and motion, ``without`` the reasons of cameras without one, by source; ``lenses``
    may be given, ``seen`` are people by frames of the films.
    """
    clocks = [clock_as_filmed(c, line) for c, line in zip(cameras, lines)]
    rate, count = float(np.median([c.fps for c in clocks])), len(cameras)
    why = dict(without)
    met, why["people"] = people.people_lags(seen, clocks, rate, lenses)
    lags = [*signals, *met]
    reference = choose_reference(lags, count)
    together = estimate_offsets(lags, count, reference)
    names = list(dict.fromkeys(lag.source.name for lag in lags))
    alone = {n: estimate_offsets([lag for lag in lags if lag.source.name == n], count, reference) for n in names}
    seconds = [clock.own_s[-1] for clock in clocks]
    # A camera that was clearly not started with the others: there was no common trigger.
    others = [c for c in range(count) if c != reference]
    triggered = not any(applied_clock(together[c], rate, seconds[c]).kind == "found" for c in others)
    verdicts, findings = [], []
    for c, camera in enumerate(cameras):
        if c == reference:
            verdict, mine, reasons = ClockVerdict("reference", 0.0, 0.0), {}, {}
            sentence = f"{camera}: reference of the time offsets"
        else:
            verdict = applied_clock(together[c], rate, seconds[c], triggered)
            mine = {n: offsets[c] for n, offsets in alone.items() if math.isfinite(offsets[c].half_s)}
            agree = {n: o.half_s for n, o in mine.items() if abs(o.seconds - together[c].seconds) <= 2 * o.half_s}
            if agree and verdict.kind != "undetermined":
                verdict = replace(verdict, method=min(agree, key=agree.__getitem__))
            reasons = {
                n: reason.get(c, "nothing links it with the reference camera")
                for n, reason in why.items()
                if n not in mine
            }
            sentence = clock_sentence(camera, verdict, mine, reasons, cameras[reference], rate)
        proposals = [
            {"method": n, "offset_s": o.seconds, "half_s": o.half_s, "drift_ppm": o.drift_ppm} for n, o in mine.items()
        ]
        verdicts.append(verdict)
        findings.append(
            {"camera": camera, **asdict(verdict), "sentence": sentence, "proposals": proposals, "without": reasons}
        )
    return verdicts, findings, reference


def different_lengths_note(
    clocks: Sequence[Clock],
    sources: Sequence[str],
    findings: Sequence[dict[str, Any]],
    announced: Sequence[int] = (),
) -> str:
    """A sentence about videos of different lengths with unknown clocks; empty otherwise.

    Also empty where their headers ``announced`` equal lengths, so that only their ends are missing.
    """
    unknown = [f["camera"] for f in findings if f["kind"] == "undetermined"]
    shortest, longest = (choose(range(len(clocks)), key=lambda i: clocks[i].frames) for choose in (min, max))
    short, long = clocks[shortest].frames, clocks[longest].frames
    if short == long or not unknown or (len(announced) == len(clocks) and len(set(announced)) == 1):
        return ""
    return (
        f"{sources[shortest]} has {short} frames and {sources[longest]} has {long}, and "
        f"when {', '.join(unknown)} was started is "
        f"undetermined; write frames: {{first: 0, count: {short}}} into capture.yaml if "
        "all were started together, or else starts: "
        "{CAMERA: frame}, the frame of each video that shows one moment"
    )


def run(
    settings: Settings,
    take: Take,
    sightings: list[Path],
    lags: Path,
    clocks: Written,
    findings: Written,
    calibration: list[Path] | None = None,
) -> None:
    """Write ``clocks`` (used by all later steps) and ``findings`` (the evidence) of the ``take``'s footage, both JSON.

    ``sightings`` exist for cameras with known people, in any order; ``lags`` are those by sound and motion. Starts that
    the user gives count. ``calibration``: none or one file, the user's own, which makes people's evidence sharper.
    """
    cameras, sources, given = take.cameras, take.sources, take.starts_frames
    opened, lines = open_films(sources, settings.picture_fps)
    made = [clock_as_filmed(c, line) for c, line in zip(cameras, lines)]
    for clock, source in zip(made, sources):
        if clock.times_s:
            say(
                f"{source.name}: {timing_irregularities(clock.times_s, 0) or 'frames do not come evenly'}; "
                "every frame is taken at its own time"
            )
    found: list[dict[str, Any]] = []
    films = {camera: source for camera, source in zip(cameras, opened) if source is not None}
    seen = [read_detections(path) for path in sightings]
    lost: list[str] = []
    read = read_lenses(calibration[0]) if calibration else {}
    if settings.sync != "never" and len(cameras) > 1:
        lenses = {c: (read[c], film.wh) for c, film in films.items() if c in read}
        verdicts, found, reference = estimate_clocks(cameras, lines, *read_lags(lags), seen, lenses)
        in_step = [f["camera"] for f in found if f["kind"] in ("reference", "in step")]
        lost = lost_frames_notes(seen, made, float(np.median([c.fps for c in made])), lenses, in_step)
        # Cameras that were not started together: then an unknown clock matters.
        apart = any(f["kind"] == "found" for f in found)
        for f in found:
            loud = apart and (f["kind"] == "undetermined" or (f["kind"] == "found" and settings.sync == "report"))
            (warn if loud and not given else say)(f["sentence"])
        if settings.sync == "auto" and not given:
            made = [replace(c, offset_s=v.offset_s, drift_ppm=v.drift_ppm) for c, v in zip(made, verdicts)]
        if given:
            _compare_with_given(given, found, made, cameras[reference])
    if given:
        made = [replace(c, offset_s=-float(given.get(c.camera, 0.0)) / c.fps) for c in made]
    common = common_moments(made, take.first_frame, take.frame_count)
    if not given and not take.frame_count and not common.refusal and (settings.sync != "auto" or found):
        unsure = found if settings.sync == "auto" else [{"camera": c, "kind": "undetermined"} for c in cameras]
        names, promised = [f"{s.parent.name}/{s.name}" for s in sources], [s.announced for s in opened if s]
        common = replace(common, refusal=different_lengths_note(made, names, unsure, promised))
    twice, moved = compare_views(films)
    unlike = [*colour_notes(films, seen, read), *moved, *lost]
    for sentence in unlike:
        warn(sentence)
    common = replace(common, refusal=twice or common.refusal)
    write_json(findings, {"sync": settings.sync, "given": dict(given), "cameras": found, "films": unlike})
    write_clocks(clocks, common)
    if common.refusal:
        warn(common.refusal)
        return
    used = ", ".join(f"{c} from frame {common.source_frames(c)[0]}" for c in cameras)
    say(f"{common.frames} moments at {common.fps:g} per second: {used}")


def open_films(sources: Sequence[Path], picture_fps: float) -> tuple[list[FootageSource | None], list[Timeline]]:
    """Every camera's footage as far as readable; otherwise a message, and the others' timeline until it is decoded."""

    def opened(path: Path) -> tuple[FootageSource, Timeline] | UserError:
        try:
            source = open_source(path, picture_fps)
            return source, read_timeline(source)
        except UserError as refusal:
            return refusal

    found = list(in_threads(opened, sources))
    for refusal in found:
        if isinstance(refusal, UserError):
            warn(str(refusal))
    films, lines = zip(*((None, None) if isinstance(one, UserError) else one for one in found))
    readable = [line for line in lines if line is not None]
    if not readable:
        raise UserError(f"none of the {len(sources)} videos can be read, {sources[0]} among them; copy them again")
    shortest = min(readable, key=lambda line: line.frames)
    return list(films), [line or replace(shortest, first_s=0.0) for line in lines]


def _compare_with_given(
    given: Mapping[str, float], found: Sequence[dict[str, Any]], clocks: Sequence[Clock], reference: str
) -> None:
    """Warn where the user's starts differ from the estimate by more than the interval and a frame."""
    fps = {c.camera: c.fps for c in clocks}
    for f in (f for f in found if f["kind"] in ("in step", "found")):
        camera = f["camera"]
        given_s = given.get(reference, 0.0) / fps[reference] - given.get(camera, 0.0) / fps[camera]
        if abs(given_s - f["offset_s"]) > f["half_s"] + 1 / fps[camera]:
            warn(
                f"starts in capture.yaml puts {camera} {signed(given_s)} s after {reference}, which is "
                f"used; but {f['sentence']}"
            )
