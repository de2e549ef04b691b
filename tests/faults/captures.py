# SPDX-License-Identifier: Apache-2.0
"""What a whole capture works out to, from its files to the doctor's page, when its files are damaged or mixed up.

``python -m tests.faults.captures [EVERY [SEED]]``: every so-many-th rule (1) at one place of every kind of file, and
every mix-up between files or within their time. Where the steps go on, what they work out is compared with the
undamaged capture: who is where, how many frames count, lenses, lengths and pictures. It is right when nothing changed,
told when something is said that was not said before, and silent otherwise.
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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from studiorecon.calibration import choose, doctor, files
from studiorecon.camera_files.calibration import read_calibration
from studiorecon.clocks import moments, offsets
from studiorecon.detect import keypoints as recorded
from studiorecon.errors import UserError
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.plan.discovery import open_dataset
from studiorecon.rig.agreement import error_medians
from studiorecon.rig.correspondences import make_observations
from studiorecon.scene.clocks import read_clocks
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.files import read_json
from studiorecon.scene.people import read_detections
from studiorecon.studio import capture

from tests.defaults import UNSEARCHED, loaded
from tests.faults.rules import Variant, variants
from tests.made.file_contents import FORMS, npz

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
# Half of the studio's frames; levels of 255 by which a decoder's pictures may differ.
HALF, _LEVELS = 15, 8.0

FREE = (
    r"capture\.yaml: missing at frames.*",  # other frames are chosen, and the log's line of moments says which
)
"""Where another capture is as whole as this one, or cannot be told from it, and why."""


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
    take = offsets.Take(cameras, films, json.dumps(dict(data.starts)), data.first_frame, data.frame_count)
    moments.run(loaded(offsets.Settings), take, 0, work / "lags.json", *UNSEARCHED)
    offsets.run(loaded(offsets.Settings), take, sightings, work / "lags.json", clocks, sync, [calibration])
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
        "pictures": np.array([_small(data.footage[c])[common.source_frames(c)] for c in cameras]),
    }
    detector = [f"the detector looks for people in {c}" for c in cameras if c not in told_by]
    return numbers, [*detector, told["verdict"], *told["advice"], *told["oddities"], *filter(None, [told["lengths"]])]


def _small(video: Path) -> np.ndarray:
    frames = FORMS[".mp4"].taken(video.read_bytes())["frames"]
    return np.array([cv2.resize(picture, (8, 4), interpolation=cv2.INTER_AREA) for picture in frames], np.float64)


def alike(one: Outcome, other: Outcome) -> bool:
    """Whether two captures work out the same, to what a detector errs."""
    first, second = one.numbers, other.numbers
    if any(first[name].shape != second[name].shape for name in ("moments", "looks", "poses", "pictures")):
        return False
    if abs(len(first["joints"]) - len(second["joints"])) > 0.05 * len(first["joints"]):
        return False
    shares = np.linspace(0, 1, 21)
    moved = np.quantile(first["joints"], shares, axis=0) - np.quantile(second["joints"], shares, axis=0)
    most = {"moments": 1e-6, "pictures": _LEVELS, "looks": _MOVED_PX, "poses": _MOVED_M}
    apart = {name: np.abs(first[name] - second[name]).max() for name in most}
    return bool(np.abs(moved).max() < _MOVED_M) and all(apart[name] < most[name] for name in most)


def files_of(dataset: Path) -> list[Path]:
    """One of every kind of file of the capture, and all of a camera's keypoints as one."""
    names = ("keypoints/cam2.npz", "videos/cam2.mp4", "extri.yml", "intri.yml", "capture.yaml")
    return [dataset / name for name in names]


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


def exchange(one: Path, other: Path) -> None:
    other.rename(one.rename(one.with_name("between")).parent / "waiting")
    one.with_name("between").rename(other)
    other.with_name("waiting").rename(one)


def film(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """Changes the frames (30, H, W, 3) of one camera."""

    def changed(dataset: Path) -> None:
        path, form = dataset / "videos/cam2.mp4", FORMS[".mp4"]
        tree = form.taken(path.read_bytes())
        path.write_bytes(form.put({**tree, "frames": np.ascontiguousarray(change(tree["frames"]))}))

    return changed


def people(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """Changes the keypoints (30, people, 25, 3) of one camera."""

    def changed(dataset: Path) -> None:
        path = dataset / "keypoints/cam2.npz"
        path.write_bytes(npz(keypoints=change(FORMS[".npz"].taken(path.read_bytes())["keypoints"])))

    return changed


def after_half(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: np.concatenate([values[:HALF], change(values[HALF:])])


def _poses_exchanged(dataset: Path) -> None:
    text = (dataset / "extri.yml").read_text()
    (dataset / "extri.yml").write_text(text.replace("cam1", "X").replace("cam3", "cam1").replace("X", "cam3"))


def _half_of_another_film(dataset: Path) -> None:
    other = FORMS[".mp4"].taken((dataset / "videos/cam3.mp4").read_bytes())["frames"]
    film(lambda frames: np.concatenate([frames[:HALF], other[HALF:]]))(dataset)


def _camera_moved(dataset: Path) -> None:
    film(after_half(lambda frames: np.roll(frames, 12, 2)))(dataset)
    people(after_half(lambda points: points + np.array([12.0, 0, 0])))(dataset)


MIX_UPS: dict[str, Callable[[Path], None]] = {
    "films exchanged": lambda d: exchange(d / "videos/cam1.mp4", d / "videos/cam3.mp4"),
    "keypoints exchanged": lambda d: exchange(d / "keypoints/cam1", d / "keypoints/cam3"),
    "poses exchanged": _poses_exchanged,
    "half of another film": _half_of_another_film,
    "camera moved": _camera_moved,
    "film stands still": film(after_half(lambda frames: frames[:1].repeat(len(frames), 0))),
    "film lacks frames": film(lambda frames: np.concatenate([frames[:12], frames[15:], frames[-3:]])),
    "film backwards": film(lambda frames: frames[::-1]),
    "film half mirrored": film(after_half(lambda frames: frames[:, :, ::-1])),
    "film half upside down": film(after_half(lambda frames: frames[:, ::-1, ::-1])),
    "film letterboxed": film(lambda frames: np.pad(frames, ((0, 0), (20, 20), (0, 0), (0, 0)))),
    "film half black": film(after_half(lambda frames: frames * 0)),
    "keypoints stand still": people(after_half(lambda points: points[:1].repeat(len(points), 0))),
    "keypoints late": people(after_half(lambda points: points[[0, 0, 0, *range(len(points) - 3)]])),
    "keypoints backwards": people(lambda points: points[::-1]),
    "keypoints half scaled": people(after_half(lambda points: points * [1.15, 1.15, 1])),
    "keypoints drift": people(lambda points: points + np.arange(30)[:, None, None, None] * [1.0, 0, 0]),
    "keypoints half mirrored": people(after_half(lambda points: np.array([319, 0, 0]) + points * [-1, 1, 1])),
}


def outcomes(every: int = 1, seed: int = 0) -> Iterator[tuple[str, str, str, str]]:
    """(file and rule, place, verdict, what was said) of every ``every``-th rule at one place, and of every mix-up."""
    with tempfile.TemporaryDirectory() as name:
        dataset = made(Path(name))
        whole = shutil.copytree(dataset, Path(name) / "whole")
        with tempfile.TemporaryDirectory() as work:
            right = worked_out(dataset, Path(work))
        rng, number = np.random.default_rng(seed), seed
        for mixed_up, change in MIX_UPS.items():
            change(dataset)
            yield mixed_up, "", *verdict(dataset, right)
            shutil.rmtree(dataset)
            shutil.copytree(whole, dataset)
        for path in files_of(dataset):
            content, by_rule = path.read_bytes(), dict[str, list[Variant]]()
            for variant in variants(path.suffix, content):
                if not re.search(r"cam[134]\b", variant.place):
                    by_rule.setdefault(variant.rule, []).append(variant)
            for rule, several in by_rule.items():
                number += 1
                if number % every == 0:
                    damage = several[rng.integers(len(several))]
                    damage.lay(path)
                    yield f"{path.name}: {rule}", damage.place, *verdict(dataset, right)
            Variant("", "", content).lay(path)


def wrong(rule: str, place: str, ended: str, words: str) -> bool:
    """Whether it is a fault of the project."""
    return ended in ("traceback", "unclear") or (
        ended == "silent" and not any(re.fullmatch(pattern, f"{rule} at {place}") for pattern in FREE)
    )


if __name__ == "__main__":
    counted: Counter[str] = Counter()
    for rule, place, ended, words in outcomes(*map(int, sys.argv[1:])):
        counted[ended] += 1
        print(f"{ended}: {rule} at {place}: {words[:300]}", flush=True)
    print(dict(counted))
