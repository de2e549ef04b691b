# SPDX-License-Identifier: Apache-2.0
"""The furniture in the room, and the exposure of every camera on all surfaces.

Writes ``depth/room.json`` (``scene.room.RoomBox``) and ``depth/primitives.json``
(``depth.layout.primitives.Primitive``) with a picture of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.depth.layout.primitive_fitting import fit_primitives
from studiorecon.depth.layout.primitives import Primitive, depth_with_primitives, write_primitives
from studiorecon.depth.layout.primitives_picture import overview_sheet
from studiorecon.depth.layout.unseen_walls import complete_room
from studiorecon.depth.layout.visibility import joint_places
from studiorecon.depth.layout.votes import read_sweeps
from studiorecon.depth.stereo.plates import equalise_exposure, read_pictures, surface_gains
from studiorecon.depth.sweep_settings import Comparison, FirstLook
from studiorecon.images.encoded import write_png
from studiorecon.progress import say
from studiorecon.scene.room import FACES, read_room, write_room
from studiorecon.signature import Written


@dataclass(frozen=True)
class Settings(Comparison, FirstLook):
    """Size in pixels of the pictures for the furniture's fit, and the least gain of a primitive."""

    primitives: int = setting(
        40,
        "Maximum number of boxes in the room; 0 = none.",
        minimum=0,
        maximum=1000,
        paper="none; network depth",
        paper_value=0,
    )
    primitives_width: int = 160
    primitives_gain: float = 40.0


def run(
    settings: Settings,
    model: Path,
    plates: list[Path],
    sweeps: list[Path],
    box: Path,
    fits: list[Path],
    room_box: Written,
    primitives: Written,
    picture: Written,
) -> None:
    """Fit furniture in the room ``box``, and make the cameras' exposures agree.

    ``fits`` are bodies of people, whose paths furniture may not block, and behind whom unseen walls are.
    """
    cameras = read_model(model.parent)
    free_m = joint_places([read_person(path) for path in fits])
    swept = read_sweeps(sweeps, len(cameras))
    pictures = equalise_exposure(read_pictures(cameras, plates, settings.sweep_width), swept.gains)
    fitted, interval_m = complete_room(read_room(box), pictures, cameras, plates, swept, free_m[:, :2], settings.far_m)
    for name, (low_m, high_m), face, known in zip(FACES, interval_m, fitted.faces, fitted.fitted):
        if not known:
            say(
                f"{name}: a default at {face[3]:.1f} m ({low_m:.1f} to {high_m:.1f} m by upright edges, visible floor, "
                "people and usual rooms)"
            )
    furniture: list[Primitive] = []
    if settings.primitives and len(cameras) > 1:
        small = equalise_exposure(read_pictures(cameras, plates, settings.primitives_width), swept.gains)
        say(f"{len(free_m)} places of {len(fits)} people are kept free of furniture")
        furniture = fit_primitives(
            small,
            fitted,
            free_m,
            window=settings.refine_window,
            mean_weight=settings.mean_weight,
            least_gain=settings.primitives_gain,
            most=settings.primitives,
        )
        say(f"{len(furniture)} boxes added to walls and floor")
    boxes_m = [fitted.intersect(*p.camera.rays())[0].astype(np.float32) for p in pictures]
    depths = [depth_with_primitives(furniture, p.camera, depth_m)[0] for p, depth_m in zip(pictures, boxes_m)]
    rest, pairs = surface_gains(pictures, depths, settings.window)
    gains = swept.gains * rest
    say(
        f"exposure on {pairs} views of common surfaces: "
        + ", ".join(f"{c.name} {g.mean():.3f}" for c, g in zip(cameras, gains))
    )
    write_room(room_box, replace(fitted, gains={c.name: g for c, g in zip(cameras, gains)}))
    write_primitives(primitives, furniture)
    write_png(picture, overview_sheet(pictures, fitted, furniture, depths))
