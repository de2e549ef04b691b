# SPDX-License-Identifier: Apache-2.0
"""``placement.place``: camera positions for a room before filming, what they will see, and one picture of the plan."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.placement.camera_placement import lens_from_fov, place_cameras
from studiorecon.placement.picture import camera_position_text, draw_plan, figure_lines
from studiorecon.placement.rig_quality import RigEvaluator
from studiorecon.placement.room import read_room
from studiorecon.progress import say
from studiorecon.scene.files import atomic_path, write_json

_MAX = 32


def read_resolution(text: str) -> tuple[int, int]:
    """``1920x1080`` → width and height; raises UserError for anything else."""
    found = re.fullmatch(r"(\d+)[x×](\d+)", text.strip().lower())
    wh = (int(found[1]), int(found[2])) if found else (0, 0)
    if min(wh) < 32 or max(wh) > 32768:
        raise UserError(f"the resolution is {text!r}; write WIDTHxHEIGHT in pixels, 1920x1080")
    return wh


def run(room: str, cameras: int, hfov_deg: list[float], resolution: str, picture: Path, plan: Path) -> None:
    """Write a plan and its picture for lenses in a room, with one horizontal field of view for all cameras or each.

    The sides of ``resolution`` are those of upright pictures, so phones held upright use 1080x1920 with the field of
    view across their short side.
    """
    box, wh = read_room(room), read_resolution(resolution)
    if not 2 <= cameras <= _MAX:
        raise UserError(f"{cameras} cameras were requested; plan for 2 to {_MAX}: one camera cannot measure distance")
    if len(hfov_deg) not in (1, cameras) or not all(5 <= angle <= 150 for angle in hfov_deg):
        raise UserError(
            f"the fields of view are {hfov_deg}; give one for all or one for each of "
            f"{cameras} cameras, 5 to 150 degrees"
        )
    angles = hfov_deg * cameras if len(hfov_deg) == 1 else hfov_deg
    lenses = [lens_from_fov(f"cam{k + 1}", angle, wh) for k, angle in enumerate(angles)]
    found, evaluator = place_cameras(box, lenses), RigEvaluator(box)
    figures = evaluator.figures(found)
    degrees = " and ".join(f"{angle:g}°" for angle in dict.fromkeys(angles))
    title = f"{cameras} cameras of {degrees} ({wh[0]} × {wh[1]}) in {' × '.join(f'{side:g}' for side in box.size_m)} m"
    with atomic_path(picture) as partial:
        partial.write_text(draw_plan(title, found, evaluator, figures), encoding="utf-8")
    write_json(
        plan,
        {
            "room_m": box.size_m.tolist(),
            "cameras": [c.as_json() for c in found],
            "figures": dataclasses.asdict(figures),
        },
    )
    for line in (title, *(camera_position_text(camera, box) for camera in found), *figure_lines(figures)):
        say(line)
    say(f"the picture is {picture}")
