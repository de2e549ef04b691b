# SPDX-License-Identifier: Apache-2.0
"""How well clocks are found: planted starts, drift, rates and reverberation in sound; cut frames in a real take's
keypoints.

``python -m tests.bench.clocks --data DIR --results tests/bench/results/clocks.json``; DIR holds ``pose2sim_balancing``.
Errors are in frames at the stated rate, largest over all cameras and moments; none: undetermined. The real take's own
clocks are only known to a frame or so: lags with frames cut off are compared with the lag as filmed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
import time
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.clocks import offsets as clocks
from studiorecon.clocks.people_lag import lag_of
from studiorecon.keypoints.correspondence import stable_indices
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.files import read_json, write_json

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


def sound_case(kind: str, seconds: float, recorders: list[Recorder]) -> dict[str, Any]:
    """What the step makes of the recordings of one case, and how far it is off."""
    world = world_sound(kind, seconds + 25)
    with tempfile.TemporaryDirectory() as folder:
        paths = [record(Path(folder), r, world, seconds) for r in recorders]
        out = Path(folder) / "clocks.json", Path(folder) / "sync.json"
        begin = time.process_time()
        told = clocks.Settings(sync="auto", picture_fps=_FPS)
        clocks.run(told, [r.name for r in recorders], paths, [], "{}", 0, 0, *out)
        spent = time.process_time() - begin
        found, told = read_clocks(out[0]), read_json(out[1])["cameras"]
    kinds = {f["camera"]: f["kind"] for f in told}
    lead = recorders[0].start_s - found.of(recorders[0].name).offset_s
    errors = [found.of(r.name).common_s + lead - r.world_s(found.of(r.name).own_s) for r in recorders]
    unknown = "undetermined" in kinds.values()
    return {
        "kinds": kinds,
        "error_frames": None if unknown else round(max(float(np.abs(e).max()) for e in errors) * _FPS, 3),
        "processor_s": round(spent, 2),
    }


def the_man(data: Path, camera: str) -> np.ndarray:
    """(T, 12, 3) the surest person of every frame of one camera of the take, homogeneous pixels, NaN where unsure."""
    entries, _ = read_keypoints(data / "pose2sim_balancing/pose2d_body25b_single" / camera)
    track = np.full((max(e.frame for e in entries) + 1, 12, 3), np.nan)
    surest: dict[int, np.ndarray] = {}
    for entry in entries:
        points = entry.keypoints[stable_indices("body_25b")]
        if entry.frame not in surest or points[:, 2].sum() > surest[entry.frame][:, 2].sum():
            surest[entry.frame] = points
    for frame, points in surest.items():
        track[frame] = np.where(points[:, 2:] > 0.4, np.column_stack([points[:, :2], np.ones(12)]), np.nan)
    return track


def real_case(data: Path, every: int, cut: int) -> dict[str, Any]:
    """All pairs of the take's cameras at every n-th frame, with ``cut`` frames less at the beginning of the second
    one."""
    tracks = {c: the_man(data, c)[::every] for c in _MAN}
    errors, undetermined = [], 0
    for a, b in itertools.combinations(_MAN, 2):
        as_filmed, late = (lag_of(tracks[a], tracks[b][n:], 60 / every) for n in (0, cut))
        if as_filmed is None or late is None:
            undetermined += 1
        else:
            errors.append(abs(late.rows - as_filmed.rows + cut))
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
    parser.add_argument("--results", type=Path)
    options = parser.parse_args()
    sound = {name: sound_case(*case) for name, case in _CASES.items()}
    real = [real_case(options.data, every, cut) for every, cut in ((1, 7), (2, 7), (4, 3), (6, 2))]
    report = {"date": str(date.today()), "sound": sound, "real_take_people": real}
    print(json.dumps(report, indent=1, ensure_ascii=False))
    if options.results:
        write_json(options.results, report)


if __name__ == "__main__":
    main()
