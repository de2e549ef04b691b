# SPDX-License-Identifier: Apache-2.0
"""Errors of time offsets: planted starts, drift, rates and reverberation in sound; the same without sound, from
detected people; cut frames in a real take's keypoints and in the demo's films.

``python -m benchmarks.clocks --data DIR --folder FILMS --results benchmarks/results/clocks.json``; DIR holds
``pose2sim_balancing``, FILMS keeps the demo's films and detections. Errors are in frames at the
stated rate, largest over all cameras and moments; none: undetermined. The real take's own clocks are only known to a
frame or so: lags with frames cut off are compared with the lag as filmed.

Calibrated cameras together: rings of cameras that were moved by a degree and 5 cm since, or as stated, started up to
0.15 s before or after the others, twelve draws each; milliseconds.

Silent films: three uncalibrated cameras, two people who walk about, keypoints with the errors that the embedded
detector has (``tests.made.silent``), three draws each. The demo's films last two seconds, so starts are planted by
leaving out frames: of every second or third one another for one of the cameras, half or a third of a frame apart.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
import time
from collections.abc import Iterable
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.clocks import moments
from studiorecon.clocks import offsets as clocks
from studiorecon.clocks.people import people_lags
from studiorecon.clocks.posterior import MAX_HALF_S, Offset, estimate_offsets
from studiorecon.clocks.timeline import Timeline
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.scene.clocks import Clock, read_clocks
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import Detections, write_detections

from benchmarks.filmed import Filmed, the_demo
from tests.defaults import UNSEARCHED
from tests.made.cameras import ring
from tests.made.silent import Silent, rough, sighted
from tests.made.sound import Recorder, record, world_sound

_FPS = 30.0
_CASES: dict[str, tuple[str, float, list[Recorder]]] = {
    "±10 s": ("speech", 30, [Recorder("a", 10.0), Recorder("b", 20.0), Recorder("c", 0.0)]),
    "±1 frame": ("speech", 15, [Recorder("a", 10.0), Recorder("b", 10 + 1 / _FPS), Recorder("c", 10 - 1 / _FPS)]),
    "±0.4 frame": ("speech", 15, [Recorder("a", 10.0), Recorder("b", 10 + 0.4 / _FPS), Recorder("c", 10 - 0.4 / _FPS)]),
    "50 ppm over 120 s": ("claps", 120, [Recorder("a", 10.0), Recorder("b", 12.0, drift_ppm=50)]),
    "reverberant, muffled, noisy": (
        "speech",
        30,
        [Recorder("a", 10.0, echo=0.3), Recorder("b", 13.3, muffled=0.8, echo=0.3), Recorder("c", 11.0, noise=0.02)],
    ),
    "one clap": ("clap", 10, [Recorder("a", 14.0), Recorder("b", 12.5), Recorder("c", 15.1)]),
    "a hum": ("hum", 12, [Recorder("a", 10.0), Recorder("b", 12.0)]),
    "silence": ("silence", 12, [Recorder("a", 10.0), Recorder("b", 12.0)]),
}
_MAN = ("cam01", "cam02", "cam03", "cam04")
_SILENT_FPS = (10.0, 15.0, 30.0, 60.0)
# Seconds of film and starts of the cameras, seconds and frames after the first one's.
_SILENT: dict[str, tuple[float, tuple[float, float], tuple[float, float]]] = {
    "±10 s": (40.0, (10.0, -10.0), (0.0, 0.0)),
    "±1 frame": (8.0, (0.0, 0.0), (1.0, -1.0)),
    "±0.4 frame": (8.0, (0.0, 0.0), (0.4, -0.4)),
}
_DRAWS, _ROUGH_DRAWS = 3, 12
_ROUGH: dict[str, dict[str, float]] = {
    "4 cameras, 4 s": {},
    "4 cameras, 4 s, calibration exact": {"off_deg": 0.0, "off_m": 0.0},
    "3 cameras, 4 s": {"cameras": 3},
    "5 cameras, 4 s, 15 per second, moved by 1.5 times as much": {"cameras": 5, "fps": 15.0, "off_deg": 1.5},
    "4 cameras, 4 s, one person": {"people": 1},
    "4 cameras, 2 s": {"seconds": 2.0},
    "4 cameras, 20 s": {"seconds": 20.0},
    "4 cameras, 4 s, up to 0.4 s apart": {"spread_s": 0.4},
    "4 cameras, 4 s, started together": {"spread_s": 0.0},
}
_DRIFT_PPM = 50.0


def estimate(
    settings: clocks.Settings, cameras: list[str], films: list[Path], seen: list[Path], out: tuple[Path, Path]
) -> None:
    """Write clocks and findings ``out`` of ``films``, both steps one after the other."""
    lags = out[0].with_name("lags.json")
    take = clocks.Take(cameras, films)
    moments.run(settings, take, 0, lags, *UNSEARCHED)
    clocks.run(settings, take, seen, lags, *out)


def sound_case(kind: str, seconds: float, recorders: list[Recorder]) -> dict[str, Any]:
    """What the step makes of the recordings of one case, and how far it is off."""
    world = world_sound(kind, seconds + 25)
    with tempfile.TemporaryDirectory() as folder:
        paths = [record(Path(folder), r, world, seconds) for r in recorders]
        out = Path(folder) / "clocks.json", Path(folder) / "sync.json"
        begin = time.process_time()
        reported = clocks.Settings(sync="auto", picture_fps=_FPS)
        estimate(reported, [r.name for r in recorders], paths, [], out)
        spent = time.process_time() - begin
        found, reported = read_clocks(out[0]), read_json(out[1])["cameras"]
    kinds = {f["camera"]: f["kind"] for f in reported}
    lead = recorders[0].start_s - found.of(recorders[0].name).offset_s
    errors = [found.of(r.name).common_s + lead - r.world_s(found.of(r.name).own_s) for r in recorders]
    unknown = "undetermined" in kinds.values()
    return {
        "kinds": kinds,
        "error_frames": None if unknown else round(max(float(np.abs(e).max()) for e in errors) * _FPS, 3),
        "processor_s": round(spent, 2),
    }


def silent_films(
    fps: float, seconds: float, later_s: tuple[float, float], uneven: bool, drift_ppm: float
) -> list[Silent]:
    """Three films; the second one's frames may come unevenly, by a quarter of a frame, and its clock drift."""
    own_s = [np.arange(round(seconds * fps)) / fps for _ in range(3)]
    if uneven:
        own_s[1] = np.cumsum(np.random.default_rng(0).uniform(0.8, 1.25, len(own_s[1]))) / fps
        own_s[1] -= own_s[1][0]
    starts = 20.0, 20.0 + later_s[0], 20.0 + later_s[1]
    drifts = 0.0, drift_ppm, 0.0
    return [Silent(*about) for about in zip(ring()[:3], starts, own_s, drifts, strict=True)]


def by_people(films: list[Silent], fps: float, uneven: bool, draw: int) -> list[dict[str, Any]]:
    """What is made of every film but the reference, and how far it is off at worst."""
    rng = np.random.default_rng(draw)
    names = [film.camera.name for film in films]
    lines = [
        Timeline(fps, len(f.own_s), 0.0, tuple(f.own_s.tolist()) if uneven and k == 1 else ())
        for k, f in enumerate(films)
    ]
    seen = [sighted(film, (10 * draw, 10 * draw + 1), rng) for film in films]
    found, _, reference = clocks.estimate_clocks(names, lines, [], {}, seen, {})
    rows = []
    for k, verdict in enumerate(found):
        if k != reference:
            reported_s = verdict.offset_s + films[k].own_s * (1 + 1e-6 * verdict.drift_ppm)
            error = float(np.abs(reported_s - films[k].world_s + films[reference].start_s).max()) * fps
            rows.append({"kind": verdict.kind, "error": error, "half": verdict.half_s * fps})
    return rows


def silent_case(
    fps: float, seconds: float, later_s: tuple[float, float], uneven: bool = False, drift_ppm: float = 0.0
) -> dict[str, Any]:
    """All draws of one case."""
    films = silent_films(fps, seconds, later_s, uneven, drift_ppm)
    begin = time.process_time()
    rows = [row for draw in range(_DRAWS) for row in by_people(films, fps, uneven, draw)]
    reported = [row for row in rows if row["kind"] != "undetermined"]
    return {
        "fps": fps,
        "cameras_determined": len(reported),
        "cameras_undetermined": len(rows) - len(reported),
        "error_frames_median": round(float(np.median([r["error"] for r in reported])), 3) if reported else None,
        "error_frames_largest": round(max(r["error"] for r in reported), 3) if reported else None,
        "covered": sum(r["error"] <= r["half"] for r in reported),
        "half_frames_median": round(float(np.median([r["half"] for r in reported])), 3) if reported else None,
        "processor_s": round(time.process_time() - begin, 1),
    }


def silent_cases() -> dict[str, Any]:
    """Every planted start at every rate, and frames that come unevenly, a drift, and one silent camera among others."""
    cases: dict[str, Any] = {}
    for name, (seconds, later_s, later_frames) in _SILENT.items():
        cases[name] = [
            silent_case(fps, seconds, tuple(s + f / fps for s, f in zip(later_s, later_frames))) for fps in _SILENT_FPS
        ]
    cases["frames that come unevenly"] = [silent_case(fps, 8.0, (0.55, -0.3), uneven=True) for fps in _SILENT_FPS]
    cases[f"{_DRIFT_PPM:g} ppm over 120 s"] = [silent_case(_FPS, 120.0, (1.0, -1.0), drift_ppm=_DRIFT_PPM)]
    cases["one silent camera among cameras with sound"] = [one_silent(draw) for draw in range(_DRAWS)]
    return cases


def one_silent(draw: int) -> dict[str, Any]:
    """Two cameras with sound, a third one without; all of them see the two people."""
    starts_s = (20.0, 21.0 + 0.3 / _FPS, 19.5 - 0.4 / _FPS)
    films = silent_films(_FPS, 12.0, (starts_s[1] - 20.0, starts_s[2] - 20.0), False, 0.0)
    rng, world = np.random.default_rng(draw), world_sound("speech", 45.0, draw)
    names = [film.camera.name for film in films]
    recorders = [Recorder(n, s, deaf=k == 2) for k, (n, s) in enumerate(zip(names, starts_s, strict=True))]
    with tempfile.TemporaryDirectory() as folder:
        videos = [record(Path(folder), r, world, 12.0) for r in recorders]
        paths = [Path(folder) / f"{name}.npz" for name in names]
        for film, path in zip(films, paths, strict=True):
            write_detections(path, sighted(film, (10 * draw, 10 * draw + 1), rng))
        out = Path(folder) / "clocks.json", Path(folder) / "sync.json"
        estimate(clocks.Settings(sync="auto", picture_fps=_FPS), names, videos, paths, out)
        found, reported = read_clocks(out[0]), read_json(out[1])["cameras"]
    offset_s = [found.of(name).offset_s - found.of(names[0]).offset_s for name in names]
    errors = [abs(o - (s - starts_s[0])) * _FPS for o, s in zip(offset_s, starts_s, strict=True)]
    return {
        "methods": {f["camera"]: f["method"] or f["kind"] for f in reported},
        "error_frames_largest": round(max(errors), 3),
    }


def demo_case(take: Filmed, every: int, later: int, calibrated: bool) -> dict[str, Any]:
    """The demo's two seconds at every n-th picture; the second camera begins ``later`` pictures of 30 per second later;
    with its calibration or without."""
    seen = take.seen
    films = []
    for k, d in enumerate(seen):
        mine = d.only((d.frame >= later * (k == 1)) & ((d.frame - later * (k == 1)) % every == 0))
        films.append(
            Detections(d.camera, d.layout, (mine.frame - later * (k == 1)) // every, mine.track, mine.keypoints)
        )
    rate = _FPS / every
    reported = [Clock(d.camera, rate, (60 - later * (k == 1)) // every) for k, d in enumerate(seen)]
    lenses = {c.name: (take.lenses[c.name], c.wh) for c in take.cameras} if calibrated else None
    true_s = np.array([later * (k == 1) / _FPS for k in range(len(seen))])
    found = estimate_offsets(people_lags(films, reported, rate, lenses)[0], len(seen), 0)
    determined = [c for c in range(1, len(seen)) if found[c].half_s <= MAX_HALF_S]
    errors = [abs(found[c].seconds - true_s[c]) * rate for c in determined]
    return {
        "fps": rate,
        "calibrated": calibrated,
        "later_frames": round(later / every, 2),
        "cameras_determined": len(errors),
        "cameras_undetermined": len(seen) - 1 - len(errors),
        "error_frames_median": round(float(np.median(errors)), 3) if errors else None,
        "error_frames_largest": round(float(np.max(errors)), 3) if errors else None,
        "covered": sum(bool(e <= found[c].half_s * rate) for e, c in zip(errors, determined, strict=True)),
    }


def together(cases: Iterable[tuple[list[Offset], np.ndarray]]) -> dict[str, Any]:
    """What cameras together make of films, each with the true starts against the first."""
    rows = [(o.seconds - t, o.half_s) for found, true_s in cases for o, t in zip(found[1:], true_s[1:], strict=True)]
    off, half = 1000 * np.array(rows).T
    reported = half <= 1000 * MAX_HALF_S
    return {
        "cameras_told": int(reported.sum()),
        "cameras_not_told": int((~reported).sum()),
        "error_ms_rms": round(float(np.sqrt(np.mean(off[reported] ** 2))), 1) if reported.any() else None,
        "error_ms_largest": round(float(np.abs(off[reported]).max()), 1) if reported.any() else None,
        "covered": int((np.abs(off[reported]) <= half[reported]).sum()),
        "half_ms_median": round(float(np.median(half[reported])), 1) if reported.any() else None,
    }


def rough_case(**about: Any) -> dict[str, Any]:
    """All draws of rings of cameras that were moved since they were calibrated."""
    takes = [rough(seed, **about) for seed in range(_ROUGH_DRAWS)]
    begin = time.process_time()
    reported = together(
        (
            estimate_offsets(people_lags(t.seen, t.clocks, t.clocks[0].fps, t.lenses)[0], len(t.clocks), 0),
            t.start_s - t.start_s[0],
        )
        for t in takes
    )
    return reported | {"processor_s": round((time.process_time() - begin) / len(takes), 1)}


def the_man(data: Path, camera: str) -> Detections:
    """The surest person of every frame of one camera of the take, without unsure keypoints."""
    given = read_keypoints(data / "pose2sim_balancing/pose2d_body25b_single" / camera)
    order = np.lexsort((-given.keypoints[..., 2].sum(1), given.frame))
    surest = order[np.unique(given.frame[order], return_index=True)[1]]
    keypoints, track = given.keypoints[surest], np.zeros(len(surest), int)
    sure = np.where(keypoints[..., 2:] > 0.4, keypoints, [np.nan, np.nan, 0.0])
    return Detections(camera, "body_25b", given.frame[surest], track, sure)


def real_case(data: Path, every: int, cut: int) -> dict[str, Any]:
    """All pairs of the take's cameras at every n-th frame, with ``cut`` frames less at the beginning of the second
    one."""
    whole = {c: the_man(data, c) for c in _MAN}
    few = {c: d.only(d.frame % every == 0) for c, d in whole.items()}
    seen = {c: replace(d, frame=d.frame // every) for c, d in few.items()}
    rate = 60 / every
    errors, undetermined = [], 0
    for a, b in itertools.combinations(_MAN, 2):
        reported = [Clock(c, rate, int(seen[c].frame.max()) + 1) for c in (a, b)]
        shortened = seen[b].only(seen[b].frame >= cut)
        late = replace(shortened, frame=shortened.frame - cut)
        lags = [people_lags([seen[a], second], reported, rate)[0] for second in (seen[b], late)]
        if any(not found or found[0].outlier_probability > 0.05 for found in lags):
            undetermined += 1
        else:
            errors.append(abs((lags[1][0].offset_s - lags[0][0].offset_s) * rate - cut))
    return {
        "fps": 60 / every,
        "cut_frames": cut,
        "pairs_determined": len(errors),
        "pairs_undetermined": undetermined,
        "error_frames_median": round(float(np.median(errors)), 3) if errors else None,
        "error_frames_largest": round(float(np.max(errors)), 3) if errors else None,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    sound = {name: sound_case(*case) for name, case in _CASES.items()}
    real = [real_case(options.data, every, cut) for every, cut in ((1, 7), (2, 7), (4, 3), (6, 2))]
    folder = options.folder or Path(tempfile.mkdtemp())
    take, planted = the_demo(folder.resolve()), ((1, 7), (1, 1), (2, 1), (2, 7), (3, 1), (3, 7))
    films = [demo_case(take, *case, calibrated) for calibrated in (True, False) for case in planted]
    report = {
        "date": str(date.today()),
        "sound": sound,
        "silent": silent_cases(),
        "calibrated_together": {name: rough_case(**about) for name, about in _ROUGH.items()},
        "demo_films_people": films,
        "real_take_people": real,
    }
    print(json.dumps(report, indent=1, ensure_ascii=False))
    if options.results:
        write_json(options.results, report)


if __name__ == "__main__":
    main()
