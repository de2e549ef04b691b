# SPDX-License-Identifier: Apache-2.0
"""Accuracy of association on a made take, ours, the paper's and single terms: ``python -m benchmarks.association``.

Three people cross in the middle of the synthetic studio's room, four cameras 90° apart, 1280×704, with everybody's
occlusions by ray casting. Keypoints: 3 px noise, 5 % outliers of 40 to 200 px, 10 % drop-outs, a false person in 5 % of
the pictures; track ids are this project's own. Monocular bodies, which only a learned detector brings, are planted:
true pose with 0.15 rad per joint of lasting error and as much per frame, true pelvis depth with 0.1 m of each (
A11). Prints a table and writes benchmarks/results/association.json.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import platform
import time
from contextlib import redirect_stdout
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.geometry.rotations import exp, log
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.tracking import drop_duplicates, track_ids
from studiorecon.people import associate
from studiorecon.people.association.acceptance import identities_from_keypoints
from studiorecon.people.association.gaps import group_tracks
from studiorecon.people.association.grouping import TrackComparison
from studiorecon.report.metrics.identity_scores import identity_scores
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections
from studiorecon.studio import rig
from studiorecon.studio.actors import Actors
from studiorecon.studio.description import RESOURCES, DetectionOptions, read_description
from studiorecon.studio.detections import detect
from studiorecon.studio.gait import Path as Walked
from studiorecon.studio.performance import NEVER, MotionPart, perform
from studiorecon.studio.room import build_room
from studiorecon.studio.tracing import Tracer
from studiorecon.tracks import keypoints as detections

from tests.defaults import loaded

ROOT = Path(__file__).resolve().parents[1]
RESULT = Path(__file__).resolve().parent / "results" / "association.json"
LAYOUT, FRAMES, PEOPLE = "body_25", 90, 3
NOISE = DetectionOptions(recorded=True, noise_px=3.0, drop_outs=0.1, false_positives=0.05, shuffled=True)
OUTLIERS = 0.05
POSE_RAD, DEPTH_M = 0.15, 0.1
# name → (association settings that differ from the configuration, do the detections bring monocular bodies)
METHODS = {
    "tracks, rays, keypoints alone (default)": ({}, False),
    "tracks, rays, with bodies (default)": ({}, True),
    "tracks, pelvis, both": ({"position": "scene"}, True),
    "tracks, pelvis, only position": ({"position": "scene", "affinity": "position"}, True),
    "star, pelvis, both (the paper's)": ({"method": "star", "position": "scene"}, True),
    "star, pelvis, only position": ({"method": "star", "position": "scene", "affinity": "position"}, True),
    "star, rays, keypoints alone": ({"method": "star", "affinity": "position"}, False),
}


@dataclasses.dataclass(frozen=True)
class Take:
    """What is the same for every draw of noise: cameras, lenses, true keypoints (T, P, K, 3), poses (T, P, 72),
    pelvises (T, P, 3), shapes (P, 10)."""

    cameras: list[Camera]
    lenses: list[Lens]
    keypoints_m: np.ndarray
    poses: np.ndarray
    pelvis_m: np.ndarray
    betas: np.ndarray
    tracers: list[Tracer]
    first_actor: int


def crossing(frames: int = FRAMES, fps: float = 30.0) -> Take:
    """Three people who pass each other in the middle, half a metre apart, halfway through the clip."""
    described = read_description(RESOURCES / "studio" / "defaults.yaml")
    described = replace(
        described,
        frames=frames,
        fps=fps,
        size=(1280, 704),
        people=PEOPLE,
        cameras=replace(described.cameras, jitter_deg=0.0, held_out=0),
    )
    times_s = np.arange(frames) / described.fps
    cast = Actors(described, BodyModel.load(RESOURCES / "body.npz"), times_s)
    for k, actor in enumerate(cast.actors):
        heading = 2 * np.pi * k / PEOPLE + 0.3
        left = 0.25 * np.array([-np.sin(heading), np.cos(heading)])
        part = MotionPart(
            Walked(tuple(left), 0.0, heading, -NEVER, NEVER), 1.18, 0.9, -0.9 * times_s[-1] / 2 + 0.1 * k, NEVER, NEVER
        )
        poses, trans_m = perform(part, cast.body, actor.betas, times_s)
        cast.actors[k] = replace(actor, poses=poses, trans_m=trans_m)
    solids = build_room(described.seed, 0.0)
    ideal = rig.cameras(described)
    return Take(
        ideal,
        rig.true_lenses(described, ideal),
        cast.keypoints_m(LAYOUTS[LAYOUT].keypoints),
        np.stack([a.poses for a in cast.actors], axis=1),
        np.stack([a.trans_m for a in cast.actors], axis=1),
        np.stack([a.betas for a in cast.actors]),
        [Tracer(solids + cast.at(t)[0]) for t in range(frames)],
        len(solids),
    )


def drawn(take: Take, seed: int, options: detections.Settings) -> tuple[list[Detections], list[np.ndarray]]:
    """Detections of every camera with bodies, and the true person of each, -1 = nobody."""
    found, owners = [], []
    for v, (camera, lens) in enumerate(zip(take.cameras, take.lenses)):
        rng = np.random.default_rng([seed, v])
        shown = [
            (t, person)
            for t in range(FRAMES)
            for person in detect(take.keypoints_m[t], lens, take.tracers[t], take.first_actor, NOISE, rng)
        ]
        frame, keypoints = np.array([t for t, _ in shown]), np.array([person for _, person in shown])
        wild = (rng.random(keypoints.shape[:2]) < OUTLIERS) & (keypoints[..., 2] > 0)
        away = rng.uniform(40, 200, keypoints.shape[:2]), rng.uniform(0, 2 * np.pi, keypoints.shape[:2])
        keypoints[..., :2] += np.where(
            wild[..., None], away[0][..., None] * np.stack([np.cos(away[1]), np.sin(away[1])], -1), 0.0
        )
        keypoints[keypoints[..., 2] < options.min_confidence] = [np.nan, np.nan, 0.0]
        keep = (keypoints[..., 2] > 0).sum(1) >= options.min_keypoints
        frame, keypoints = frame[keep], keypoints[keep]
        keep = drop_duplicates(frame, keypoints, options.tracking)
        frame, keypoints = frame[keep], keypoints[keep]
        who = nearest(take, camera, frame, keypoints)
        track = track_ids(frame, keypoints, options.tracking, 30.0)
        found.append(Detections(camera.name, LAYOUT, frame, track, keypoints, *bodies(take, camera, frame, who, rng)))
        owners.append(who)
    return found, owners


def nearest(take: Take, camera: Camera, frame: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
    """(D,) the person whose true keypoints lie nearest to each detection's in the median, -1 when further than 25
    px."""
    projected = camera.project(take.keypoints_m[frame])[0]
    apart = np.linalg.norm(projected - keypoints[:, None, :, :2], axis=-1)
    median = np.nanmedian(apart, axis=-1)
    return np.where(median.min(1) < 25, median.argmin(1), -1)


def bodies(
    take: Take, camera: Camera, frame: np.ndarray, who: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Planted monocular bodies of detections: poses (D, 23, 3) and pelvis (D, 3); a false person gets anybody's, at any
    depth."""
    lasting = exp(rng.normal(0, POSE_RAD, (PEOPLE, 23, 3)))
    offset = rng.normal(0, DEPTH_M, PEOPLE)
    someone = np.where(who >= 0, who, rng.integers(0, PEOPLE, len(who)))
    true = exp(take.poses[frame, someone].reshape(-1, 24, 3)[:, 1:])
    noisy = true @ lasting[someone] @ exp(rng.normal(0, POSE_RAD, (len(who), 23, 3)))
    pixels, depth = camera.project(take.pelvis_m[frame, someone])
    depth = (
        depth
        + offset[someone]
        + rng.normal(0, DEPTH_M, len(who))
        + np.where(who < 0, rng.uniform(-1, 1, len(who)), 0.0)
    )
    return log(noisy), np.column_stack([pixels, depth])


def score(
    found: list[Detections], owners: list[np.ndarray], take: Take, options: associate.Settings
) -> dict[str, float]:
    """Scores of one draw, after association has judged who is a person at all."""
    limits = options.association, options.triangulation
    started = time.perf_counter()
    with redirect_stdout(io.StringIO()):
        table, rows, _ = identities_from_keypoints(*limits, take.cameras, found, [], FRAMES, 30.0)
    seconds = time.perf_counter() - started
    names = {name: k for k, (name, *_) in enumerate(rows)}
    given = [np.array([names.get(table[d.camera, int(t)].person, -1) for t in d.track]) for d in found]
    view = np.repeat(np.arange(len(found)), [len(d.frame) for d in found])
    scores = identity_scores(
        np.concatenate([d.frame for d in found]), view, np.concatenate(owners), np.concatenate(given)
    )
    compared = TrackComparison(found, take.cameras, FRAMES, 30.0, options.association, options.triangulation)
    groups, _ = group_tracks(compared)
    margins = compared.pairs.margins([group.members for group in groups])
    return {
        "accuracy": scores.accuracy,
        "precision": scores.precision,
        "idf1": scores.idf1,
        "switches": scores.switches,
        "wrong_frames": scores.wrong_frames,
        "people": len(rows),
        "undecided_tracks": sum(m < options.association.undecided_margin for m in margins.values()),
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=8)
    draws = parser.parse_args().draws
    reading = loaded(detections.Settings)
    print(
        f"{date.today()} {platform.processor() or platform.machine()}, {PEOPLE} people, "
        f"{FRAMES} frames, 4 cameras, {draws} draws"
    )
    take = crossing()
    first, second = np.triu_indices(PEOPLE, 1)
    apart = np.linalg.norm(take.pelvis_m[:, first, :2] - take.pelvis_m[:, second, :2], axis=-1)
    print(f"nearest they come to each other: {apart.min():.2f} m")
    samples = [drawn(take, seed, reading) for seed in range(draws)]
    table = {}
    for name, (changed, with_bodies) in METHODS.items():
        options = loaded(associate.Settings, association=changed)
        rows = []
        for found, owners in samples:
            given = found if with_bodies else [replace(d, body_pose=None, pelvis=None) for d in found]
            rows.append(score(given, owners, take, options))
        table[name] = {k: float(np.nanmean([r[k] for r in rows])) for k in rows[0]} | {
            "worst_accuracy": min(r["accuracy"] for r in rows),
            "worst_precision": min(r["precision"] for r in rows),
            "wrong_frames": int(sum(r["wrong_frames"] for r in rows)),
            "seconds": min(r["seconds"] for r in rows),
        }
        r = table[name]
        print(
            f"{name:42s} accuracy {r['accuracy']:6.1%} (worst {r['worst_accuracy']:6.1%})  "
            f"precision {r['precision']:6.1%} (worst "
            f"{r['worst_precision']:6.1%})  IDF1 {r['idf1']:.3f}  wrong frames "
            f"{r['wrong_frames']:3d}  people {r['people']:.1f}  "
            f"undecided {r['undecided_tracks']:.1f}  {r['seconds']:.2f} s"
        )
    write_json(
        RESULT, {"draws": draws, "frames": FRAMES, "people": PEOPLE, "nearest_m": float(apart.min()), "methods": table}
    )


if __name__ == "__main__":
    main()
