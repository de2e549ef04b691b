# SPDX-License-Identifier: Apache-2.0
"""The room box around all cameras, from every sweep's votes; needs no people.

Writes ``depth/box.json`` (``scene.room.RoomBox``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from studiorecon.camera_files.colmap import read_model
from studiorecon.depth.layout import box as room
from studiorecon.depth.layout.platform import RaisedFloor, fit_platform
from studiorecon.depth.layout.unseen_walls import FLOOR_REACH_M, complete_room
from studiorecon.depth.layout.votes import Votes, read_sweeps
from studiorecon.depth.stereo.plates import Picture, equalise_exposure, read_pictures
from studiorecon.depth.sweep_settings import FirstLook, Matching
from studiorecon.progress import say
from studiorecon.scene.room import FACES, RoomBox, write_room
from studiorecon.signature import Written

_PLACING_SPAN_M, _PLACING_STEP_M = 0.08, 0.01
_VOTER_REACH_M = 0.15
# A wall whose yaw is off by some angle votes, over this length on either side, for offsets that differ by this much
# times sin(angle).
_HALF_WALL_M = 4.0
# Span and step of the search for the walls' yaw: first the error of a sweep without lines, then to a tenth of a degree.
_YAW_SEARCH_RAD = ((np.radians(2.5), np.radians(0.5)), (np.radians(0.4), np.radians(0.1)))


@dataclass(frozen=True)
class Settings(Matching, FirstLook):
    """Limits of a wall: distance outside the outermost camera, share of all pixels; height of an unseen ceiling."""

    wall_clearance_m: float = 0.3
    wall_votes: float = 0.004
    ceiling_default_m: float = 3.2


def fit_room_box(pictures: list[Picture], votes: Votes, yaw_rad: float, floor_m: float, settings: Settings) -> RoomBox:
    """The box of the most voted walls around all cameras; faces that too few pixels voted for are defaults.

    A default wall is ``far_m`` beyond the cameras until ``complete_room``, the default ceiling at
    ``ceiling_default_m`` above the floor (at least a metre above the highest camera).
    """
    how, placing = settings, (_PLACING_SPAN_M, _PLACING_STEP_M)
    count = votes.count()
    least = settings.wall_votes * sum(c.size for c in votes.chosen)
    centres = np.stack([p.camera.centre_m for p in pictures])
    start = RoomBox(yaw_rad, np.full(3, -np.inf), np.full(3, np.inf), np.zeros(6, bool), np.full(6, np.nan))

    def bare(turn: float) -> RoomBox:
        far = replace(start, yaw_rad=yaw_rad + turn)
        along = centres @ far.axes.T
        return replace(
            far, low_m=np.array([*(along.min(0) - settings.far_m)[:2], floor_m]), high_m=along.max(0) + settings.far_m
        )

    offsets = {}
    for face in (0, 1, 2, 3, 5):
        axis, side = start.axes[face // 2], 2 * (face % 2) - 1
        beyond = side * ((side * centres @ axis).max() + settings.wall_clearance_m)
        offsets[face] = room.most_voted_offsets(votes.planes, count, axis, beyond, side, least)
    walls = room.choose_faces(pictures, votes, bare(0.0), offsets, how)
    top = walls.pop(5, None)
    turn, turned = 0.0, {face: np.array([*start.axes[face // 2], offset]) for face, offset in walls.items()}
    looks = [p.textured(settings.window) & p.known for p in pictures]
    # Every pixel on a wall takes part, not only its voters: those were chosen by the yaw that is to be tested.
    for span_rad, step_rad in _YAW_SEARCH_RAD:
        box = bare(turn).with_faces({face: plane[3] for face, plane in turned.items()})
        faces = [box.intersect(*p.camera.rays())[1] for p in pictures]
        pixels = {face: [m & (at == face) for m, at in zip(looks, faces)] for face in turned}
        turn += room.refine_yaw(pictures, [(turned[face], pixels[face]) for face in turned], span_rad, step_rad, how)
        # A wall turns about its visible part: about the world's origin, which may be far away, it would move.
        for face, normal in ((face, replace(start, yaw_rad=yaw_rad + turn).axes[face // 2]) for face in turned):
            offset = room.offset_of_turned_plane(pictures, pixels[face], turned[face], normal, how)
            turned[face] = np.array([*normal, offset])
    axes = replace(start, yaw_rad=yaw_rad + turn).axes
    low, high, fitted, score = np.zeros(3), np.zeros(3), np.zeros(6, bool), np.full(6, np.nan)
    for face in range(4):
        axis, side = face // 2, 2 * (face % 2) - 1
        offset = side * ((side * centres @ axes[axis]).max() + settings.far_m)
        if face in walls:
            reach_m = _VOTER_REACH_M + _HALF_WALL_M * abs(np.sin(turn))
            voters = votes.voters(start.axes[axis], walls[face], reach_m)
            plane = np.array([*start.axes[axis], walls[face]])
            begin = room.offset_of_turned_plane(pictures, voters, plane, axes[axis], how)
            offset, score[face] = room.place_plane(pictures, voters, axes[axis], begin, *placing, how)
            fitted[face] = True
        (low, high)[face % 2][axis] = offset
    voters = votes.voters(axes[2], floor_m, FLOOR_REACH_M)
    low[2], score[4] = room.place_plane(pictures, voters, axes[2], floor_m, 0.05, _PLACING_STEP_M, how)
    fitted[4] = sum(int(v.sum()) for v in voters) >= least
    high[2] = max(low[2] + settings.ceiling_default_m, centres[:, 2].max() + 1.0)
    if top is not None:
        voters = votes.voters(axes[2], top, _VOTER_REACH_M)
        high[2], score[5] = room.place_plane(pictures, voters, axes[2], top, *placing, how)
        fitted[5] = True
    # A face with too few voters to score it is a default, and a default has no score.
    fitted &= np.isfinite(score)
    return RoomBox(yaw_rad + turn, low, high, fitted, np.where(fitted, score, np.nan))


def run(settings: Settings, model: Path, plates: list[Path], sweeps: list[Path], box: Written) -> None:
    """Fit the room box to all sweeps."""
    cameras = read_model(model.parent)
    swept = read_sweeps(sweeps, len(cameras))
    pictures = equalise_exposure(read_pictures(cameras, plates, settings.sweep_width), swept.gains)
    fitted = fit_room_box(pictures, swept.votes, swept.yaw_rad, swept.floor_m, settings)
    raised = fit_platform(pictures, fitted.axes, float(fitted.low_m[2]), settings)
    if raised is not None:
        fitted = _on_lower_floor(fitted, raised, pictures, settings)
    fitted, _ = complete_room(fitted, pictures, cameras, plates, swept, np.zeros((0, 2)), settings.far_m)
    for name, face, is_fitted, score in zip(FACES, fitted.faces, fitted.fitted, fitted.score):
        say(f"{name} at {face[3]:.3f} m (correlation {score:.2f})" if is_fitted else f"{name}: no photos match there")
    write_room(box, replace(fitted, gains={c.name: g for c, g in zip(cameras, swept.gains)}))


def _on_lower_floor(box: RoomBox, raised: RaisedFloor, pictures: list[Picture], settings: Settings) -> RoomBox:
    """The box with its floor at the level around the people's platform."""
    size_m = raised.platform.high_m - raised.platform.low_m
    say(
        f"people stand {raised.platform.top_m - raised.floor_m:.2f} m above the floor, on a platform of "
        f"{size_m[0]:.1f} × {size_m[1]:.1f} m: around it the photos match a lower floor"
    )
    fitted, score = box.fitted.copy(), box.score.copy()
    fitted[4], score[4] = True, raised.score
    low_m, high_m = np.array([*box.low_m[:2], raised.floor_m]), box.high_m.copy()
    if not fitted[5]:
        highest_m = max(float(p.camera.centre_m[2]) for p in pictures)
        high_m[2] = max(raised.floor_m + settings.ceiling_default_m, highest_m + 1.0)
    return replace(box, low_m=low_m, high_m=high_m, fitted=fitted, score=score, platform=raised.platform)
