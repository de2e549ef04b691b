# SPDX-License-Identifier: Apache-2.0
"""Hands of finished runs: in how many views, how well views agree, how constant bones are; off from a made studio's.

    python -m benchmarks.hands results/SCENE [results/SCENE …]
    python -m benchmarks.hands exchanged       # left and right hand in four times 1,000 made frames of four cameras
    python -m benchmarks.hands cost results/SCENE DATASET [blazepose]

The last one detects people in the videos of DATASET again, with and without hands. Seconds are of processor time.
"""

from __future__ import annotations

import sys
import tempfile
import time
from itertools import product
from pathlib import Path

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.detector.crops import Region
from studiorecon.detector.hand_landmarks import Hand
from studiorecon.geometry.rotations import kabsch
from studiorecon.keypoints.layouts import HAND_POINT_NAMES
from studiorecon.people.fitting.hands import by_side, person_hands
from studiorecon.people.fitting.points import Triangulation, triangulate_hands
from studiorecon.people.hand_search import Arm, find_hands
from studiorecon.rig.body_points import person_tracks
from studiorecon.rig.hand_sizes import hand_sizes_px, second_best
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import Detections, Person, read_detections, read_identities, read_people
from studiorecon.studio.hand_motion import finger_poses
from studiorecon.studio.performance import PARTS, perform, random_betas

from benchmarks.detector import find_people, look_again
from tests.made.cameras import look_at

# Every point of a hand and the one before it on its finger.
BONES = np.array([(0 if k % 4 == 1 else k - 1, k) for k in range(1, 21)])
# The same of a hand's wrist and 15 joints.
JOINT_BONES = np.array([(0 if k % 3 == 1 else k - 1, k) for k in range(1, 16)])
# Shares of each camera's seconds with exchanged arms, and of each hand's half seconds in which the network is sure of
# the wrong side: worse than films.
_SWAPPED, _WRONG = 0.1, 0.2


def rows(results: Path) -> list[str]:
    """A line for every person and hand."""
    manifest, cameras = read_manifest(results / "capture/manifest.json"), read_model(results / "cameras")
    seen = [read_detections(results / f"people/detections/{c.name}.npz") for c in cameras]
    whose, film_px = read_identities(results / "people/identities.tsv"), [manifest.of(c.name).film_px for c in cameras]
    lines = []
    for person in read_people(results / "people/people.tsv"):
        lines += against_truth(results, person, seen, whose, cameras, film_px, manifest.frames)
        hands = person_hands(person, seen, whose, cameras, film_px, manifest.frames, "auto", manifest.fps)
        if hands is not None:
            fitted = read_person(results / f"people/{person}.npz")
            lines += agreement(f"{results.name} {person}", hands, cameras, film_px, fitted)
    return lines


def agreement(label: str, hands: np.ndarray, cameras: list[Camera], film_px: list[float], fitted: Person) -> list[str]:
    """A line for the left and the right of ``hands`` (V, T, 2, 21, 3), and those that were ``fitted`` to them."""
    lines = []
    for side, found in enumerate(triangulate_hands(hands, cameras, Triangulation())):
        whole = np.isfinite(found.points_m).all((1, 2))
        points, views = found.points_m[whole], np.bincount((hands[:, :, side, 0, 2] > 0).sum(0)).tolist()
        off = [s * (c.project(points)[0] - h[whole, side, :, :2]) for c, h, s in zip(cameras, hands, film_px)]
        off_px = np.nanmedian(np.linalg.norm(off, axis=-1)) if len(points) else np.nan
        line = f"{label} {('left', 'right')[side]}: frames by views {views}, whole {len(points)}, off {off_px:.1f} px, "
        line += f"bones of the points {constancy(points, BONES)}"
        if fitted.hand_joints is not None:
            own = fitted.hand_joints[:, 15 * side : 15 * side + 15]
            own = np.insert(own, 0, fitted.joints[:, 20 + side], axis=1)
            line += f", of the fitted fingers {constancy(own, JOINT_BONES)}"
        lines.append(line)
    return lines


def constancy(points_m: np.ndarray, bones: np.ndarray) -> str:
    """Median deviation of bones' lengths from their medians over time: of all bones, and of the worst."""
    if not len(points_m):
        return "unknown"
    bones_mm = 1000 * np.linalg.norm(np.diff(points_m[:, bones], axis=2)[:, :, 0], axis=-1)
    spread_mm = np.median(np.abs(bones_mm - np.median(bones_mm, 0)), 0)
    return f"± {np.median(spread_mm):.1f} mm, at worst {np.max(spread_mm):.1f} mm"


def cost(results: Path, dataset: Path, detector: str = "blazepose_heavy") -> str:
    """What the search for hands adds to the detection of people."""
    people_s = hands_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for about in read_manifest(results / "capture/manifest.json").footage:
            if about.held_out:
                continue
            about_film = results, about.camera, dataset / about.source, Path(folder), detector
            began_s = time.process_time()
            find_people(about.camera, dataset / about.source, detector, Path(folder) / "found.npz")
            found_s = time.process_time()
            look_again(*about_film, hands="off")
            bare_s = time.process_time()
            look_again(*about_film, hands="auto")
            people_s += bare_s - began_s
            hands_s += time.process_time() - bare_s - (bare_s - found_s)
    return f"{results.name}: {people_s:.1f} s without hands; hands take {hands_s:.1f} s more: {hands_s / people_s:.0%}"


def against_truth(
    results: Path,
    person: str,
    seen: list[Detections],
    whose: dict[tuple[str, int], str],
    cameras: list[Camera],
    film_px: list[float],
    frames: int,
) -> list[str]:
    """A line for every hand and size in the second best view of a made studio; else none."""
    bodies = sorted((results.parent / "studio" / results.name / "truth/bodies").glob("*.npz"))
    if not bodies:
        return []
    fitted, true = read_person(results / f"people/{person}.npz"), [read_person(path) for path in bodies]
    if fitted.hand_joints is None:
        return []
    nearest = min(true, key=lambda one: np.median(np.linalg.norm(one.joints - fitted.joints, axis=-1)))
    sizes = second_best(hand_sizes_px(person_tracks(seen, whose, [person], frames, 0.2), cameras, film_px))[0]
    lines = []
    for side, word in enumerate(("left", "right")):
        own = slice(15 * side, 15 * side + 15)
        hands = [np.concatenate([p.joints[:, [20 + side]], p.hand_joints[:, own]], axis=1) for p in (fitted, nearest)]
        # In the hand's own coordinates, which the wrist and the five knuckles fix.
        turn, shift, _ = kabsch(hands[0], hands[1], np.tile(np.arange(16) % 3 == 1, (frames, 1)) | (np.arange(16) == 0))
        off_mm = 1000 * np.linalg.norm(hands[0] @ turn.mT + shift[:, None] - hands[1], axis=-1)[:, 1:].mean(1)
        measured = np.isfinite(fitted.hand_sigma[:, own]).any(1)
        for low, high in ((20, 40), (40, 70), (70, 1000)):
            at = (sizes[:, side] >= low) & (sizes[:, side] < high)
            if (at & measured).any():
                lines.append(
                    f"{results.name} {person} {word}: {low} to {high} px: measured in {(at & measured).sum()} of "
                    f"{at.sum()} frames, joints off by {np.median(off_mm[at & measured]):.1f} mm there, by "
                    f"{np.median(off_mm[at]):.1f} mm in all"
                )
    return lines


class _MadeNetwork:
    """Returns the hand nearest to the region with noise; in ``_WRONG`` of half seconds it is sure of the wrong side."""

    def __init__(self, hands: np.ndarray, rng: np.random.Generator) -> None:
        self.hands, self.rng = hands, rng
        self.errs = np.repeat(rng.random((-(-len(hands) // 10), 2)) < _WRONG, 10, axis=0)

    def look(self, picture: np.ndarray, region: Region) -> Hand:
        both, errs = self.hands[int(picture[0, 0, 0])], self.errs[int(picture[0, 0, 0])]
        side = int(np.linalg.norm(both.mean(1) - region.centre, axis=1).argmin())
        opinion = 1 - side if errs[side] else side
        return Hand(both[side] + self.rng.normal(0, 3, (21, 2)), 0.9, float(np.clip(opinion, 0.02, 0.98)))


def exchanged(body: BodyModel, seed: int, frames: int = 1000) -> str:
    """How often left and right are exchanged where a walker's arms are, in a tenth of each camera's seconds.

    Only the pictures are not made: the search, its gates and the geometry are those of a run.
    """
    rng, times_s = np.random.default_rng(seed), np.arange(frames) / 20
    betas = random_betas(5, 0)
    poses, trans_m = perform(PARTS[0], body, betas, times_s)
    whole, poses = body.with_fingers, np.concatenate([poses, finger_poses(body, 5, times_s)], axis=1)
    points_m = np.stack([whole.keypoints(n, poses, betas, trans_m) for n in HAND_POINT_NAMES], axis=1)
    elbows_m = body.joints(poses[:, :72], betas, trans_m)[:, [18, 19]]
    found, seen = np.full((4, frames, 2, 21, 3), [np.nan, np.nan, 0.0]), []
    right = np.full((4, frames, 2), np.nan)
    cameras = [_camera(k) for k in range(4)]
    for view, camera in enumerate(cameras):
        hands, elbows = camera.project(points_m)[0], camera.project(elbows_m)[0]
        swapped = np.repeat(rng.random(-(-frames // 20)) < _SWAPPED, 20)[:frames]
        arms = []
        for t, side in product(range(frames), (0, 1)):
            own = 1 - side if swapped[t] else side
            wrist, elbow = (p + rng.normal(0, 4, 2) for p in (hands[t, own, 0], elbows[t, own]))
            length = float(0.19 * camera.focal_px[0] / camera.project(points_m[t, own, 0])[1])
            arms.append(Arm(t, 2 * t, side, 0, wrist, 2 * wrist - elbow, length))
        pictures = (np.full((1, 1, 1), t) for t in range(frames))
        for (row, side), hand in find_hands(_MadeNetwork(hands, rng), pictures, arms).items():
            found[view, row // 2, side] = np.column_stack([hand.points, np.full(21, 0.6)])
            right[view, row // 2, side] = hand.right
        seen.append(swapped)
    wrong, settled = {}, by_side(found, right, cameras, 20.0)[0]
    for name, given in (("before", found), ("after", settled)):
        near = np.array([np.linalg.norm(given[v, :, :, None, :, :2] - c.project(points_m[:, None])[0], axis=-1).mean(-1)
                         for v, c in enumerate(cameras)])  # fmt: skip
        own, other = near[..., [0, 1], [0, 1]], near[..., [0, 1], [1, 0]]
        wrong[name] = int((other < own).sum()), int(np.isfinite(own).sum())
    solved = [p.points_m[:, 0] for p in triangulate_hands(settled, cameras, Triangulation())]
    far = [np.linalg.norm(p - points_m[:, s, 0], axis=1) - np.linalg.norm(p - points_m[:, 1 - s, 0], axis=1)
           for s, p in enumerate(solved)]  # fmt: skip
    return (
        f"{frames} frames of 4 cameras, arms exchanged in {np.mean(seen):.0%} of pictures: hands of the other side in "
        f"pictures {wrong['before']} as arms say and {wrong['after']} as all witnesses say; in the world "
        f"{sum(int((d > 0).sum()) for d in far)} of {sum(int(np.isfinite(d).sum()) for d in far)}"
    )


def _camera(k: int) -> Camera:
    """One of four cameras 3.5 m from the middle, 90 degrees apart."""
    angle = np.pi / 2 * (k + 0.3)
    place = np.array([3.5 * np.cos(angle), 3.5 * np.sin(angle), 1.5])
    return look_at(f"cam{k}", place, np.array([0.0, 0.0, 1.0]), (1280, 720), 1000.0)


if __name__ == "__main__":
    if sys.argv[1:] == ["exchanged"]:
        body = BodyModel.load(Path("resources/body.npz"))
        print(*(exchanged(body, seed) for seed in (5, 6, 7, 8)), sep="\n")
        sys.exit()
    if sys.argv[1] == "cost":
        print(cost(Path(sys.argv[2]), Path(sys.argv[3]), *sys.argv[4:]))
        sys.exit()
    print("\n".join(line for folder in sys.argv[1:] for line in rows(Path(folder))))
