# SPDX-License-Identifier: Apache-2.0
"""One camera's final depth: the room's planes evaluated again at full detail, then carried to the working size along
edges.

Writes ``depth/<camera>.exr``: Z metres, A confidence. Pixels that have the room box's depth because no other camera
could judge them have A at or below ``default_confidence``; measured ones are above it. Furniture
(``depth/primitives.json``) is drawn in front. With a network's depth (``depth.source``) planes, furniture and network
compete for every pixel (``fusion``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration.setting import setting
from studiorecon.depth.estimates import read_camera_estimate
from studiorecon.depth.fusion import Surface, calibrated_network, label_with_network
from studiorecon.depth.layout.primitives import Primitive, depth_with_primitives, read_primitives
from studiorecon.depth.learned import Output
from studiorecon.depth.stereo.free_space import snap_to_room_box
from studiorecon.depth.stereo.kernels import FIRST
from studiorecon.depth.stereo.passes import (
    PassSettings,
    PlaneCosts,
    PlaneLabelling,
    choose_surfaces,
    plane_costs,
    plane_depths,
    plane_scores,
)
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume
from studiorecon.depth.stereo.plates import Picture, equalise_exposure, read_pictures
from studiorecon.depth.sweep_settings import DefaultConfidence
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.stills import read_plate
from studiorecon.images.sizes import resample_nearest
from studiorecon.images.warp import sample
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox, read_room
from studiorecon.scene.schema import metres
from studiorecon.scene.step_files import read
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Colour difference (sum over channels) at which a neighbour's plane is half as likely, when planes are carried to full
# size.
_EDGE_CONTRAST = 0.15


@dataclass(frozen=True)
class Settings(PassSettings, DefaultConfidence):
    """The size of the final pass."""

    refine_width: int = setting(
        320,
        "Picture width of the last evaluation of chosen planes, at most the working width.",
        minimum=32,
        maximum=4096,
    )
    output: Output = setting(
        "auto",
        "Numbers of the depth network: metric (metres up to a scale), affine (depth up to scale and shift) or inverse "
        "(inverse depth up to scale and shift); auto = what fits the room better.",
    )


def depth_confidence(
    labelled: PlaneLabelling, fitted: Bool[np.ndarray, " 6"], default_confidence: float
) -> Float[np.ndarray, "H W"]:
    """Float32: 1 for a perfect match down to ``default_confidence`` for none; half of it where the depth is a default.

    A default is a pixel that no other camera can judge, and every pixel on a face of the room box that was not
    ``fitted``: the sky of an open place looks the same from everywhere, which is no evidence for a wall.
    """
    quality = np.clip(1 - labelled.cost, 0, 1)
    measured = default_confidence + (1 - default_confidence) * np.maximum(quality, 1 / 255)
    stated = np.concatenate([fitted, np.ones(int(labelled.plane.max(initial=0)) + 1, bool)])[labelled.plane]
    return np.where(labelled.judged & stated, measured, default_confidence / 2).astype(np.float32)


def upsample_indices(
    values: Integer[np.ndarray, "h w"], guide: Float[np.ndarray, "h w 3"], rgb: Float[np.ndarray, "H W 3"]
) -> Integer[np.ndarray, "H W"]:
    """Index into the flattened small picture: the small pixel whose plane each full-size pixel takes.

    ``guide`` are the small picture's colours. The plane with the most weight among the 3×3 nearest small pixels wins;
    weight falls with distance and colour difference.
    """
    return _carry(
        np.ascontiguousarray(values, np.int64),
        guide.astype(np.float32),
        rgb.astype(np.float32),
        np.float32(_EDGE_CONTRAST),
    )


@njit(cache=True)
def _carry(values, guide, rgb, contrast):
    height, width = rgb.shape[:2]
    small_height, small_width = values.shape
    source = np.zeros((height, width), np.int64)
    weights, where = np.zeros(9), np.zeros(9, np.int64)
    for y in range(height):
        v = (y + 0.5) * small_height / height
        for x in range(width):
            u = (x + 0.5) * small_width / width
            n = 0
            for j in range(int(v) - 1, int(v) + 2):
                for i in range(int(u) - 1, int(u) + 2):
                    if j < 0 or i < 0 or j >= small_height or i >= small_width:
                        continue
                    far = (u - i - 0.5) ** 2 + (v - j - 0.5) ** 2
                    apart = 0.0
                    for c in range(3):
                        apart += abs(rgb[y, x, c] - guide[j, i, c])
                    weights[n] = np.exp(-far - apart / contrast)
                    where[n] = j * small_width + i
                    n += 1
            best, best_weight = 0, -1.0
            for a in range(n):
                total = 0.0
                for b in range(n):
                    if values.flat[where[a]] == values.flat[where[b]]:
                        total += weights[b]
                # Cost and confidence come from the winning pixel of the largest weight.
                total += 1e-6 * weights[a]
                if total > best_weight:
                    best, best_weight = a, total
            source[y, x] = where[best]
    return source


def at_full_size(
    camera: Camera,
    rgb: Float[np.ndarray, "H W 3"],
    small: Picture,
    labelled: PlaneLabelling,
    planes: Float[np.ndarray, "L 4"],
    further: Sequence[Float[np.ndarray, "H W"]] = (),
) -> tuple[Float[np.ndarray, "H W"], Integer[np.ndarray, "H W"]]:
    """Float32 depth of the carried planes, evaluated at every full-size pixel, and the source index.

    Labels after the planes are the surfaces ``further``.
    """
    source = upsample_indices(labelled.plane, small.rgb, rgb)
    chosen = labelled.plane.ravel()[source]
    depth_m = replace(small, camera=camera).plane_depths_of_pixels(planes[np.minimum(chosen, len(planes) - 1)])
    for number, surface_m in enumerate(further, len(planes)):
        depth_m = np.where(chosen == number, surface_m, depth_m)
    # A grazing plane can diverge just beyond its pixel: never further than its neighbours' depth.
    found = labelled.depth_m.ravel()[source]
    runaway = (depth_m <= 0) | (depth_m > 1.5 * found + 0.1)
    return np.where(runaway, found, depth_m).astype(np.float32), source


def costs_at_size(
    cameras: list[Camera],
    pictures: list[Picture],
    index: int,
    room_box: RoomBox,
    passes: list[Float[np.ndarray, "h w"]],
    settings: Settings,
) -> PlaneCosts:
    """Costs of all planes in one camera at this size against all others, which have the surfaces ``passes``."""
    picture = pictures[index]
    depths = plane_depths(picture, room_box.planes, room_box, settings)
    rest = [i for i in range(len(pictures)) if i != index]
    scores = [plane_scores(picture, pictures[i], room_box.planes, depths, settings) for i in rest]
    seen = [(cameras[i].resized((passes[i].shape[1], passes[i].shape[0])), passes[i]) for i in rest]
    return plane_costs(picture, room_box.planes, depths, scores, seen, settings)


def furniture_surface(
    index: int, pictures: list[Picture], room_box: RoomBox, primitives: list[Primitive], settings: Settings
) -> tuple[Surface, PhotoCostVolume]:
    """The furniture in one camera and what photos say of it, where it is in front of the room box."""
    room = PhotoCostVolume.by_room_box(pictures, room_box, settings.refine_window, settings.mean_weight, looks=False)
    if primitives:
        room.replace_all(np.array([primitive.numbers for primitive in primitives]))
    rows, columns = pictures[index].camera.hw
    depth_m, cost, judges, surface = (
        a[index, :rows, :columns] for a in (room.depth, room.cost, room.judges, room.surface)
    )
    return Surface(np.where(surface >= FIRST, depth_m, 0), cost, judges > 0), room


def draw_primitives(
    camera: Camera,
    primitives: list[Primitive],
    furniture: Surface,
    depth_m: Float[np.ndarray, "H W"],
    certain: Float[np.ndarray, "H W"],
    settings: Settings,
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """Depth, confidence and ``shown`` of one camera at full size, with the primitives in front.

    Parts of a primitive that another camera sees have the confidence of their match; the rest counts as a default.
    """
    depth_m, shown = depth_with_primitives(primitives, camera, depth_m)
    small = PlaneLabelling(np.full(furniture.depth_m.shape, 6), furniture.depth_m, furniture.cost, furniture.judged)
    stated = depth_confidence(small, np.zeros(6, bool), settings.default_confidence)
    certainty, _ = sample(stated, camera.pixel_centres() * (np.array(stated.shape[::-1]) / camera.wh), "nearest")
    return depth_m, np.where(shown, certainty, certain).astype(np.float32), shown


def run(
    settings: Settings,
    camera: str,
    model: Path,
    plates: list[Path],
    passes: Path,
    room_box: Path,
    primitives: Path,
    estimates: list[Path],
    depth: Written,
) -> None:
    """Write one camera's depth and confidence; ``estimates`` is a network's depth of it, if there is one."""
    cameras = read_model(model.parent)
    names = [c.name for c in cameras]
    if camera not in names:
        raise UserError(f"camera {camera} is not in {model}; it holds {', '.join(names)}")
    index = names.index(camera)
    room = read_room(room_box, names)
    agreed = list(read(passes, {f"depth_{name}": metres(f"H_{name} W_{name}", low=0) for name in names}).values())
    gains = np.stack([room.gains[name] for name in names])
    pictures = equalise_exposure(read_pictures(cameras, plates, settings.refine_width), gains)
    costs = costs_at_size(cameras, pictures, index, room, agreed, settings)
    others = [(c.resized(a.shape[::-1]), a) for i, (c, a) in enumerate(zip(cameras, agreed)) if i != index]
    picture, furniture = pictures[index], read_primitives(primitives)
    labelled, floating = snap_to_room_box(
        choose_surfaces(picture, costs, settings.refine_penalty), picture.camera, room, others
    )
    say(
        f"{camera}: {floating:.1%} of the pixels are confirmed by no other camera and would float; moved to walls "
        "and floor"
    )
    rgb, _ = read_plate(plates[index], cameras[index].wh)
    rgb = rgb / gains[index].astype(np.float32)
    drawn, volume = furniture_surface(index, pictures, room, furniture, settings)
    further: list[np.ndarray] = []
    for path in estimates:
        estimate = read_camera_estimate(path, cameras[index])
        calibration, learned = calibrated_network(estimate, picture, labelled, drawn, room, settings.output)
        seen_m = [resample_nearest(depth_m, p.camera.hw) for depth_m, p in zip(agreed, pictures)]
        seen_m[index] = learned.depth_m
        network = Surface(learned.depth_m, *volume.cost_of(index, seen_m))
        labelled = label_with_network(picture, costs, drawn, network, learned, settings)
        further = [
            depth_with_primitives(furniture, cameras[index], np.zeros(cameras[index].hw, np.float32))[0],
            calibration.sharp_depth(estimate, rgb),
        ]
    depth_m, source = at_full_size(cameras[index], rgb, picture, labelled, room.planes, further)
    certainty = depth_confidence(labelled, room.fitted, settings.default_confidence).ravel()[source]
    say(
        f"{camera}: {(~labelled.judged).mean():.0%} of the pixels have default depth, because no other camera sees "
        "that surface"
    )
    certainty = certainty.reshape(depth_m.shape)
    shown = labelled.plane == len(room.planes)
    if furniture and not estimates:
        depth_m, certainty, shown = draw_primitives(cameras[index], furniture, drawn, depth_m, certainty, settings)
    inside = (labelled.plane >= 6) & (labelled.plane < len(room.planes))
    say(
        f"{camera}: {shown.mean():.0%} of the pixels show boxes and cylinders, {inside.mean():.0%} "
        "other surfaces inside the room"
        + (f", {(labelled.plane > len(room.planes)).mean():.0%} the network's own" if estimates else "")
    )
    write_depth(depth, depth_m, certainty)
