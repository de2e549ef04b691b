# SPDX-License-Identifier: Apache-2.0
"""What the doctor's thinking costs on a take whose tracks break off all the time. Run by hand; bar: ≤ 25 s of one core.

    OMP_NUM_THREADS=1 python -m tests.bench.doctor

Four cameras, 268 frames, three people; their tracks whole, and cut into pieces of 8 and 3 frames on average, as a
detector at ten frames per second cuts them. Prints processor seconds of this process and writes
tests/bench/results/doctor.json. The first row pays for loading or compiling the kernels.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.calibration import doctor
from studiorecon.scene.people import Detections

from tests.defaults import loaded
from tests.made.take import made_take

RESULT = Path(__file__).parent / "results" / "doctor.json"
FRAMES, PEOPLE = 268, 3


def broken(seen: Detections, mean_frames: int, rng: np.random.Generator) -> Detections:
    """The same detections in tracks of ``mean_frames`` on average."""
    track, count = np.zeros(len(seen.frame), dtype=int), 0
    for whole in np.unique(seen.track):
        rows = np.flatnonzero(seen.track == whole)
        ends = rng.random(len(rows)) < 1 / mean_frames
        pieces = np.cumsum(np.append(False, ends[:-1]))
        track[rows], count = count + pieces, count + int(pieces[-1]) + 1
    return replace(seen, track=track)


def examined_s(cameras: Sequence, seen: Sequence[Detections]) -> tuple[float, dict]:
    """Processor seconds of ``doctor.examined``, and what it says."""
    facts = {
        "frames": FRAMES,
        "first_frame": 0,
        "count": 0,
        "keypoints": True,
        "video_frames": FRAMES,
        "fps": 10.0,
        "rotation_deg": 0,
    }
    about = [{**facts, "brightness": 0.4, "burnt": 0.0, "camera": c.name, "wh": list(c.wh)} for c in cameras]
    begun = time.process_time()
    report, _ = doctor.examined(cameras, seen, about, loaded(doctor.Settings))
    return time.process_time() - begun, report


def main() -> None:
    cameras, whole = made_take(frames=FRAMES, people=PEOPLE, occluded=False)
    result: dict[str, Any] = {"date": date.today().isoformat(), "machine": platform.machine(), "rows": []}
    for mean_frames in (0, 8, 3):
        rng = np.random.default_rng(0)
        seen = [broken(d, mean_frames, rng) for d in whole] if mean_frames else whole
        seconds, report = examined_s(cameras, seen)
        tracks = sum(len(np.unique(d.track)) for d in seen)
        clocks = sum(lag["valid"] for lag in report["lags_frames"].values())
        result["rows"].append(
            {"tracks": tracks, "cpu_s": seconds, "verdict": report["verdict"], "clocks_determined": clocks}
        )
        print(
            f"{tracks:5d} tracks  {seconds:6.1f} s  {report['verdict']}, {clocks} of {len(cameras)} clocks determined",
            flush=True,
        )
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
