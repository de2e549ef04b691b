# SPDX-License-Identifier: Apache-2.0
"""``placement.advise``: coverage of the cameras of a finished calibration, and which to move where."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.placement.camera_placement import advise_moves
from studiorecon.placement.picture import advice_line, camera_position_text, draw_plan, figure_lines
from studiorecon.placement.rig_quality import RigEvaluator
from studiorecon.placement.room import room_about
from studiorecon.progress import say
from studiorecon.scene.files import atomic_path, write_json
from studiorecon.signature import Written


def run(model: Path, picture: Written, plan: Written) -> None:
    """Write the advice and its picture for ``model``, a ``cameras/images.txt``; the room is a box around them."""
    cameras = read_model(model.parent)
    if len(cameras) < 2:
        raise UserError(f"{model} has {len(cameras)} camera, which cannot measure distance: no advice is possible")
    room = room_about(cameras)
    evaluator = RigEvaluator(room)
    figures, moves = evaluator.figures(cameras), advise_moves(cameras, room)
    title = f"{len(cameras)} cameras in a room of about {' × '.join(f'{side:.1f}' for side in room.size_m)} m"
    with atomic_path(picture) as partial:
        partial.write_text(draw_plan(title, cameras, evaluator, figures, moves), encoding="utf-8")
    described = [{"camera": m.camera, "words": m.words, "gain": m.gain, "better": m.better.as_json()} for m in moves]
    write_json(plan, {"room_m": [room.low_m, room.high_m], "figures": dataclasses.asdict(figures), "advice": described})
    placed = (camera_position_text(camera, room) for camera in cameras)
    for line in (title, *placed, *figure_lines(figures), *(advice_line(move) for move in moves)):
        say(line)
    if not moves:
        say("no camera would see 3 % better from within 1.5 m of its place")
    say(f"the picture is {picture}")
