# SPDX-License-Identifier: Apache-2.0
"""One camera's surfaces with a network's depth as one term of the cost of every pixel.

Three surfaces compete: the room box, the furniture in front of it, and the network's own. Each pays for its misfit to
the network, in proportion to the network's certainty in this scene. The network's own surface pays more than a wall, so
it is chosen where box and furniture explain nothing, and loses where photos contradict it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.depth.learned import Calibration, LearnedDepth, Output, calibrate
from studiorecon.depth.stereo.labelling import label_planes
from studiorecon.depth.stereo.photo_cost import Surface
from studiorecon.depth.stereo.plates import Picture
from studiorecon.errors import UserError
from studiorecon.images.sizes import resample_nearest
from studiorecon.progress import say, warn

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Cost of a surface that a pixel's ray does not meet: more than any other's.
_NOT_MET = 2.5
# Cost of one nat of misfit: photos' pixels are correlated over their window, a network's over a tenth of the picture.
_NAT = 0.15
# Cost of the network's own surface above a wall's, and its further cost per factor e of uncertainty above 2 %.
_NETWORK_EXTRA, _USUAL_SIGMA = 0.2, 0.02
# Standard deviation of log depth beyond which a network is wrong about a camera altogether.
_WORST_SIGMA = 0.1


@dataclass(frozen=True)
class NetworkTerm:
    """How surfaces compete with a network's.

    Attributes:
        output: see ``Output``.
        refine_penalty: cost of a change of surface between neighbouring pixels.
        unjudged_cost: cost of floor and walls where no other camera judges them.
    """

    output: Output = setting(
        "auto",
        "Numbers of the depth network: metric (metres up to a scale), affine (depth up to scale and shift) or inverse "
        "(inverse depth up to scale and shift); auto = what fits the room better.",
    )
    refine_penalty: float = 0.8
    unjudged_cost: float = 0.3


def calibrate_network(
    estimate: Float[np.ndarray, "H W"],
    picture: Picture,
    box: Surface,
    furniture: Surface,
    fitted: Bool[np.ndarray, "H W"],
    output: Output,
) -> tuple[Calibration, LearnedDepth]:
    """A network's depth of one camera, calibrated to the room; raises UserError where nothing determines its unit.

    What counts is what another camera confirms, and the ``fitted`` faces of the room also where none does: objects
    before them are outliers of the fit.
    """
    in_view = furniture.depth_m > 0
    confirmed = np.where(in_view, furniture.confirmed, box.confirmed)
    found = calibrate(
        resample_nearest(estimate, picture.camera.hw),
        np.where(in_view, furniture.depth_m, box.depth_m),
        confirmed,
        box.depth_m,
        fitted & ~in_view,
        picture.rgb,
        output,
    )
    name = picture.camera.name
    if found is None:
        raise UserError(
            f"the scale of the network's depth is unknown in camera {name}, because stereo measures no surface there; "
            "set depth.source to embedded, or bring metric depth maps (depth/ in the dataset)"
        )
    sigma, missed = float(np.median(found[1].sigma)), found[1].outliers
    say(f"{name}: the network's depth is ±{sigma:.1%} off the measured room and misses {missed:.0%} of its objects")
    if sigma > _WORST_SIGMA:
        warn(f"{name}: the network's depth contradicts what stereo measured, so it counts for little in this camera")
    return found


def label_with_network(
    picture: Picture,
    box: Surface,
    furniture: Surface,
    network: Surface,
    learned: LearnedDepth,
    textured: Bool[np.ndarray, "H W"],
    settings: NetworkTerm,
) -> Integer[np.ndarray, "H W"]:
    """(H, W) the surface of least cost at every pixel: 0 room box, 1 furniture, 2 network; smooth except at edges."""

    def by_photos(surface: Surface) -> np.ndarray:
        cost = np.where(surface.compared, surface.cost, settings.unjudged_cost)
        # A flat window matches flat windows everywhere: that is worth no more than no judgement.
        return np.where(textured, cost, np.maximum(cost, settings.unjudged_cost))

    unsure = np.maximum(np.log(learned.sigma / _USUAL_SIGMA), 0)
    extra = _NETWORK_EXTRA + _NAT * (unsure - np.log(1 - learned.outliers))
    # Furniture costs nothing by photos: they have already decided for it against the walls.
    photos = np.stack([by_photos(box), np.zeros_like(box.cost), by_photos(network) + extra])
    depths_m = np.stack([box.depth_m, furniture.depth_m, network.depth_m]).astype(np.float32)
    cost = np.where(depths_m > 0, photos + _NAT * learned.misfit(depths_m), _NOT_MET)
    return label_planes(np.moveaxis(cost, 0, -1), picture.rgb, settings.refine_penalty)
