# SPDX-License-Identifier: Apache-2.0
"""The player's data of a scene: packed Gaussians, motion, cameras, films, and notes on omitted parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.deliver.finished import FinishedScene
from studiorecon.deliver.packing import Bytes, morton_order
from studiorecon.deliver.player_motion import (
    motion_times,
    pack_colour_changes,
    pack_rigid_motion,
    pack_skeleton,
    pack_skin,
)
from studiorecon.geometry import rotations
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import Factors
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.path import PathStep
from studiorecon.scene.schema import ASCENDING, Schema, real, whole
from studiorecon.scene.step_files import read
from studiorecon.splatting.conventions import ALPHA_LOG2_MIN, ALPHA_MAX, DILATION_PX2, FRAME_MARGIN
from studiorecon.splatting.device import DRAWN_FROM_M

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Most bytes of all motion, of colours over time and of shades: beyond them, fewer moments are stored.
MOTION_BYTES, CHANGES_BYTES, SHADE_BYTES = 3_000_000, 1_500_000, 3_000_000
# Brightness of a shaded Gaussian, as a multiple of its own.
_SHADE_MAX = 1.5


@dataclass(frozen=True)
class Shade:
    """Shadows of people as factors on the light: indices of the room's Gaussians, moments, factors."""

    at: Integer[np.ndarray, " M"]
    times: Num[np.ndarray, " K"]
    factors: Float[np.ndarray, "K M"]


def describe_scene(
    scene: FinishedScene, held: Bytes, exposure: Factors, shade: Shade | None = None
) -> tuple[dict[str, Any], list[str]]:
    """The page's description of the scene, with bytes in ``held``, and sentences on omitted or simplified parts."""
    described: list[str] = []
    frames = scene.capture.frames
    bodies = max(len(scene.people) + len(scene.things), 1)
    joints = max((len(person.model.parents) for person in scene.people), default=24)
    times = motion_times(frames, max(2, MOTION_BYTES // (bodies * (8 * joints + 12))))
    if len(times) < frames and (scene.people or scene.things):
        described.append(
            f"motion is sampled at {len(times)} moments of {frames} frames, between which it is continued "
            f"({(frames - 1) / (len(times) - 1):.1f} frames)"
        )
    room, order = pack_gaussians(held, scene.room, scene.provenance)
    sets = [{"name": "room", "kind": "room", **room}]
    if shade is not None and len(shade.at):
        sets[0]["shade"] = pack_shades(held, shade, order, described)
    for person in scene.people:
        own, order = pack_gaussians(held, person.gaussians, person.provenance)
        own |= {"motion": pack_skeleton(held, person, times)} | pack_skin(
            held, person.bones[order], person.weights[order]
        )
        if person.network is not None:
            places = len(person.network.control.points_m) if person.network.control else 512
            few = motion_times(frames, max(2, CHANGES_BYTES // max(len(scene.people), 1) // (8 * places)))
            own["changes"], off = pack_colour_changes(held, person, order, few)
            described.append(
                f"colours of {person.person} that change over time are sampled at {len(few)} moments and {places} "
                f"places, within {100 * off:.1f} %"
            )
        sets.append({"name": person.person, "kind": "person", **own})
    for thing in scene.things:
        own, order = pack_gaussians(held, thing.gaussians, thing.provenance)
        single = np.zeros((thing.gaussians.count, 1), np.uint8), np.ones((thing.gaussians.count, 1))
        own |= {"motion": pack_rigid_motion(held, thing, times)} | pack_skin(held, *single)
        sets.append({"name": thing.person, "kind": "thing", **own})
    return {
        "scene": scene.name,
        "frames": frames,
        "fps": scene.capture.fps,
        "moments": len(times),
        "sets": sets,
        "cameras": [camera_json(camera, held, exposure) for camera in scene.cameras],
        "films": [
            {"name": name, "steps": held.floats(film_rows(steps))} for name, steps in scene.paths.items() if steps
        ],
        "centre": scene_centre(scene.cameras).tolist(),
        "drawing": {
            "near": DRAWN_FROM_M,
            "dilation": float(DILATION_PX2),
            "faintest": float(ALPHA_LOG2_MIN),
            "strongest": float(ALPHA_MAX),
            "margin": float(FRAME_MARGIN),
        },
    }, described


def pack_gaussians(
    held: Bytes, own: Gaussians, provenance: Integer[np.ndarray, " N"]
) -> tuple[dict[str, Any], Integer[np.ndarray, " N"]]:
    """The description of the packed Gaussians, and their new order."""
    order = morton_order(own.means_m)
    own = own.take(order)
    found = {
        "count": own.count,
        "degree": own.sh_degree,
        "means": held.levels(own.means_m, 24),
        "quaternions": held.quaternions(own.quaternions),
        "scales": held.levels(own.log_scales, 16),
        "opacities": held.levels(own.opacities, 16, 0.0, 1.0),
        "colours": held.levels(own.sh[:, 0], 16),
        "provenance": held.whole(np.asarray(provenance)[order], 8),
        "reach": 0.0,
    }
    if own.sh_degree:
        reach = float(np.abs(own.sh[:, 1:]).max(initial=1e-6))
        rest = own.sh[:, 1:].reshape(own.count, (own.sh.shape[1] - 1) * 3)
        # The page's shader maps them to the range from -reach to reach.
        found |= {"harmonics": held.whole(np.rint((rest / reach + 1) * 127.5), 8), "reach": reach}
    return found, order


def pack_shades(held: Bytes, shade: Shade, order: Integer[np.ndarray, " N"], described: list[str]) -> dict[str, Any]:
    """The room's shade over time, for the Gaussians that are ever shaded."""
    some = (np.abs(shade.factors - 1) > 0.5 * _SHADE_MAX / 255).any(axis=0)
    place = np.argsort(order, kind="stable")[shade.at[some]]
    sorting = np.argsort(place, kind="stable")
    kept = motion_times(len(shade.times), max(2, SHADE_BYTES // max(len(place), 1))).round().astype(int)
    if len(kept) < len(shade.times):
        described.append(f"shadows are sampled at {len(kept)} of {len(shade.times)} moments")
    factors = shade.factors[kept][:, some][:, sorting]
    return {
        "at": held.whole(place[sorting], 24),
        "times": shade.times[kept].tolist(),
        "factors": held.levels(factors.reshape(-1, 1), 8, 0.0, _SHADE_MAX),
    }


def camera_json(camera: Camera, held: Bytes, exposure: Factors) -> dict[str, Any]:
    """A camera, with the brightness of its pictures relative to the scene: one factor, or one per frame."""
    found = camera.as_json()
    found = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in found.items()}
    return found | (
        {"exposure": held.floats(exposure.by_camera[camera.name])} if camera.name in exposure.by_camera else {}
    )


def film_rows(steps: Sequence[PathStep]) -> Float[np.ndarray, "P 14"]:
    """Per picture: size, focal lengths, principal point, rotation (w, x, y, z) and centre of its camera, frame."""
    turns = rotations.to_quaternion(np.stack([step.camera.world_from_camera[:3, :3] for step in steps]))
    rows = [
        [*step.camera.wh, *step.camera.focal_px, *step.camera.principal_px, *turn, *step.camera.centre_m, step.frame]
        for step, turn in zip(steps, turns)
    ]
    return np.array(rows)


def read_shade(path: Path, count: int) -> Shade:
    """The shade in ``render/room.shade.npz`` of ``count`` Gaussians; raises UserError as ``step_files.read`` does."""
    schema: Schema = {
        "at": whole("M", low=0, high=count - 1),
        "times": whole("K", low=0, such=ASCENDING),
        "factors": real("K M", low=0),
    }
    return read(path, schema, lambda arrays: Shade(arrays["at"], arrays["times"], arrays["factors"]))
