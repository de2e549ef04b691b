# SPDX-License-Identifier: Apache-2.0
"""What a whole capture works out to, from its files to the doctor's page, with every file of it damaged by every rule.

``python -m tests.faults.captures [EVERY]``: every so-many-th damage (1). Where the steps go on, what they work out is
compared with the undamaged capture: who is where, how many frames count, lenses and lengths. It is right when nothing
changed, told when something is said that was not said before, and silent otherwise.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from studiorecon.calibration import choose, doctor, files
from studiorecon.camera_files.calibration import read_calibration
from studiorecon.clocks import offsets
from studiorecon.detect import keypoints as recorded
from studiorecon.errors import UserError
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.plan.discovery import open_dataset
from studiorecon.rig.bundle import error_medians
from studiorecon.rig.correspondences import make_observations
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.files import read_json
from studiorecon.scene.people import read_detections
from studiorecon.studio import capture

from tests.defaults import loaded
from tests.faults.rules import bytes_changed, variants

STUDIO = """seed: 3
frames: 30
fps: 15.0
size: [320, 180]
people: 2
cameras: {held_out: 0}
detections: {noise_px: 0.5, shuffled: true}
"""
DESCRIBED = "frames: {first: 2, count: 24}\nkeypoint_layout: body_25\ntrain: [cam1, cam2, cam3, cam4]\n"
# Two runs of one capture agree to the last digit; a detector errs by more than this, metres and pixels.
_MOVED_M, _MOVED_PX = 0.03, 2.0


FREE = (
    # Other frames are chosen, and the log's line of moments says which.
    r"capture\.yaml: missing at frames.*",
)
"""Where another capture is as whole as this one, and why."""


@dataclass(frozen=True)
class Outcome:
    """What a capture worked out to: numbers by name, and every sentence that was said."""

    numbers: dict[str, np.ndarray]
    said: frozenset[str]


def made(folder: Path) -> Path:
    """A small capture as a user brings it, in a new ``folder``."""
    (folder / "studio.yaml").write_text(STUDIO)
    capture.run(folder / "studio.yaml", folder / "dataset", folder / "truth", processes=1)
    dataset = folder / "dataset"
    (dataset / "capture.yaml").write_text(DESCRIBED)
    given = read_keypoints(dataset / "keypoints/cam2")
    people = np.zeros((len(given.pictures), 2, *given.keypoints.shape[1:]))
    for row, (frame, person) in enumerate(zip(given.frame, given.keypoints)):
        people[frame, int(row > 0 and given.frame[row - 1] == frame)] = person
    shutil.rmtree(dataset / "keypoints/cam2")
    np.savez(dataset / "keypoints/cam2.npz", keypoints=people)
    return dataset


def worked_out(dataset: Path, work: Path) -> Outcome:
    """The steps up to the doctor's page, in this process, for what lies in ``dataset``; raises UserError."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), np.errstate(all="ignore"):
        found = open_dataset(dataset)
        numbers, sentences = _steps(found, work)
    lines = [*said.getvalue().replace(str(work), "").splitlines(), *sentences, *found.notes]
    return Outcome(numbers, frozenset(re.sub(r"[-\d.]+", "", line) for line in lines))


def _steps(data: Dataset, work: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    cameras, films = list(data.footage), list(data.footage.values())
    maps = {c: json.dumps(data.pixel_maps.get(c, [])) for c in cameras}
    files.run(loaded(files.Settings), list(data.calibration), cameras, work / "read.json")
    sightings, sizes = [work / f"{c}.npz" for c in cameras], [work / f"{c}.json" for c in cameras]
    told_by = {c: (seen, size) for c, seen, size in zip(cameras, sightings, sizes) if c in data.keypoints}
    for camera, (seen, size) in told_by.items():
        others = {c: path for c, path in data.keypoints.items() if c != camera}
        first = str(data.keypoint_first_frame.get(camera, "auto"))
        given = camera, [data.keypoints[camera]], data.keypoint_layout, first, data.footage[camera], 30.0, maps[camera]
        last = list(others.values()), list(others)
        recorded.run(loaded(recorded.Settings), *given, seen, work / "own.npz", size, *last)
    sightings, sizes = [seen for seen, _ in told_by.values()], [size for _, size in told_by.values()]
    pixel_maps = json.dumps(dict(data.pixel_maps))
    calibration, clocks, sync = work / "calibration.json", work / "clocks.json", work / "sync.json"
    choose.run(
        loaded(choose.Settings), work / "read.json", cameras, films, sightings, pixel_maps, 30.0, list(told_by),
        calibration,
    )  # fmt: skip
    offsets.run(
        loaded(offsets.Settings), cameras, films, sightings, json.dumps(dict(data.starts)), data.first_frame,
        data.frame_count, clocks, sync, [calibration],
    )  # fmt: skip
    common = read_clocks(clocks)
    if common.refusal:
        raise UserError(common.refusal)
    report, page = work / "doctor.json", work / "doctor.html"
    settings = loaded(doctor.Settings)
    doctor.run(settings, "s", calibration, cameras, films, sightings, sizes, clocks, sync, report, page)
    told = read_json(report)
    lenses = read_calibration(calibration).lenses
    both = [
        doctor.to_pinhole(doctor.resample_keypoints(d, common, lenses[c].wh[1]), lenses[c], told["footage"][c]["wh"])
        for c, d in ((d.camera, d) for d in map(read_detections, sightings))
    ]
    pinholes, seen_then = [c for c, _ in both], [d for _, d in both]
    seen, _ = make_observations(seen_then, pinholes, np.arange(common.frames), settings.gate_m)
    points = error_medians(pinholes, seen, settings.limits)[2] if len(seen.frame) else np.zeros((0, 3))
    numbers = {
        "moments": np.array([common.source_frames(c) for c in cameras]),
        "joints": np.sort(points, axis=0),
        "looks": np.concatenate([c.intrinsics[:2].ravel() for c in pinholes]),
        "poses": np.concatenate([c.camera_from_world.ravel() for c in pinholes]),
    }
    detector = [f"the detector looks for people in {c}" for c in cameras if c not in told_by]
    return numbers, [*detector, told["verdict"], *told["advice"], *told["oddities"], *filter(None, [told["lengths"]])]


def alike(one: Outcome, other: Outcome) -> bool:
    """Whether two captures work out the same, to what a detector errs."""
    first, second = one.numbers, other.numbers
    if any(first[name].shape != second[name].shape for name in ("moments", "looks", "poses")):
        return False
    if abs(len(first["joints"]) - len(second["joints"])) > 0.05 * len(first["joints"]):
        return False
    shares = np.linspace(0, 1, 21)
    moved = np.quantile(first["joints"], shares, axis=0) - np.quantile(second["joints"], shares, axis=0)
    return (
        np.array_equal(first["moments"], second["moments"])
        and bool(np.abs(moved).max() < _MOVED_M)
        and bool(np.abs(first["looks"] - second["looks"]).max() < _MOVED_PX)
        and bool(np.abs(first["poses"] - second["poses"]).max() < _MOVED_M)
    )


def files_of(dataset: Path) -> list[Path]:
    """One of every kind of file of the capture, and all of a camera's keypoints as one."""
    return [
        dataset / "keypoints/cam2.npz",
        dataset / "videos/cam2.mp4",
        dataset / "extri.yml",
        dataset / "intri.yml",
        dataset / "capture.yaml",
    ]


def verdict(dataset: Path, right: Outcome) -> tuple[str, str]:
    """What became of the capture as it lies there, and a word on it."""
    with tempfile.TemporaryDirectory() as work:
        try:
            now = worked_out(dataset, Path(work))
        except UserError as refusal:
            return ("refused" if "\n" not in str(refusal) else "unclear"), str(refusal)
        except Exception as error:  # whatever it is, it is what is counted
            return "traceback", repr(error)
    if alike(now, right):
        return "right", ""
    news = sorted(now.said - right.said)
    return ("told" if news else "silent"), " | ".join(news)


def outcomes(every: int = 1, changed: int = 0, seed: int = 0) -> Iterator[tuple[str, str, str, str]]:
    """(file and rule, place, verdict, what was said) of every ``every``-th damage of a capture."""
    with tempfile.TemporaryDirectory() as name:
        dataset = made(Path(name))
        with tempfile.TemporaryDirectory() as work:
            right = worked_out(dataset, Path(work))
        rng = np.random.default_rng(seed)
        for path in files_of(dataset):
            whole = path.read_bytes()
            damages = [
                (v.rule, v.place, v.data) for v in variants(path.suffix, whole) if not re.search(r"cam[134]\b", v.place)
            ]
            damages += [("bytes", str(k), bytes_changed(whole, rng)) for k in range(changed)]
            for rule, place, data in damages[seed % every :: every]:
                path.unlink(missing_ok=True)
                if data is not None:
                    path.write_bytes(data)
                yield f"{path.name}: {rule}", place, *verdict(dataset, right)
            path.write_bytes(whole)


def wrong(rule: str, place: str, ended: str, words: str) -> bool:
    """Whether it is a fault of the project."""
    return ended in ("traceback", "unclear") or (
        ended == "silent" and not any(re.fullmatch(pattern, f"{rule} at {place}") for pattern in FREE)
    )


if __name__ == "__main__":
    counted: Counter[str] = Counter()
    for rule, place, ended, words in outcomes(int(sys.argv[1]) if len(sys.argv) > 1 else 1):
        counted[ended] += 1
        print(f"{ended}: {rule} at {place}: {words[:300]}", flush=True)
    print(dict(counted))
