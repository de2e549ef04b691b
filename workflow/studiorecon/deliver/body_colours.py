# SPDX-License-Identifier: Apache-2.0
"""The colours of a body's surface, from the Gaussians that were trained on it, for programs that draw meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.scene.gaussians import SH_C0

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# A surface is several Gaussians deep: clothes, and sometimes a wrong Gaussian of the wall behind, which this many
# outvote.
_NEAREST = 8
# Weight of an invisible Gaussian, so that vertices with only faint ones get their colour too.
_MIN_WEIGHT = 1e-3


@dataclass(frozen=True)
class BodyColours:
    """Displayed colours in [0, 1] of the body model's vertices, and the nearest Gaussian's provenance."""

    rgb: Float[np.ndarray, "V 3"]
    provenance: Integer[np.ndarray, " V"]


def body_colours(avatar: Avatar) -> BodyColours | None:
    """The colour at each vertex from the nearest Gaussians in the rest pose, weighted by opacity.

    It is the same from all sides and at all times. None for a person without Gaussians.
    """
    own = avatar.gaussians
    if not own.count:
        return None
    vertices_m = avatar.model.rest_vertices(avatar.betas)
    _, near = scipy.spatial.KDTree(own.means_m).query(vertices_m, min(_NEAREST, own.count))
    near = near.reshape(len(vertices_m), -1)
    shares = np.maximum(scipy.special.expit(own.logit_opacities.astype(np.float64)), _MIN_WEIGHT)[near]
    shares /= shares.sum(axis=1, keepdims=True)
    rgb = 0.5 + SH_C0 * own.sh[:, 0].astype(np.float64)
    blended = np.einsum("vk,vkc->vc", shares, rgb[near])
    return BodyColours(np.clip(blended, 0, 1), np.asarray(avatar.provenance, np.uint8)[near[:, 0]])
