# SPDX-License-Identifier: Apache-2.0
"""Reference rasteriser: slow, dense, float64 in torch with autograd's gradients. Only tests import it.

Every Gaussian is evaluated at every pixel, so cost is Gaussians × pixels. Conventions as in ``rasterise``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch.utils.checkpoint import checkpoint

from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import ALPHA_MAX, DILATION_PX2, FRAME_MARGIN, TRANSMITTANCE_MIN

# Number of pixels that are blended at once.
_PIXELS = 512

FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")


def leaves(gaussians: Gaussians) -> dict[str, torch.Tensor]:
    """The Gaussians as float64 tensors that collect gradients."""
    return {name: torch.tensor(getattr(gaussians, name), dtype=torch.float64, requires_grad=True) for name in FIELDS}


def render(
    parameters: dict[str, torch.Tensor],
    camera: Camera,
    background_rgb: Sequence[float] | torch.Tensor,
    near_m: float,
    antialias: bool = False,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """rgb (H, W, 3), alpha (H, W) and depth sum (H, W), differentiable; also by a background that is a tensor."""
    scales = torch.exp(parameters["log_scales"])
    splats = project(parameters["means_m"], parameters["quaternions"], scales, camera, near_m)
    opacity = torch.sigmoid(parameters["logit_opacities"]) * (splats.compensation if antialias else 1)
    colours = colours_towards(parameters["means_m"], parameters["sh"], camera)
    drawn, alpha, depth_sum = blend(splats, opacity, colours, camera, near_m)
    rest = (1 - alpha)[..., None]
    return drawn + rest * torch.as_tensor(background_rgb, dtype=torch.float64), alpha, depth_sum


@dataclass(frozen=True)
class Splats:
    """Gaussians in the image: centres and dilated covariances in pixels, √(det/det′), z-depth."""

    centres: torch.Tensor
    covariances: torch.Tensor
    compensation: torch.Tensor
    depth: torch.Tensor


def blend(
    splats: Splats, opacity: torch.Tensor, colours: torch.Tensor, camera: Camera, near_m: float
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Colours (N, C) blended over nothing (H, W, C), alpha (H, W) and depth sum (H, W)."""
    depth, covariances, centres = splats.depth, splats.covariances, splats.centres
    drawn = torch.nonzero((depth > near_m) & (opacity >= 1 / 255)).flatten()
    # The order is float32's, as in the kernels, so that near ties resolve the same way.
    drawn = drawn[torch.sort(depth.detach()[drawn].float(), stable=True).indices]
    determinant = covariances[drawn, 0, 0] * covariances[drawn, 1, 1] - covariances[drawn, 0, 1] ** 2
    a, b, c = (covariances[drawn, i, j] / determinant for i, j in ((1, 1), (0, 1), (0, 0)))
    pixels = torch.as_tensor(camera.pixel_centres()).reshape(-1, 2)
    drawn_splats = (centres[drawn], a, b, c, opacity[drawn], depth[drawn], colours[drawn])
    # In chunks of pixels, computed again for the gradients: this saves memory, and allocating for every picture costs
    # more time than the second pass.
    parts = [checkpoint(_blend_pixels, some, *drawn_splats, use_reentrant=False) for some in pixels.split(_PIXELS)]
    colour, alpha, depth_sum = (torch.cat(part) for part in zip(*parts))
    return colour.reshape(*camera.hw, -1), alpha.reshape(camera.hw), depth_sum.reshape(camera.hw)


def _blend_pixels(
    pixels: torch.Tensor,
    centres: torch.Tensor,
    a: torch.Tensor,
    b: torch.Tensor,
    c: torch.Tensor,
    opacity: torch.Tensor,
    depth: torch.Tensor,
    colours: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Colours (P, C), alpha (P,) and depth sum (P,) at pixels (P, 2); ``a``, ``b``, ``c``: inverse covariances."""
    dx = pixels[None, :, 0] - centres[:, 0, None]  # (drawn, pixels)
    dy = pixels[None, :, 1] - centres[:, 1, None]
    exponent = 0.5 * (a[:, None] * dx * dx + c[:, None] * dy * dy) - b[:, None] * dx * dy
    alpha = (opacity[:, None] * torch.exp(-exponent)).clamp_max(float(ALPHA_MAX))
    alpha = torch.where(alpha >= 1 / 255, alpha, torch.zeros_like(alpha))
    with torch.no_grad():
        open_pixels = torch.cumprod((torch.cumprod(1 - alpha, 0) > float(TRANSMITTANCE_MIN)).double(), 0)
    alpha = alpha * open_pixels
    # A sum of logarithms is differentiated in one pass; alpha ends below 1.
    before = torch.exp(torch.cumsum(torch.cat([torch.zeros_like(dx[:1]), torch.log1p(-alpha)]), 0))
    weight, rest = alpha * before[:-1], before[-1]
    return weight.T @ colours, 1 - rest, (weight * depth[:, None]).sum(0)


def project(
    means_m: torch.Tensor, quaternions: torch.Tensor, scales: torch.Tensor, camera: Camera, near_m: float
) -> Splats:
    """EWA projection as in 3DGS, linearised no further out than the limits of ``conventions.FRAME_MARGIN``."""
    camera_from_world = torch.as_tensor(camera.camera_from_world)
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    in_camera = means_m @ rotation.T + translation
    depth = in_camera[:, 2]
    safe = torch.where(depth > near_m, depth, torch.ones_like(depth))
    (fx, fy), (cx, cy), (width, height) = camera.focal_px, camera.principal_px, camera.wh
    margin = float(FRAME_MARGIN)
    ax = (in_camera[:, 0] / safe).clamp(-cx / fx - margin * width / fx, (width - cx) / fx + margin * width / fx)
    ay = (in_camera[:, 1] / safe).clamp(-cy / fy - margin * height / fy, (height - cy) / fy + margin * height / fy)
    zero = torch.zeros_like(safe)
    jacobian = torch.stack([fx / safe, zero, -fx * ax / safe, zero, fy / safe, -fy * ay / safe], -1).reshape(-1, 2, 3)
    in_image = jacobian @ (rotation @ (_rotations(quaternions) * scales[:, None, :]))
    covariances = in_image @ in_image.transpose(1, 2) + float(DILATION_PX2) * torch.eye(2, dtype=torch.float64)
    sharp = torch.linalg.cross(in_image[:, 0], in_image[:, 1]).square().sum(-1)
    shrinkage = sharp / (covariances[:, 0, 0] * covariances[:, 1, 1] - covariances[:, 0, 1] ** 2)
    compensation = torch.sqrt(shrinkage.clamp_min(1e-30))  # the root of 0 has no gradient
    centres = torch.stack([fx * in_camera[:, 0] / safe + cx, fy * in_camera[:, 1] / safe + cy], -1)
    return Splats(centres, covariances, compensation, depth)


def colours_towards(means_m: torch.Tensor, sh: torch.Tensor, camera: Camera) -> torch.Tensor:
    """(N, 3) colours of harmonics (N, K, 3) as the camera sees them."""
    directions = means_m - torch.as_tensor(camera.centre_m)
    directions = directions / directions.norm(dim=-1, keepdim=True)
    return ((_harmonics(directions)[:, : sh.shape[1], None] * sh).sum(1) + 0.5).clamp_min(0)


def _rotations(quaternions: torch.Tensor) -> torch.Tensor:
    w, x, y, z = (quaternions / quaternions.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, -1).reshape(-1, 3, 3)


def _harmonics(directions: torch.Tensor) -> torch.Tensor:
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [
        torch.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return torch.stack(basis, -1)
