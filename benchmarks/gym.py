# SPDX-License-Identifier: Apache-2.0
"""Accuracy of association in a gym with many things that look like people: ``python -m benchmarks.gym [--draws 4]
[--terms]``.

Five cameras, 12 s at 15 pictures a second, seven people: three walk about, one arrives after 5 s, one leaves after 4 s
and returns 4 s later, one sits on a chair, one sits behind a desk that hides hips and legs from two cameras. Besides
them a poster, a television, a mirror, and twelve chairs, which a detector takes for somebody who sits, in two of five
cameras each, for a second or so. No picture is drawn: keypoints have the errors of a detector (those of each camera
last, 1.2 % of a person's height; 3 % outliers; 5 % drop-outs; people behind others are missed). Pictures, of
thick limbs in everybody's colours, only show where something moves and who wears what; there are no masks. Prints a
table and writes benchmarks/results/gym.json. ``--terms``: what each term of the likelihood is worth.
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from studiorecon.body.fitting import prior
from studiorecon.body.model import BodyModel
from studiorecon.footage.video import write_lossless
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES, LAYOUTS
from studiorecon.keypoints.tracking import drop_duplicates, track_ids
from studiorecon.people import associate
from studiorecon.people.association.acceptance import group_terms, identities_from_keypoints, pair_terms
from studiorecon.people.association.gaps import group_tracks
from studiorecon.people.association.grouping import TrackComparison
from studiorecon.people.association.terms import PRIOR_NATS
from studiorecon.report.metrics.identity_scores import identity_scores
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections
from studiorecon.studio.description import RESOURCES
from studiorecon.tracks import keypoints as detections

from tests.defaults import loaded
from tests.made.cameras import look_at

RESULT = Path(__file__).resolve().parent / "results" / "gym.json"
LAYOUT, FPS, FRAMES, WH = "body_25", 15.0, 180, (640, 352)
NAMES = LAYOUTS[LAYOUT].keypoints
SIDES = [NAMES.index(n.replace(*("left", "right") if "left" in n else ("right", "left"))) for n in NAMES]
FACE = [k for k, n in enumerate(NAMES) if any(j in n for j in ("eye", "ear", "nose"))]
LEGS = [k for k, n in enumerate(NAMES) if any(j in n for j in ("hip", "knee", "ankle", "toe", "heel"))]
# Errors of a detector's points: share of the person's height, and how long they last, s.
NOISE_SHARE, LASTS_S = 0.012, 0.3
OUTLIERS, DROP_OUTS = 0.03, 0.05
CHAIRS, TAKEN_FOR_SOMEBODY = 12, 0.4


@dataclass(frozen=True)
class Figure:
    """Something with a skeleton.

    Attributes:
        points_m: (V, T, K, 3) where each camera takes it to be; NaN where there is nothing.
        person: number of the person, -1 for nobody.
        confidence: of its keypoints.
    """

    points_m: np.ndarray
    person: int
    confidence: float = 0.85


def cameras() -> list[Camera]:
    """Five, 2.6 m high along the walls of a room of 8 by 6 m."""
    places = [(-3.9, -2.9), (3.9, -2.9), (3.9, 2.9), (-3.9, 2.9), (0.0, -2.9)]
    return [look_at(f"c{k}", np.array([x, y, 2.6]), [0, 0.3, 0.9], WH, 400.0) for k, (x, y) in enumerate(places)]


def posed(sits: bool, tall: float = 0.0) -> np.ndarray:
    """(25, 3) somebody at the origin, z up, facing y, feet on the floor; ``tall``: first coefficient of the shape."""
    body, pose = BodyModel.load(RESOURCES / "body.npz"), rotations.log(prior.mean_pose()).reshape(24, 3)
    if sits:
        for side in ("left", "right"):
            pose[JOINT_NAMES.index(f"{side}_hip")] = [-np.pi / 2, 0, 0]
            pose[JOINT_NAMES.index(f"{side}_knee")] = [np.pi / 2, 0, 0]
    points = body.keypoints(list(NAMES), pose.reshape(1, 72), tall * np.eye(10)[0], np.zeros((1, 3)))[0]
    points = points[:, [0, 2, 1]] * [-1, 1, 1]
    return points - [0, 0, points[:, 2].min()]


def turned(points_m: np.ndarray, heading_rad: np.ndarray | float) -> np.ndarray:
    """Points (..., K, 3) that face y turned by headings (...) about z."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    zero, one = np.zeros_like(c), np.ones_like(c)
    turn = np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], -2)
    return points_m @ np.swapaxes(turn, -1, -2)


def walking(figure: np.ndarray, way_m: np.ndarray) -> np.ndarray:
    """(T, K, 3) somebody along a way (T, 2), hands and feet swinging with the steps."""
    step = np.gradient(way_m, axis=0)
    gone_m = np.cumsum(np.linalg.norm(step, axis=1))
    swing = np.array([0.22 * any(j in n for j in ("wrist", "ankle", "toe", "heel")) for n in NAMES])
    swing = swing * np.where(["left" in n for n in NAMES], 1, -1) * np.where(["wrist" in n for n in NAMES], -1, 1)
    moved = np.repeat(figure[None], len(way_m), axis=0)
    moved[..., 1] += swing * np.sin(2 * np.pi * gone_m / 1.4)[:, None]
    return turned(moved, np.arctan2(-step[:, 0], step[:, 1])) + np.pad(way_m, ((0, 0), (0, 1)))[:, None]


def people() -> list[np.ndarray]:
    """(T, K, 3) of the seven, NaN while away."""
    t = np.arange(FRAMES) / FPS
    stands, sits = [posed(False, tall) for tall in (0.0, 1.0, -1.0, 0.5, -0.5)], posed(True)

    def around(x: float, y: float, rx: float, ry: float, speed: float, phase: float) -> np.ndarray:
        angle = speed * t / max(rx, ry) + phase
        return np.column_stack([x + rx * np.cos(angle), y + ry * np.sin(angle)])

    out = [
        walking(stands[0], around(-1.2, 0.6, 1.0, 0.8, 1.1, 0.0)),
        walking(stands[1], around(0.2, -1.4, 1.2, 0.6, -0.9, 2.0)),
        walking(stands[2], around(0.4, 0.9, 0.6, 0.9, 0.8, 4.0)),
        walking(stands[3], np.column_stack([3.4 - 0.4 * np.clip(t - 5, 0, 5), 0.5 + 0.1 * np.sin(t)])),
    ]
    out[3][t < 5] = np.nan
    out_and_in = np.where(t < 6, 1.8 + 0.4 * t, 3.4 - 0.3 * (t - 8))
    out.append(walking(stands[4], np.column_stack([out_and_in, -1.3 + 0.05 * t])))
    out[4][(t > 4) & (t < 8)] = np.nan
    fidget = 0.03 * np.sin(2 * np.pi * 0.2 * t)[:, None, None] * np.array(["wrist" in n for n in NAMES])[:, None]
    out.append(turned(sits, 0.7) + np.array([-2.4, -1.2, 0]) + fidget)
    out.append(turned(sits, 3.0) + np.array([1.8, 2.1, 0]) + 0.5 * fidget)
    return out


def images() -> list[np.ndarray]:
    """(T, K, 3) of the poster, of the person on the television, and of the first person in the mirror."""
    t = np.arange(FRAMES) / FPS
    poster = np.repeat((posed(False) * [1, 0, 1] + [-1.5, 2.95, 0.4])[None], FRAMES, axis=0)
    screen = walking(posed(False), np.column_stack([0.6 * np.sin(t), 0.2 * t]))
    screen = 0.6 * screen[..., [0, 2]] @ np.array([[0, 1, 0], [0, 0, 1.0]]) + [-3.95, 0.8, 0.9]
    return [poster, screen, people()[0][:, SIDES] * [1, -1, 1] + [0, 2 * 2.98, 0]]


def figures(rng: np.random.Generator) -> list[Figure]:
    """Everything that has a skeleton; the desk stands between the last person and cameras 0 and 4."""
    views, persons = len(cameras()), people()
    out = [Figure(np.repeat(one[None], views, axis=0), k) for k, one in enumerate(persons)]
    for view in (0, 4):
        out[-1].points_m[view][:, LEGS] = np.nan
    behind = [c.centre_m[1] < 2.9 for c in cameras()]
    for image in images():
        shown = np.repeat(image[None], views, axis=0)
        shown[~np.array(behind)] = np.nan
        out.append(Figure(shown, -1, 0.75))
    out.extend(chair(rng) for _ in range(CHAIRS))
    return out


def chair(rng: np.random.Generator) -> Figure:
    """A chair that two of five cameras take for somebody who sits there, each for a while and in another posture."""
    place = np.array([rng.uniform(-3, 3), rng.uniform(-2.3, 2.5), 0])
    shown = np.full((len(cameras()), FRAMES, len(NAMES), 3), np.nan)
    for view in np.flatnonzero(rng.random(len(shown)) < TAKEN_FOR_SOMEBODY):
        at = rng.exponential(3.0)
        while at < FRAMES / FPS:
            until = at + 0.2 + rng.exponential(1.0)
            figure = turned(rng.uniform(0.55, 0.85) * posed(True), rng.uniform(0, 2 * np.pi))
            figure = figure + place + rng.normal(0, [0.1, 0.1, 0.05]) + rng.normal(0, 0.04, figure.shape)
            shown[view, round(at * FPS) : round(until * FPS)] = figure
            at = until + rng.exponential(3.0)
    return Figure(shown, -1, 0.6)


def films(persons: list[np.ndarray], folder: Path) -> list[Path]:
    """What each camera films: limbs as thick lines, shirt and trousers of each person in colours of their own."""
    limbs = [(a, b) for a, b in LAYOUTS[LAYOUT].edges if a not in FACE and b not in FACE]
    colours = np.random.default_rng(0).integers(30, 240, (len(persons), 2, 3))
    colours[-1] = colours[0]  # in the mirror
    paths = []
    for camera in cameras():
        room = np.random.default_rng(1).integers(60, 120, (22, 40, 3)).astype(np.uint8)
        room = cv2.resize(room, camera.wh, interpolation=cv2.INTER_CUBIC)
        places = [camera.project(one) for one in persons]

        def pictures(room: np.ndarray = room, places: list = places) -> Iterator[np.ndarray]:
            for t in range(FRAMES):
                picture = room.copy()
                distance = [np.nanmedian(z[t]) if np.isfinite(z[t]).any() else 0.0 for _, z in places]
                for k in np.argsort(distance)[::-1]:
                    if not distance[k]:
                        continue
                    thick = max(2, round(0.13 * 400 / distance[k]))
                    for a, b in limbs:
                        ends = [tuple(int(v) for v in places[k][0][t, i]) for i in (a, b)]
                        colour = colours[k, int(a in LEGS and b in LEGS)].tolist()
                        cv2.line(picture, *ends, colour, thick)
                yield picture

        paths.append(folder / f"{camera.name}.mkv")
        write_lossless(paths[-1], pictures(), FPS)
    return paths


def drawn(seed: int, reading: detections.Settings) -> tuple[list[Detections], list[np.ndarray], np.ndarray]:
    """Detections of every camera, the true person of each (-1 nobody), and (P, T) how many cameras see each person."""
    rng = np.random.default_rng(seed)
    scene, found, owners = figures(rng), [], []
    seen = np.zeros((7, FRAMES), int)
    for v, camera in enumerate(cameras()):
        pixels, depth = zip(*(camera.project(f.points_m[v]) for f in scene))
        frame, keypoints, whose = [], [], []
        boxes = [box(*one) for one in zip(pixels, depth)]
        errors = [lasting(rng, (FRAMES, len(NAMES), 2)) for _ in scene]
        for t in range(FRAMES):
            for k, figure in enumerate(scene):
                inside = (depth[k][t] > 0.1) & (pixels[k][t] >= 0).all(-1) & (pixels[k][t] < camera.wh).all(-1)
                if inside.sum() < 8 or hidden(k, t, boxes, scene) or rng.random() < DROP_OUTS:
                    continue
                height_px = np.ptp(pixels[k][t, inside, 1])
                points = pixels[k][t] + NOISE_SHARE * height_px * errors[k][t]
                wild = rng.random(len(NAMES)) < OUTLIERS
                points[wild] += rng.normal(0, 0.2 * height_px, (wild.sum(), 2))
                confidence = np.where(inside, figure.confidence, 0.0)
                frame.append(t)
                keypoints.append(np.column_stack([np.where(inside[:, None], points, np.nan), confidence]))
                whose.append(figure.person)
                if figure.person >= 0:
                    seen[figure.person, t] += 1
        frame, keypoints, whose = np.array(frame), np.array(keypoints), np.array(whose)
        kept = drop_duplicates(frame, keypoints, reading.tracking)
        frame, keypoints, whose = frame[kept], keypoints[kept], whose[kept]
        found.append(
            Detections(camera.name, LAYOUT, frame, track_ids(frame, keypoints, reading.tracking, FPS), keypoints)
        )
        owners.append(whose)
    return found, owners, seen


def box(pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(T, 5) left, top, right, bottom, depth of a figure in every frame; far outside and behind where it is unseen."""
    unseen = ~np.isfinite(pixels).any((1, 2))
    pixels, depth = (np.where(unseen.reshape(-1, *[1] * (a.ndim - 1)), -1e4, a) for a in (pixels, depth))
    return np.column_stack(
        [np.nanmin(pixels, 1), np.nanmax(pixels, 1), np.where(unseen, np.inf, np.nanmedian(depth, 1))]
    )


def hidden(k: int, t: int, boxes: list[np.ndarray], scene: list[Figure]) -> bool:
    """Whether a person stands before figure ``k`` in frame ``t``: six tenths of its box are theirs."""
    own = boxes[k][t]
    for j, other in enumerate(scene):
        box = boxes[j][t]
        if j == k or other.person < 0 or not box[4] < own[4]:
            continue
        shared = np.minimum(own[2:4], box[2:4]) - np.maximum(own[:2], box[:2])
        if (shared > 0).all() and np.prod(shared) > 0.6 * np.prod(own[2:4] - own[:2]):
            return True
    return False


def lasting(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Errors of variance 1 that are forgotten within ``LASTS_S``."""
    kept = np.exp(-1 / (FPS * LASTS_S))
    out = rng.normal(size=shape)
    for t in range(1, len(out)):
        out[t] = kept * out[t - 1] + np.sqrt(1 - kept**2) * out[t]
    return out


def measured(seed: int, videos: list[Path]) -> dict[str, Any]:
    """Scores of one draw."""
    options = loaded(associate.Settings)
    found, owners, seen = drawn(seed, loaded(detections.Settings))
    limits = options.association, options.triangulation
    began, messages = time.process_time(), io.StringIO()
    with redirect_stdout(messages):
        table, rows, left = identities_from_keypoints(*limits, cameras(), found, videos, FRAMES, FPS)
    spent_s = time.process_time() - began
    names = {name: k for k, (name, *_) in enumerate(rows)}
    given = [np.array([names.get(table[d.camera, int(t)].person, -1) for t in d.track]) for d in found]
    view = np.repeat(np.arange(len(found)), [len(d.frame) for d in found])
    frame, truth, named = (np.concatenate(part) for part in ([d.frame for d in found], owners, given))
    scores = identity_scores(frame, view, truth, named)
    # Somebody is placed in a frame when two cameras' detections of them have one name.
    shown, expected, placed, invented = 0, 0, 0, 0
    for person in range(7):
        owned = [set(frame[(truth == person) & (named == n) & (view == v)]) for n in range(len(rows)) for v in range(5)]
        per_name = [
            np.array([t in s for s in owned[5 * n : 5 * n + 5] for t in range(FRAMES)]) for n in range(len(rows))
        ]
        drawn_in = np.any([p.reshape(5, FRAMES).sum(0) >= 2 for p in per_name], axis=0) if rows else np.zeros(FRAMES)
        two = seen[person] >= 2
        shown, expected = shown + int((drawn_in & two).sum()), expected + int(two.sum())
        placed += bool(drawn_in.any())
    for n in range(len(rows)):
        invented += bool(np.mean(truth[named == n] < 0) > 0.5)
    # Chairs and images make tracks of their own, which belong to nobody whatever association does.
    owned_tracks = [(d.camera, int(t)) for d, o in zip(found, owners) for t in np.unique(d.track[o >= 0])]
    lost = sum(not table[track].person for track in owned_tracks)
    return {
        "people": len(rows),
        "placed": placed,
        "invented": invented,
        "idf1": scores.idf1,
        "precision": scores.precision,
        "frames_drawn": shown / expected,
        "tracks": len(table),
        "tracks_of_people": len(owned_tracks),
        "tracks_of_people_lost": lost / len(owned_tracks),
        "left_out": [f"{one.reason}; {one.nats:+.1f} nats in all" for one in left],
        "said": [line for line in messages.getvalue().splitlines() if "keeps the name" in line or "may be" in line],
        "seconds": spent_s,
    }


def weighed(seed: int, videos: list[Path]) -> list[tuple[bool, dict[str, float]]]:
    """Whether each group is a person, and its nats by term; those of pairs against people are terms too."""
    options = loaded(associate.Settings)
    found, owners, _ = drawn(seed, loaded(detections.Settings))
    compared = TrackComparison(found, cameras(), FRAMES, FPS, options.association, options.triangulation)
    groups, _ = group_tracks(compared)
    terms = [{term.name: term.nats for term in own} for own in group_terms(groups, compared, videos, [])]
    whose = [[np.median(owners[v][found[v].track == t]) for v, t in group.members] for group in groups]
    person = [bool(np.median(own) >= 0) for own in whose]
    for (g, h), term in pair_terms(groups, cameras(), FPS).items():
        if person[h] and not person[g]:
            terms[g][term.name] = min(term.nats, terms[g].get(term.name, 0.0))
    return list(zip(person, terms))


def print_worth(groups: list[tuple[bool, dict[str, float]]]) -> None:
    """Print the least nats of a person and the most of nobody, with all terms and without each."""
    for left_out in ["", *dict.fromkeys(name for _, own in groups for name in own)]:
        nats = [(person, PRIOR_NATS + sum(n for t, n in own.items() if t != left_out)) for person, own in groups]
        least, most = min(n for person, n in nats if person), max(n for person, n in nats if not person)
        print(f"without {left_out or 'nothing':12s} people {least:+5.1f} nats or more, nobody {most:+5.1f} or less")


def main() -> None:
    """Print one line per draw, or per term."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--terms", action="store_true")
    given = parser.parse_args()
    rows, folder = [], Path(tempfile.mkdtemp())
    videos = films([*people(), *images()], folder)
    if given.terms:
        print_worth([group for seed in range(given.draws) for group in weighed(seed, videos)])
        shutil.rmtree(folder)
        return
    for seed in range(given.draws):
        rows.append(row := measured(seed, videos))
        print(
            f"draw {seed}: {row['placed']} of 7 placed under {row['people']} names, {row['invented']} invented; IDF1 "
            f"{row['idf1']:.1%}, precision {row['precision']:.1%}, frames drawn {row['frames_drawn']:.1%}; "
            f"{row['tracks_of_people_lost']:.0%} of the {row['tracks_of_people']} tracks of people are nobody's, "
            f"of {row['tracks']} tracks; {row['seconds']:.1f} s"
        )
        for line in row.pop("said"):
            print(f"    {line}")
        for reason in row["left_out"]:
            print(f"    left out: {reason}")
    shutil.rmtree(folder)
    write_json(RESULT, {"draws": rows})


if __name__ == "__main__":
    main()
