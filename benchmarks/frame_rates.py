# SPDX-License-Identifier: Apache-2.0
"""The same take at 120, 60, 30, 15 and 10 frames per second: ``python -m benchmarks.frame_rates [--real DIR]``.

Three people cross in the middle of the synthetic studio's room (``benchmarks.association``), filmed at 120 frames per
second for three seconds; slower ones are every n-th of these pictures, with the same noise: 3 px, 10 % drop-outs, a
false person in 5 % of the pictures. Per rate: tracks per camera, people, identities (share of detections under the
right name), and joints of the fitted bodies against the truth at the pictures that all rates share. Prints a table and
writes benchmarks/results/frame_rates.json.

``--real DIR`` measures real pictures instead: every n-th picture of pose2sim_balancing, single and multi, at 60, 30, 15
and 10 per second, through the whole workflow up to the bodies, the detector first. Reports the cameras in which each
person is detected, and the distance of joints from those at 60 per second at the pictures that all rates share (after
the one rigid motion between the refined rigs). DIR keeps the runs, a minute and a half each on two free cores, so that
``--takes`` and ``--rates`` select parts, 60 per second first.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.footage.video import write_lossless
from studiorecon.keypoints.tracking import drop_duplicates, track_ids
from studiorecon.people import associate, fit
from studiorecon.people.association.acceptance import identities_from_keypoints
from studiorecon.people.fitting.points import person_keypoints, triangulate_keypoints
from studiorecon.report.metrics.identity_scores import identity_scores
from studiorecon.scene.files import read_json, read_table, write_json
from studiorecon.scene.people import PEOPLE_COLUMNS, Detections
from studiorecon.studio.description import RESOURCES
from studiorecon.studio.detections import detect
from studiorecon.tracks import keypoints as detections

from benchmarks.association import LAYOUT, NOISE, PEOPLE, Take, crossing, nearest
from benchmarks.detector import DATA, ROOT, rigid_mm, workflow
from tests.defaults import loaded

RESULT = Path(__file__).resolve().parent / "results" / "frame_rates.json"
FPS, SECONDS = 120, 3.0
EVERY = (1, 2, 4, 8, 12)
REAL_FPS, RATES = 60, (60, 30, 15, 10)


def seen_at_full_rate(take: Take, frames: int, reading: detections.Settings) -> list[tuple[np.ndarray, np.ndarray]]:
    """Per camera frames (D,) and keypoints (D, K, 3) of all detections."""
    out = []
    for v, lens in enumerate(take.lenses):
        rng, frame, keypoints = np.random.default_rng([0, v]), [], []
        for t in range(frames):
            for person in detect(take.keypoints_m[t], lens, take.tracers[t], take.first_actor, NOISE, rng):
                frame.append(t)
                keypoints.append(np.where(person[:, 2:] >= reading.min_confidence, person, [np.nan, np.nan, 0.0]))
        keep = (np.array(keypoints)[..., 2] > 0).sum(1) >= reading.min_keypoints
        out.append((np.array(frame)[keep], np.array(keypoints)[keep]))
    return out


def measured(
    take: Take, seen: list[tuple[np.ndarray, np.ndarray]], every: int, frames: int, reading: detections.Settings
) -> dict[str, Any]:
    """Scores of the take of which every ``every``-th picture was kept."""
    fps, count = FPS / every, len(range(0, frames, every))
    found, owners = [], []
    for camera, (frame, keypoints) in zip(take.cameras, seen):
        kept = frame % every == 0
        t, points = frame[kept] // every, keypoints[kept]
        kept = drop_duplicates(t, points, reading.tracking)
        t, points = t[kept], points[kept]
        owners.append(nearest(take, camera, t * every, points))
        found.append(Detections(camera.name, LAYOUT, t, track_ids(t, points, reading.tracking, fps), points))
    options, fitting = loaded(associate.Settings), loaded(fit.Settings)
    started = time.process_time()
    with redirect_stdout(io.StringIO()):
        limits = options.association, options.triangulation
        table, rows, left_out = identities_from_keypoints(*limits, take.cameras, found, [], count, fps)
    seconds = time.process_time() - started
    names = {name: k for k, (name, *_) in enumerate(rows)}
    given = [np.array([names.get(table[d.camera, int(t)].person, -1) for t in d.track]) for d in found]
    view = np.repeat(np.arange(len(found)), [len(d.frame) for d in found])
    scores = identity_scores(
        np.concatenate([d.frame for d in found]), view, np.concatenate(owners), np.concatenate(given)
    )
    body = BodyModel.load(RESOURCES / "body.npz")
    identities = {key: verdict.person for key, verdict in table.items()}
    shared = np.arange(0, frames, 24) // every  # pictures that every rate has
    errors, speeds = [], []
    for name in names:
        keypoint_names, keypoints = person_keypoints(name, found, identities, body, count)
        points = triangulate_keypoints(
            keypoint_names, keypoints, take.cameras, fitting.triangulation, fitting.fit.unverified_sigma_m
        )
        person = fit.fit_person(name, points, body, fps, fitting)[0]
        apart = [
            np.linalg.norm(person.joints[shared] - true, axis=-1)
            for true in true_joints(take, np.arange(0, frames, 24), body)
        ]
        best = min(range(PEOPLE), key=lambda p: float(np.median(apart[p])))
        errors.append(apart[best].mean())
        truth = true_joints(take, np.arange(0, frames, every), body)[best]
        off = person.joints - truth
        speeds.append(np.linalg.norm(np.diff(off, axis=0), axis=-1).mean() * fps)
    return {
        "fps": fps,
        "tracks": [len(np.unique(d.track)) for d in found],
        "people": len(rows),
        "left_out": len(left_out),
        "accuracy": scores.accuracy,
        "precision": scores.precision,
        "joints_mm": 1000 * float(np.mean(errors)),
        "error_speed_mm_s": 1000 * float(np.mean(speeds)),
        "association_s": seconds,
    }


def true_joints(take: Take, frames: np.ndarray, body: BodyModel) -> list[np.ndarray]:
    """Per person (T, 24, 3) joints of the actors' own shapes, whose pelvises are the truth's."""
    out = []
    for p in range(PEOPLE):
        joints = body.joints(take.poses[frames, p], take.betas[p], take.pelvis_m[frames, p])
        out.append(joints)
    return out


def thinned(take: str, every: int, folder: Path) -> Path:
    """A dataset folder with every ``every``-th picture of a real take's videos."""
    made = folder / f"{take}_{every}/videos"
    made.mkdir(parents=True, exist_ok=True)
    for video in sorted((DATA / f"pose2sim_balancing/{take}/videos").glob("*.mp4")):
        if not (made / f"{video.stem}.mkv").exists():
            source = open_source(video, 30.0)
            kept = (picture for t, picture in enumerate(decode(source, 0, 0)) if t % every == 0)
            write_lossless(made / f"{video.stem}.mkv", kept, source.fps / every)
    return made.parent


def real(take: str, folder: Path, rates: Sequence[int]) -> list[dict[str, Any]]:
    """One row per rate of a real take; what its first rate is compared with must lie in ``folder``."""
    reported = yaml.safe_load((ROOT / f"tests/captures/pose2sim_{take}.yaml").read_text(encoding="utf-8"))
    kept = {key: value for key, value in reported.items() if not key.startswith(("keypoint", "plates"))}
    kept["calibration"] = str(DATA / "pose2sim_balancing/calibration/Calib_scene.toml")
    (folder / f"{take}.yaml").write_text(yaml.safe_dump(kept), encoding="utf-8")
    rows: list[dict[str, Any]] = []
    first = {p.stem: read_person(p) for p in sorted(folder.glob(f"results/{take}_at_{REAL_FPS}/people/p?.npz"))}
    for every in [REAL_FPS // fps for fps in rates]:
        scene = f"{take}_at_{REAL_FPS // every}"
        given = {"dataset": str(thinned(take, every, folder)), "capture_yaml": str(folder / f"{take}.yaml")}
        given |= {"scene": scene, "clocks": '{"sync": "never"}'}
        people = folder / f"results/{scene}/people"
        workflow(folder, [f"results/{scene}/people/people.tsv"], **given)
        found = {r["person"]: r for r in read_table(people / "people.tsv", PEOPLE_COLUMNS) if r["status"] == "person"}
        workflow(folder, [f"results/{scene}/people/{name}.npz" for name in found], **given)
        bodies = {name: read_person(people / f"{name}.npz") for name in found}
        first = bodies if every == 1 else first
        off = {}
        for name, body in bodies.items():
            gaps = []
            for other in first.values():
                shared = np.arange(0, len(other.joints), 12)
                both = shared[other.valid[shared] & body.valid[shared // every]]
                gaps.append(rigid_mm(body.joints[both // every], other.joints[both]))
            off[name] = round(min(gaps), 1)
        rows.append({"fps": REAL_FPS / every, "cameras": {n: r["cameras"] for n, r in found.items()}, "joints_mm": off})
        print(f"{take} at {REAL_FPS / every:g} per second: {rows[-1]['cameras']}, joints off by {off} mm", flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", type=Path, metavar="DIR")
    parser.add_argument("--takes", nargs="+", choices=["single", "multi"], default=["single", "multi"])
    parser.add_argument("--rates", nargs="+", type=int, choices=RATES, default=list(RATES))
    options = parser.parse_args()
    folder = options.real
    stored = read_json(RESULT) if RESULT.exists() else {}
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        for take in options.takes:
            for rate in sorted(options.rates, reverse=True):
                known = {row["fps"]: row for row in stored.setdefault("real", {}).get(take, [])}
                known |= {row["fps"]: row for row in real(take, folder.resolve(), [rate])}
                stored["real"][take] = [known[fps] for fps in sorted(known, reverse=True)]
                write_json(RESULT, stored)
        return
    frames = round(FPS * SECONDS)
    take, reading = crossing(frames, FPS), loaded(detections.Settings)
    seen = seen_at_full_rate(take, frames, reading)
    rows = []
    for every in EVERY:
        rows.append(row := measured(take, seen, every, frames, reading))
        print(
            f"{row['fps']:5.0f} fps  tracks {row['tracks']}  people {row['people']}  "
            f"left out {row['left_out']}  accuracy "
            f"{row['accuracy']:.1%}  precision {row['precision']:.1%}  joints "
            f"{row['joints_mm']:.1f} mm  their error moves at "
            f"{row['error_speed_mm_s']:.0f} mm/s  association {row['association_s']:.1f} s"
        )
    write_json(RESULT, stored | {"people": PEOPLE, "seconds": SECONDS, "rates": rows})


if __name__ == "__main__":
    main()
