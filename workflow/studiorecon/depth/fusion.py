# SPDX-License-Identifier: Apache-2.0
"""One camera's surfaces labelled again with a network's depth as one term of the cost of every pixel.

The labels are the planes, the furniture in front of them, and the network's own surface. Every label pays for its
misfit to the network, in proportion to the network's certainty in this scene. The network's own surface pays more than
a wall, so it is chosen where planes and furniture explain nothing, and loses where photos contradict it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.depth.learned import Calibration, LearnedDepth, Output, calibrate
from studiorecon.depth.stereo.free_space import MAX_COST
from studiorecon.depth.stereo.passes import OUTSIDE, PassSettings, PlaneCosts, PlaneLabelling, choose_surfaces
from studiorecon.depth.stereo.plates import Picture
from studiorecon.errors import UserError
from studiorecon.images.sizes import resample_nearest
from studiorecon.progress import say, warn
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

# Cost of one nat of misfit: photos' pixels are correlated over their window, a network's over a tenth of the picture.
_NAT = 0.15
# Cost of the network's own surface above a wall's, and its further cost per factor e of uncertainty above 2 %.
_NETWORK_EXTRA, _USUAL_SIGMA = 0.2, 0.02
# Standard deviation of log depth beyond which a network is wrong about a camera altogether.
_WORST_SIGMA = 0.1


@dataclass(frozen=True)
class Surface:
    """Any surface in one picture: depth (H, W; 0 = none), its cost by photos, and where another camera judged it."""

    depth_m: Float[np.ndarray, "H W"]
    cost: Float[np.ndarray, "H W"]
    judged: Bool[np.ndarray, "H W"]


def calibrated_network(
    estimate: Float[np.ndarray, "H W"],
    picture: Picture,
    labelled: PlaneLabelling,
    furniture: Surface,
    room_box: RoomBox,
    output: Output,
) -> tuple[Calibration, LearnedDepth]:
    """A network's depth of one camera, calibrated to the surfaces estimated so far.

    Surfaces that another camera confirms count, and fitted faces of the room; objects before those are outliers. Raises
    UserError where nothing determines its unit.
    """
    in_view = (furniture.depth_m > 0) & (furniture.depth_m < labelled.depth_m)
    on_face = np.concatenate([room_box.fitted, np.zeros(max(int(labelled.plane.max()) - 5, 0), bool)])[labelled.plane]
    confirmed = np.where(
        in_view, furniture.judged & (furniture.cost < MAX_COST), labelled.judged & (labelled.cost < MAX_COST)
    )
    found = calibrate(
        resample_nearest(estimate, picture.camera.hw),
        np.where(in_view, furniture.depth_m, labelled.depth_m),
        confirmed,
        room_box.intersect(*picture.camera.rays())[0],
        on_face & ~in_view,
        picture.rgb,
        output,
    )
    name = picture.camera.name
    if found is None:
        raise UserError(
            f"nothing says how many metres a unit of the network's depth of camera {name} is: no surface there is "
            "measured by stereo too; set depth.source to embedded, or bring metric depth maps (depth/ in the dataset)"
        )
    sigma, missed = float(np.median(found[1].sigma)), found[1].outliers
    say(f"{name}: the network's depth is ±{sigma:.1%} off the measured room and misses {missed:.0%} of its objects")
    if sigma > _WORST_SIGMA:
        warn(f"{name}: the network's depth contradicts what stereo measured, so it counts for little in this camera")
    return found


def label_with_network(
    picture: Picture,
    planes: PlaneCosts,
    furniture: Surface,
    network: Surface,
    learned: LearnedDepth,
    settings: PassSettings,
) -> PlaneLabelling:
    """The labelling with L planes, furniture (label L) and the network's surface (L + 1); its ``cost`` is the
    photos'."""
    default = settings.room_box_default
    by_photos = np.where(network.judged, network.cost, default)
    # A flat window matches flat windows everywhere.
    by_photos = np.where(picture.textured(settings.refine_window), by_photos, np.maximum(by_photos, default))
    unsure = np.maximum(np.log(learned.sigma / _USUAL_SIGMA), 0)
    # Furniture costs nothing by photos: they have already decided for it against the walls.
    extra = _NETWORK_EXTRA + _NAT * (unsure - np.log(1 - learned.outliers))
    own = np.stack([np.zeros_like(by_photos), by_photos + extra], axis=-1)
    depths_m = np.concatenate([planes.depths_m, furniture.depth_m[None], network.depth_m[None]]).astype(np.float32)
    misfit = np.moveaxis(learned.misfit(depths_m), 0, -1)
    there = np.moveaxis(depths_m > 0, 0, -1)
    cost = np.concatenate([planes.cost, own], axis=-1) + _NAT * misfit
    judged = np.concatenate([planes.judged, furniture.judged[..., None], network.judged[..., None]], axis=-1)
    every = PlaneCosts(depths_m, np.where(there, cost, OUTSIDE).astype(np.float32), judged)
    labelled = choose_surfaces(picture, every, settings.refine_penalty)
    photos = np.concatenate([planes.cost, furniture.cost[..., None], network.cost[..., None]], axis=-1)
    by_label = np.take_along_axis(photos, labelled.plane[..., None], axis=-1)[..., 0]
    return PlaneLabelling(labelled.plane, labelled.depth_m, by_label, labelled.judged)
