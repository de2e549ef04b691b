# SPDX-License-Identifier: Apache-2.0
"""A person before training: Gaussians on the surface of the body in its rest pose, coloured by the photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.weight_grid import WeightGrid, all_bone_weights, build_weight_grid, strongest_weights
from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel
from studiorecon.humans.colours import add_evidence, nearest_surface
from studiorecon.humans.crops import Crop
from studiorecon.humans.refined_motion import FIXED_JOINTS, RefinedMotion
from studiorecon.humans.surface_samples import (
    SurfaceSamples,
    fill_unseen,
    gaussians_on,
    initial_samples,
    mirror_indices,
    surface_neighbours,
)
from studiorecon.humans.train_settings import Settings
from studiorecon.progress import say
from studiorecon.scene.gaussians import Gaussians, sh_from_rgb
from studiorecon.scene.people import Person
from studiorecon.splatting.cpu.harmonics import degree_supported

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

NEIGHBOURS = 8
"""Surface neighbours that an unseen Gaussian takes its colour from."""
# Number of pictures for initial colours: enough to see every side of a turning person, few enough to take a second.
_LOOKS = 160
# A Gaussian is measured when its weight in all crops exceeds that of one frontal crop at 20 focal lengths per metre.
_SEEN_WEIGHT = 20.0


def skinning_weights(
    samples: SurfaceSamples,
    vertices_m: Float[np.ndarray, "V 3"],
    weights: Float[np.ndarray, "V J"],
    settings: Settings,
) -> tuple[Integer[np.ndarray, "N K"], Float[np.ndarray, "N K"], WeightGrid | None]:
    """Joints, weights, and the grid: the surface's four strongest joints, or all of the paper's voxel grid.

    The grid mixes parts nearer than a voxel (3 cm at 64³), such as fingers and thighs (L06); the surface does not.
    """
    if settings.skinning == "surface":
        return *strongest_weights(samples.weights), None
    grid = build_weight_grid(vertices_m, weights, settings.grid_resolution, settings.grid_margin)
    return *all_bone_weights(grid, samples.points_m), grid


def initial_colours(
    samples: SurfaceSamples, posing: Posing, motion: RefinedMotion, crops: Sequence[Crop]
) -> tuple[Float[np.ndarray, "N 3"], Bool[np.ndarray, " N"]]:
    """Colours float64 and ``seen`` (N,) bool from up to 160 crops spread over the clip; unseen rows are grey."""
    sums, weights = np.zeros_like(samples.points_m), np.zeros(len(samples.points_m))
    chosen = spread_indices(len(crops), _LOOKS, below=True)
    points = samples.points_m.astype(np.float32)
    nothing = np.zeros((len(points), 1, 3), np.float32)
    unturned = np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1))
    for crop in (crops[i] for i in chosen):
        means, _, _ = posing.out(points, unturned, nothing, motion.transforms(crop.frame))
        normals = np.einsum("nab,nb->na", posing.turn, samples.normals)
        pixels, depth_m = crop.camera.project(means.astype(np.float64))
        # A disc covers about its spacing; the nearest surface has to close over the gaps between the points.
        reach = int(np.ceil(samples.spacing_m * np.mean(crop.camera.focal_px) / max(float(np.median(depth_m)), 0.1)))
        add_evidence(
            crop,
            means.astype(np.float64),
            normals,
            nearest_surface(pixels, depth_m, crop.camera.hw, reach),
            sums,
            weights,
        )
    seen = weights > _SEEN_WEIGHT
    return np.where(seen[:, None], sums / np.maximum(weights, 1e-12)[:, None], 0.5), seen


def supported_degree(settings: Settings, motion: RefinedMotion, crops: Sequence[Crop]) -> int:
    """``sh_degree``, or at most the degree that the turning body's viewing directions support (G15)."""
    looks = [motion.local[c.frame, 0].T @ (c.camera.centre_m - motion.trans_m[c.frame]) for c in crops]
    return (
        min(settings.sh_degree, degree_supported(np.array(looks))) if settings.limit_sh_to_views else settings.sh_degree
    )


@dataclass(frozen=True)
class RestPose:
    """A person before training: Gaussians on the surface of the body in its rest pose, and their motion.

    Attributes:
        vertices_m: the body's surface at rest.
        samples: positions of the Gaussians on it.
        posing, motion, grid: skinning, fitted motion, and the paper's voxel grid of weights (None: the surface's own).
        start: the Gaussians, coloured by the photos.
        seen: a camera saw the Gaussian.
    """

    vertices_m: Float[np.ndarray, "V 3"]
    samples: SurfaceSamples
    posing: Posing
    motion: RefinedMotion
    grid: WeightGrid | None
    start: Gaussians
    seen: Bool[np.ndarray, " N"]


def build_rest_pose(
    settings: Settings,
    person: str,
    fitted: Person,
    body_model: BodyModel,
    crops: Sequence[Crop],
    rng: np.random.Generator,
) -> RestPose:
    """The person's Gaussians before the first step of training."""
    body_model, poses = posed_skeleton(fitted, body_model)
    rest_m = body_model.rest_vertices(fitted.betas)
    outside = np.array([name != "inside" for name in body_model.region_names])
    faces = body_model.faces[outside[body_model.region[body_model.faces[:, 0]]]]
    samples = initial_samples(rest_m, faces, body_model.weights, settings, rng)
    bones, weights, grid = skinning_weights(samples, rest_m, body_model.weights, settings)
    posing = Posing(bones, weights)
    held = () if settings.additions.pose_joints == "all" else FIXED_JOINTS
    motion = RefinedMotion(poses, fitted.trans, body_model.rest_joints(fitted.betas), body_model.parents, held)
    colours, seen = initial_colours(samples, posing, motion, crops)
    near, twin = surface_neighbours(samples, NEIGHBOURS), mirror_indices(samples, 2 * samples.spacing_m)
    degree = supported_degree(settings, motion, crops)
    if degree < settings.sh_degree:
        say(
            f"{person}: harmonics of degree {degree} instead of {settings.sh_degree}: the "
            "crops show too few sides of the body (limit_sh_to_views)"
        )
    start = gaussians_on(samples, degree)
    start.sh[:, 0] = sh_from_rgb(fill_unseen(colours, seen, near, twin))
    say(f"{person}: {len(crops)} crops; cameras see {seen.mean():.0%} of {start.count} Gaussians, the rest is inferred")
    return RestPose(rest_m, samples, posing, motion, grid, start, seen)
