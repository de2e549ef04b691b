# SPDX-License-Identifier: Apache-2.0
"""The room around all cameras, from every sweep's votes, its furniture, and a first depth of every camera that agrees
with the others.

Writes ``depth/room.json`` (``scene.room.RoomBox``), ``depth/primitives.json`` (``depth.layout.primitives.Primitive``)
with a picture of them, and ``depth/passes.npz`` (one (H, W) depth per camera at the sweep's size).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.depth.layout import box as room
from studiorecon.depth.layout.furniture import furnish
from studiorecon.depth.layout.primitives import Primitive, in_front, write_primitives
from studiorecon.depth.layout.primitives_picture import sheet
from studiorecon.depth.layout.visibility import seen_through, walked
from studiorecon.depth.stereo.passes import PassSettings, explain, plane_depths, plane_scores
from studiorecon.depth.stereo.plates import Picture, equalised, read_pictures, surface_gains
from studiorecon.depth.sweep_settings import FirstLook
from studiorecon.errors import UserError
from studiorecon.images.encoded import write_png
from studiorecon.progress import progress, say
from studiorecon.scene.files import write_npz
from studiorecon.scene.intermediate import read_arrays
from studiorecon.scene.people import read_detections, read_identities
from studiorecon.scene.room import FACES, RoomBox, write_room
from studiorecon.signature import Written

_PLACING_SPAN_M, _PLACING_STEP_M = 0.08, 0.01
_CANDIDATE_SPAN_M, _CANDIDATE_STEP_M = 0.04, 0.02
_VOTER_REACH_M = 0.15
# A wall this far along on either side votes for offsets this much times sin(turn) apart when its yaw was off by the
# turn.
_HALF_WALL_M = 4.0
_OUTSIDE_MARGIN_M = 0.05
# Span and step of the walls' turn: first what the sweep may be off by without lines, then to a tenth of a degree.
_YAW_SEARCH_RAD = ((np.radians(2.5), np.radians(0.5)), (np.radians(0.4), np.radians(0.1)))


@dataclass(frozen=True)
class Settings(PassSettings, FirstLook):
    """What makes a wall: so far outside the outermost camera, with so many of all pixels behind it; the height of a
    ceiling that nobody sees; the size in pixels of pictures that furniture is fitted to, and what it must explain."""

    wall_clearance_m: float = 0.3
    wall_votes: float = 0.004
    ceiling_default_m: float = 3.2
    candidates: int = setting(
        60, "Planes inside the room that the second look tries, at most.", minimum=0, maximum=1000
    )
    passes: int = setting(2, "Rounds in which each camera is judged against the others' depth.", minimum=1, maximum=10)
    primitives: int = setting(
        40,
        "Upright boxes and cylinders that are put into the room, at most; 0 = none.",
        minimum=0,
        maximum=1000,
        paper="none; its depth is a network's",
        letter=0,
    )
    primitives_width: int = 160
    primitives_gain: float = 40.0


def fit_room_box(
    pictures: list[Picture], votes: room.Votes, yaw_rad: float, floor_m: float, settings: Settings
) -> RoomBox:
    """The box of the most voted walls around all cameras; faces that too few pixels voted for are defaults.

    A default wall stands ``far_m`` beyond the cameras, the default ceiling at ``ceiling_default_m`` above the floor (at
    least a metre above the highest camera): an open place has no walls, and ``fitted`` says so.
    """
    how = room.Matching(settings.window, settings.mean_weight, settings.near_m, settings.far_m)
    count = votes.count()
    least = settings.wall_votes * sum(c.size for c in votes.chosen)
    centres = np.stack([p.camera.centre_m for p in pictures])
    start = RoomBox(yaw_rad, np.full(3, -np.inf), np.full(3, np.inf), np.zeros(6, bool), np.full(6, np.nan))

    def found(face: int, clearance_m: float) -> float | None:
        axis, side = start.axes[face // 2], 2 * (face % 2) - 1
        edge = side * (side * centres @ axis).max()
        beyond = edge + side * clearance_m
        offsets = room.strong_offsets(votes.planes, count, axis, beyond, side, least)
        return room.decide_face(pictures, votes, axis, offsets, beyond, side, how) if offsets else None

    walls = {face: offset for face in range(4) if (offset := found(face, settings.wall_clearance_m)) is not None}
    turn = 0.0
    for span_rad, step_rad in _YAW_SEARCH_RAD:
        box = replace(
            start, yaw_rad=yaw_rad + turn, low_m=centres.min(0) - settings.far_m, high_m=centres.max(0) + settings.far_m
        )
        for face, offset in walls.items():
            (box.low_m, box.high_m)[face % 2][face // 2] = offset
        # Every pixel that looks at a wall takes part, not only its voters: those were chosen by agreeing with the yaw
        # that is in question.
        looks = [p.textured(settings.window) & p.known for p in pictures]
        faces = [box.intersect(*p.camera.rays())[1] for p in pictures]
        seen = [
            (np.array([*box.axes[f // 2], o]), [m & (at == f) for m, at in zip(looks, faces)]) for f, o in walls.items()
        ]
        turn += room.refine_yaw(pictures, seen, span_rad, step_rad, how)
    axes = replace(start, yaw_rad=yaw_rad + turn).axes
    low, high, fitted, score = np.zeros(3), np.zeros(3), np.zeros(6, bool), np.full(6, np.nan)
    for face in range(4):
        axis, side = face // 2, 2 * (face % 2) - 1
        offset = side * ((side * centres @ axes[axis]).max() + settings.far_m)
        if face in walls:
            reach_m = _VOTER_REACH_M + _HALF_WALL_M * abs(np.sin(turn))
            voters = votes.voters(start.axes[axis], walls[face], reach_m)
            begin = room.turned_offset(pictures, voters, np.array([*start.axes[axis], walls[face]]), axes[axis], how)
            offset, score[face] = room.place_plane(
                pictures, voters, axes[axis], begin, _PLACING_SPAN_M, _PLACING_STEP_M, how
            )
            fitted[face] = True
        (low, high)[face % 2][axis] = offset
    voters = votes.voters(axes[2], floor_m, 0.06)
    low[2], score[4] = room.place_plane(pictures, voters, axes[2], floor_m, 0.05, _PLACING_STEP_M, how)
    fitted[4] = sum(int(v.sum()) for v in voters) >= least
    high[2] = max(low[2] + settings.ceiling_default_m, centres[:, 2].max() + 1.0)
    top = found(5, 0.2)
    if top is not None:
        voters = votes.voters(axes[2], top, _VOTER_REACH_M)
        high[2], score[5] = room.place_plane(pictures, voters, axes[2], top, _PLACING_SPAN_M, _PLACING_STEP_M, how)
        fitted[5] = True
    return RoomBox(yaw_rad + turn, low, high, fitted, score)


def inside_votes(pictures: list[Picture], votes: room.Votes, room_box: RoomBox, settings: Settings) -> room.Votes:
    """The votes whose points lie inside the room box; nothing is seen through a wall."""
    kept = []
    for picture, chosen, confident in zip(pictures, votes.chosen, votes.confident):
        depth_m = picture.depth_of(votes.planes[chosen])
        points = picture.camera.unproject(picture.camera.pixel_centres(), depth_m)
        kept.append(confident & (depth_m > 0) & room_box.contains(points, _OUTSIDE_MARGIN_M))
    return replace(votes, confident=kept)


def refine_candidates(pictures: list[Picture], votes: room.Votes, planes: np.ndarray, settings: Settings) -> np.ndarray:
    """The candidate planes with their offsets placed by their own voters; the six faces of the room box stay."""
    how = room.Matching(settings.window, settings.mean_weight, settings.near_m, settings.far_m)
    placed = planes.copy()
    for k in progress(range(6, len(planes)), "placing planes"):
        voters = votes.voters(planes[k, :3], planes[k, 3], 0.07)
        offset, score = room.place_plane(
            pictures, voters, planes[k, :3], planes[k, 3], _CANDIDATE_SPAN_M, _CANDIDATE_STEP_M, how
        )
        if np.isfinite(score):
            placed[k, 3] = offset
    return placed


def agreeing_depths(
    pictures: list[Picture],
    room_box: RoomBox,
    primitives: list[Primitive],
    starts: list[np.ndarray],
    settings: Settings,
) -> list[np.ndarray]:
    """Depth (H, W) of every picture after ``passes`` rounds in which each is judged against the others' latest depth
    and the primitives."""
    depths = [plane_depths(p, room_box.planes, room_box, settings) for p in pictures]
    scores = [
        [plane_scores(p, o, room_box.planes, d, settings) for j, o in enumerate(pictures) if j != i]
        for i, (p, d) in enumerate(zip(pictures, depths))
    ]
    latest = starts
    for _ in progress(range(settings.passes), "agreeing"):
        others = [
            [(p.camera, d) for j, (p, d) in enumerate(zip(pictures, latest)) if j != i] for i in range(len(pictures))
        ]
        found = [
            explain(p, room_box.planes, d, s, o, settings).depth_m
            for p, d, s, o in zip(pictures, depths, scores, others)
        ]
        latest = [in_front(primitives, p.camera, depth_m)[0] for p, depth_m in zip(pictures, found)]
    return latest


def run(
    settings: Settings,
    model: Path,
    plates: list[Path],
    sweeps: list[Path],
    fits: list[Path],
    detections: list[Path],
    identities: list[Path],
    room_box: Written,
    primitives: Written,
    picture: Written,
    passes: Written,
) -> None:
    """Fit the room box to all sweeps, put furniture into it, and let the cameras agree on depth.

    ``fits``, ``detections`` and ``identities`` tell where nothing can stand; without them only the cameras do.
    """
    cameras = read_model(model.parent)
    swept = [read_arrays(path) for path in sweeps]
    if len(swept) != len(cameras) or not all(np.array_equal(s["planes"], swept[0]["planes"]) for s in swept):
        raise UserError(
            f"{len(swept)} sweeps for {len(cameras)} cameras, or sweeps of different "
            "settings: run depth.sweep again for all"
        )
    gains = swept[0]["gains"]
    pictures = equalised(read_pictures(cameras, plates, settings.sweep_width), gains)
    votes = room.Votes(swept[0]["planes"], [s["chosen"].astype(int) for s in swept], [s["confident"] for s in swept])
    fitted = fit_room_box(pictures, votes, float(swept[0]["yaw_rad"]), float(swept[0]["floor_m"]), settings)
    for name, ok, face, score in zip(FACES, fitted.fitted, fitted.faces, fitted.score):
        say(
            f"{name} at {face[3]:.3f} m"
            + (f" (correlation {score:.2f})" if ok else ": a default, no such surface was found")
        )
    votes = inside_votes(pictures, votes, fitted, settings)
    planes = room.candidates(
        votes.planes, votes.count(), fitted, settings.candidates, least_votes=_least_voters(pictures)
    )
    planes = refine_candidates(pictures, votes, planes, settings)
    fitted = replace(fitted, planes=planes)
    say(f"{len(planes) - 6} planes inside the room are worth trying")
    furniture: list[Primitive] = []
    if settings.primitives and len(cameras) > 1:
        small = equalised(read_pictures(cameras, plates, settings.primitives_width), gains)
        bodies, whose = [read_person(path) for path in fits], read_identities(identities[0]) if identities else {}
        free_m = np.concatenate(
            [walked(bodies), seen_through(cameras, bodies, [read_detections(path) for path in detections], whose)]
        )
        say(f"{len(free_m)} places of {len(bodies)} people and of what cameras saw of them are kept free of furniture")
        furniture = furnish(
            small,
            fitted,
            free_m,
            window=settings.refine_window,
            mean_weight=settings.mean_weight,
            least_gain=settings.primitives_gain,
            most=settings.primitives,
        )
        say(f"{len(furniture)} boxes and cylinders explain what walls and floor do not")
    starts = []
    for p, chosen, confident in zip(pictures, votes.chosen, votes.confident):
        wall_m = fitted.intersect(*p.camera.rays())[0]
        seen_m = np.where(confident, p.depth_of(votes.planes[chosen]), wall_m).astype(np.float32)
        starts.append(in_front(furniture, p.camera, seen_m)[0])
    depths = agreeing_depths(pictures, fitted, furniture, starts, settings)
    rest, pairs = surface_gains(pictures, depths, settings.window)
    gains = gains * rest
    say(
        f"exposure on {pairs} views of common surfaces: "
        + ", ".join(f"{c.name} {g.mean():.3f}" for c, g in zip(cameras, gains))
    )
    write_room(room_box, replace(fitted, gains={c.name: g for c, g in zip(cameras, gains)}))
    write_primitives(primitives, furniture)
    write_png(picture, sheet(pictures, fitted, furniture, depths))
    write_npz(passes, {f"depth_{camera.name}": depth_m for camera, depth_m in zip(cameras, depths)})


def _least_voters(pictures: list[Picture]) -> int:
    """A plane needs this many pixels: 40 at 320×176, the size the value was measured at."""
    return max(8, round(40 * pictures[0].rgb.shape[0] * pictures[0].rgb.shape[1] / (320 * 176)))
