# SPDX-License-Identifier: Apache-2.0
"""``clocks.offsets``: the start time of every camera, from its sound, people and motion.

It runs before decoding, because the clocks decide which frames are used. Inputs are raw footage and raw keypoints, so
that no result depends on the clocks already.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.camera_files.calibration import read_lenses
from studiorecon.clocks import motion_clock as sync
from studiorecon.clocks import offset_consensus as consensus
from studiorecon.clocks import sound
from studiorecon.clocks.offset_consensus import HALF, ClockVerdict, Pair, Proposal
from studiorecon.clocks.people_clock import Lenses, people_pair
from studiorecon.clocks.rig_offsets import offsets_vs_rig
from studiorecon.clocks.timeline import Timeline, clock_as_filmed, common_moments, read_timeline
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.duplicate_films import duplicate_film_note
from studiorecon.footage.sound_track import read_sound
from studiorecon.footage.source import FootageSource, PictureRate, open_source, timing_irregularities
from studiorecon.keypoints.film_colours import colour_notes
from studiorecon.progress import progress, say, warn
from studiorecon.scene.camera import Lens
from studiorecon.scene.clocks import Clock, write_clocks
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Float

# Sound needs 3 ms a metre and the speaker's position is unknown: sigma for 1.5 m of difference between two cameras.
_TRAVEL_S = 1.5 / 343
# Every sound track is compared with those of so many cameras; more only cost time.
_HUBS = 3
# Clocks with a smaller half of the 95 % interval, seconds, are not estimated by further methods.
_SHARP_S = 0.02
# Cameras in which motion must be proved wrong before it is distrusted in the others.
_PROOFS = 2


@dataclass(frozen=True)
class Settings(PictureRate):
    """How clocks are estimated, and the rate of footage that has none."""

    sync: Literal["auto", "report", "never"] = setting(
        "auto",
        "Time offsets from sound, people and motion: auto applies them, report only reports, never "
        "skips. starts in capture.yaml takes precedence.",
    )


def sound_pairs(
    sounds: Sequence[Float[np.ndarray, " N"] | None], lines: Sequence[Timeline]
) -> tuple[list[Pair], dict[int, str]]:
    """Pairs of cameras whose sound tracks determine a lag, and the reason for every camera without one."""
    there = {i: s for i, s in enumerate(sounds) if s is not None}
    reasons = {i: "its video has no sound" for i in range(len(sounds)) if i not in there}
    wanted = [(a, b) for a, b in itertools.combinations(there, 2) if a in list(there)[:_HUBS]]
    pairs = []
    for a, b in progress(wanted, "sound tracks"):
        heard = sound.compare(there[a], there[b])
        if not heard.valid:
            reasons.setdefault(b, heard.reason)
            reasons.setdefault(a, heard.reason)
            continue
        # By the first one's clock: t_a = (1 + d) (t_b + lag - d middle), on the files' own time lines.
        clear = abs(heard.drift_ppm) > 3 * heard.drift_sigma_ppm
        drift = 1e-6 * heard.drift_ppm if clear else 0.0
        offset = (1 + drift) * (lines[b].first_s + heard.lag_s - drift * heard.middle_s) - lines[a].first_s
        pairs.append(Pair(a, b, offset, heard.sigma_s, heard.drift_ppm, heard.drift_sigma_ppm))
    for i in {c for p in pairs for c in (p.first, p.second)}:
        reasons.pop(i, None)
    return pairs, reasons


def motion_pairs(
    energies: Sequence[Float[np.ndarray, " T"]], clocks: Sequence[Clock], rate: float
) -> tuple[list[Pair], dict[int, str]]:
    """The same from the amount of change in the pictures over time."""
    rows = [_on_a_grid(e, c, rate) for e, c in zip(energies, clocks)]
    pairs: list[Pair] = []
    reasons: dict[int, str] = {}
    for a, b in itertools.combinations(range(len(rows)), 2):
        lag = sync.compare(rows[a], rows[b], rate)
        if lag.valid:
            pairs.append(Pair(a, b, -lag.rows / rate, lag.sigma_rows / rate))
        else:
            reasons.setdefault(a, lag.reason)
            reasons.setdefault(b, lag.reason)
    for i in {c for p in pairs for c in (p.first, p.second)}:
        reasons.pop(i, None)
    return pairs, reasons


def _on_a_grid(energy: np.ndarray, clock: Clock, rate: float) -> np.ndarray:
    if len(energy) < 2 or (not clock.times_s and abs(clock.fps - rate) < 1e-6):
        return energy
    own = clock.own_s[: len(energy) + 1]
    middles = (own[1:] + own[:-1])[: len(energy)] / 2
    per_second = energy[: len(middles)] / np.maximum(np.diff(own)[: len(energy)], 1e-6) / rate
    return np.interp(np.arange(0.5 / rate, own[-1], 1 / rate), middles, per_second)


def clock_sentence(
    camera: str,
    verdict: ClockVerdict,
    proposals: Sequence[Proposal],
    why: Mapping[str, str],
    reference: str,
    fps: float,
) -> str:
    """One sentence about one camera's clock, with all proposals."""
    text = [f"{p.method} {_signed(p.offset_s)} ± {p.half_s:.3f} s" for p in proposals]
    text += [f"{method}: {reason}" for method, reason in why.items()]
    if verdict.kind == "in step":
        return f"{camera}: in step with {reference} within {verdict.half_s:.3f} s ({'; '.join(text)})"
    if verdict.kind == "found":
        frames = verdict.offset_s * fps
        way = "after" if frames > 0 else "before"
        drift = (
            f", its clock {abs(verdict.drift_ppm):.0f} ppm {'slow' if verdict.drift_ppm > 0 else 'fast'}"
            if verdict.drift_ppm
            else ""
        )
        return (
            f"{camera}: started {abs(verdict.offset_s):.3f} ± {verdict.half_s:.3f} s "
            f"({abs(frames):.2f} frames) {way} {reference}{drift} "
            f"({'; '.join(text)})"
        )
    return f"{camera}: time offset undetermined: {verdict.reason} ({'; '.join(text) or 'nothing to compare'})"


def _signed(seconds: float) -> str:
    return f"{'+' if seconds >= 0 else '−'}{abs(seconds):.3f}"


def estimate_clocks(
    cameras: Sequence[str],
    sources: Sequence[FootageSource | None],
    lines: Sequence[Timeline],
    paths: Sequence[Path],
    sightings: Sequence[Path],
    lenses: Mapping[str, Lens],
) -> tuple[list[ClockVerdict], list[dict[str, Any]], int]:
    """A verdict with its evidence for every camera, and the index of the reference; ``lenses`` may be given."""
    clocks = [clock_as_filmed(c, line) for c, line in zip(cameras, lines)]
    rate = float(np.median([c.fps for c in clocks]))
    count = len(cameras)
    pairs: dict[str, list[Pair]] = {}
    why: dict[str, dict[int, str]] = {}
    sounds = [read_sound(path) if source else None for path, source in zip(paths, sources)]
    pairs["sound"], why["sound"] = sound_pairs(sounds, lines)
    sized = {c: (lenses[c], source.wh) for c, source in zip(cameras, sources) if source and c in lenses}
    seen = [read_detections(p) for p in sightings]
    pairs["people"], why["people"] = people_pair(seen, clocks, rate, sized)
    votes = [sum(any(c in (p.first, p.second) for p in pairs[m]) for m in pairs) for c in range(count)]
    if min(votes) < 2:
        energies = [sync.read_motion_energy(s) if s else np.zeros(0) for s in progress(sources, "motion")]
        pairs["motion"], why["motion"] = motion_pairs(energies, clocks, rate)
    reference, proposed = _proposed(pairs, count)
    # Motion in a picture depends on the viewpoint: a person who walks in a circle is nearest to one camera after the
    # other. Where people or sound disprove motion in most cameras, it is distrusted in the others.
    others = [p for m, p in proposed.items() if m != "motion"]
    wrong, both = consensus.count_contradictions(proposed.get("motion", []), others)
    if wrong >= _PROOFS and 2 * wrong > both:
        told_wrong = f"it contradicts people or sound in {wrong} of {both} cameras, so it counts in none"
        pairs["motion"], why["motion"] = [], dict.fromkeys(range(count), told_wrong)
        reference, proposed = _proposed(pairs, count)
    # Where one method covers part of the chain and another the rest.
    every = [p for found in pairs.values() for p in found]
    together = consensus.solve_offsets("several", every, count, reference, _TRAVEL_S)
    verdicts, findings = [], []
    owns = [
        [p for p in (proposed[m][c] for m in pairs) if p is not None] or [p for p in (together[c],) if p is not None]
        for c in range(count)
    ]
    owns = joint_refinement(owns, reference, clocks, seen, sized)
    # A camera that was clearly not started with the others: there was no common trigger.
    triggered = not any(
        consensus.combine_proposals(own, rate, clocks[c].own_s[-1]).kind == "found"
        for c, own in enumerate(owns)
        if c != reference
    )
    for c, camera in enumerate(cameras):
        own = owns[c]
        verdict = (
            ClockVerdict("reference", 0.0, 0.0)
            if c == reference
            else consensus.combine_proposals(own, rate, clocks[c].own_s[-1], triggered)
        )
        reasons = {
            m: why[m].get(c, "nothing links it with the reference camera") for m in pairs if proposed[m][c] is None
        }
        sentence = (
            f"{camera}: reference of the time offsets"
            if c == reference
            else clock_sentence(camera, verdict, own, reasons, cameras[reference], rate)
        )
        verdicts.append(verdict)
        findings.append(
            {
                "camera": camera,
                **asdict(verdict),
                "sentence": sentence,
                "proposals": [] if c == reference else [asdict(p) for p in own],
                "without": {} if c == reference else reasons,
            }
        )
    return verdicts, findings, reference


def joint_refinement(
    owns: Sequence[list[Proposal]], reference: int, clocks: Sequence[Clock], seen: Sequence[Detections], lenses: Lenses
) -> list[list[Proposal]]:
    """The proposals of every camera; all cameras of ``lenses`` together replace people's and motion's pairs where they
    are sharper. ``clocks`` are as filmed."""
    best = [min(own, key=lambda p: p.half_s, default=None) for own in owns]
    unsure = [c for c, p in enumerate(best) if c != reference and clocks[c].camera in lenses]
    if all((p := best[c]) is not None and p.half_s <= _SHARP_S for c in unsure):
        return list(owns)
    set_so = [replace(c, offset_s=p.offset_s, drift_ppm=p.drift_ppm) if p else c for c, p in zip(clocks, best)]
    late = offsets_vs_rig(set_so, seen, lenses)
    if late is None:
        return list(owns)
    asked = []
    for c, own in enumerate(owns):
        half_s = HALF * float(np.hypot(late.sigma_s[c], late.sigma_s[reference]))
        # NaN where undetermined.
        if c != reference and half_s < (p.half_s if (p := best[c]) else np.inf):
            offset_s = set_so[c].offset_s + float(late.seconds[c] - late.seconds[reference])
            together = Proposal("all cameras", offset_s, half_s, set_so[c].drift_ppm, np.inf)
            own = [p for p in own if p.method == "sound"] + [together]
        asked.append(own)
    return asked


def _proposed(pairs: Mapping[str, Sequence[Pair]], count: int) -> tuple[int, dict[str, list[Proposal | None]]]:
    """The reference camera, and every method's proposals for every camera."""
    reference = consensus.choose_reference(pairs, count)
    systematic_s = {"sound": _TRAVEL_S}
    return reference, {
        m: consensus.solve_offsets(m, found, count, reference, systematic_s.get(m, 0.0)) for m, found in pairs.items()
    }


def lengths_differ(
    clocks: Sequence[Clock],
    sources: Sequence[str],
    findings: Sequence[dict[str, Any]],
    announced: Sequence[int] = (),
) -> str:
    """A sentence about videos of different lengths with unknown clocks; empty otherwise.

    Also empty where they were ``announced`` to be equally long and only lost their ends.
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
    cameras: list[str],
    sources: list[Path],
    sightings: list[Path],
    starts: str,
    first_frame: int,
    frame_count: int,
    clocks: Written,
    findings: Written,
    calibration: list[Path] | None = None,
) -> None:
    """Write ``clocks`` (used by all later steps) and ``findings`` (the evidence) of the footage ``sources``, both JSON.

    ``sightings`` exist for cameras with known people, in any order. ``starts``: JSON, camera → frame of its footage at
    one common moment, from the user; then that counts. ``first_frame`` and ``frame_count`` choose among the moments
    that all cameras have (0: all). ``calibration``: none or one file, the user's own, which makes people's evidence
    sharper.
    """
    opened, lines = _opened(sources, settings.picture_fps)
    made = [clock_as_filmed(c, line) for c, line in zip(cameras, lines)]
    for clock, source in zip(made, sources):
        if clock.times_s:
            say(
                f"{source.name}: {timing_irregularities(clock.times_s, 0) or 'frames do not come evenly'}; "
                "every frame is taken at its own time"
            )
    found: list[dict[str, Any]] = []
    given: Mapping[str, float] = json.loads(starts)
    if settings.sync != "never" and len(cameras) > 1:
        lenses = read_lenses(calibration[0]) if calibration else {}
        verdicts, found, reference = estimate_clocks(cameras, opened, lines, sources, sightings, lenses)
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
    common = common_moments(made, first_frame, frame_count)
    if not given and not frame_count and not common.refusal and (settings.sync != "auto" or found):
        unsure = found if settings.sync == "auto" else [{"camera": c, "kind": "undetermined"} for c in cameras]
        names, promised = [f"{s.parent.name}/{s.name}" for s in sources], [s.announced for s in opened if s]
        common = replace(common, refusal=lengths_differ(made, names, unsure, promised))
    films = {camera: source for camera, source in zip(cameras, opened) if source is not None}
    for sentence in colour_notes(films, map(read_detections, sightings)):
        warn(sentence)
    twice = duplicate_film_note(films)
    common = replace(common, refusal=twice or common.refusal)
    write_json(findings, {"sync": settings.sync, "given": dict(given), "cameras": found})
    write_clocks(clocks, common)
    if common.refusal:
        warn(common.refusal)
        return
    used = ", ".join(f"{c} from frame {common.source_frames(c)[0]}" for c in cameras)
    say(f"{common.frames} moments at {common.fps:g} per second: {used}")


def _opened(sources: Sequence[Path], picture_fps: float) -> tuple[list[FootageSource | None], list[Timeline]]:
    """Every camera's footage as far as readable; otherwise a message, and the others' timeline until it is decoded."""
    opened: list[FootageSource | None] = []
    lines: list[Timeline | None] = []
    for path in sources:
        try:
            source = open_source(path, picture_fps)
            opened.append(source)
            lines.append(read_timeline(source))
        except UserError as refusal:
            warn(str(refusal))
            opened[len(lines) :] = [None]
            lines.append(None)
    readable = [line for line in lines if line is not None]
    if not readable:
        raise UserError(f"none of the {len(sources)} videos can be read, {sources[0]} among them; copy them again")
    shortest = min(readable, key=lambda line: line.frames)
    return opened, [line or replace(shortest, first_s=0.0) for line in lines]


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
                f"starts in capture.yaml puts {camera} {_signed(given_s)} s after {reference}, which is "
                f"used; but {f['sentence']}"
            )
