# SPDX-License-Identifier: Apache-2.0
"""gsplat's rasterisation behind the same calls as ``rasterise.Rasteriser``.

gsplat shares our conventions (viewmats are camera_from_world, pixel centres at +0.5, quaternions w first, harmonics (N,
K, 3) in 3DGS order, dilation 0.3, thresholds of ``conventions``), so only shapes are converted. It does not check its
input (a zero quaternion becomes NaN, an infinite scale a wild tile index), so such Gaussians are removed and counted.

torch and gsplat are imported inside functions. Tests call this module without a GPU, with a float64 replacement of
gsplat's function.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.conventions import (
    BLOCK_FLOATS,
    DILATION_PX2,
    LANES,
    MEAN,
    OPACITY,
    QUATERNION,
    SANE,
    SCALE,
    SH,
)
from studiorecon.splatting.cpu.blocks import BlockedGaussians
from studiorecon.splatting.cpu.planes import DEPTH_ALPHA_MIN
from studiorecon.splatting.rendering import (
    Drawable,
    GaussianGradients,
    Rendering,
    check_values,
    facing_normals,
    split_channels,
)

if TYPE_CHECKING:
    import torch
    from jaxtyping import Num

FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")
Rasterization = Callable[..., tuple[Any, Any, dict[str, Any]]]
"""``gsplat.rasterization`` or what stands in for it."""
FAR_M = 1e10
REACH = 3.4
"""Standard deviations that a splat of opacity 1 reaches before it falls below 1/255, rounded up."""


def gsplat_function() -> Rasterization:
    """gsplat's rasterisation; imported here, because importing it takes seconds and may compile."""
    from gsplat import rasterization

    return rasterization


@dataclass(frozen=True)
class DeviceView:
    """One drawn view as tensors that carry gradients.

    Attributes:
        rgb, alpha, depth_sum: (H, W, 3), (H, W), (H, W) of the whole frame.
        centres: (1, N, 2) projected centres in pixels; their gradient is kept.
        visible: (N,) whether a Gaussian can touch a pixel.
        refused: Gaussians left out for NaN, infinite or absurd values.
    """

    rgb: torch.Tensor
    alpha: torch.Tensor
    depth_sum: torch.Tensor
    centres: torch.Tensor
    visible: torch.Tensor
    refused: torch.Tensor


def draw_view(
    parameters: dict[str, torch.Tensor],
    camera: Camera,
    background_rgb: torch.Tensor,
    near_m: float,
    *,
    degree: int,
    antialias: bool,
    function: Rasterization,
    values: torch.Tensor | None = None,
) -> DeviceView:
    """Draw raw parameters (the fields of ``Gaussians`` as tensors); ``values`` (N, C) are blended instead of
    colours."""
    import torch

    means = parameters["means_m"]
    sane = _sane(parameters, camera, near_m)
    viewmat, k = (
        torch.as_tensor(m, dtype=means.dtype, device=means.device)
        for m in (camera.camera_from_world, camera.intrinsics)
    )
    # Selected before any arithmetic, so that no NaN returns as a gradient either.
    chosen = {
        name: torch.where(sane.reshape(-1, *[1] * (value.ndim - 1)), value, 0.0) for name, value in parameters.items()
    }
    opacities = torch.sigmoid(chosen["logit_opacities"]) * sane
    drawn, alpha, meta = function(
        means=chosen["means_m"],
        quats=_unit(chosen["quaternions"]),
        scales=torch.exp(chosen["log_scales"]),
        opacities=opacities,
        colors=chosen["sh"] if values is None else values,
        viewmats=viewmat[None],
        Ks=k[None],
        width=camera.wh[0],
        height=camera.wh[1],
        near_plane=near_m,
        far_plane=FAR_M,
        eps2d=float(DILATION_PX2),
        sh_degree=degree if values is None else None,
        packed=False,
        backgrounds=background_rgb[None] if values is None else None,
        render_mode="RGB+D" if values is None else "RGB",
        rasterize_mode="antialiased" if antialias else "classic",
    )
    if meta["means2d"].requires_grad:
        meta["means2d"].retain_grad()
    visible = (meta["radii"][0] > 0).reshape(len(means), -1).all(dim=1) & sane
    return DeviceView(
        drawn[0, ..., :3] if values is None else drawn[0],
        alpha[0, ..., 0],
        drawn[0, ..., -1],
        meta["means2d"],
        visible,
        (~sane).sum(),
    )


def _unit(quaternions: torch.Tensor) -> torch.Tensor:
    """Quaternions of length one; one without a length is no turn."""
    import torch

    turned = quaternions.square().sum(-1, keepdim=True) > 1e-24
    whole = torch.where(turned, quaternions, quaternions.new_tensor([1.0, 0, 0, 0]))
    return torch.nn.functional.normalize(whole, dim=-1)


def _sane(parameters: dict[str, torch.Tensor], camera: Camera, near_m: float) -> torch.Tensor:
    """(N,) Gaussians that gsplat can draw: finite, with metres, colour and, where drawn, pixels below ``SANE``."""
    import torch

    means, log_scales, sh = (parameters[name].detach() for name in ("means_m", "log_scales", "sh"))
    limit, focal = float(SANE), max(camera.focal_px)
    scales = torch.exp(log_scales).amax(dim=1)
    sane = (means.abs() < limit).all(1) & (scales < limit) & ~log_scales.isnan().any(1)
    sane &= (
        torch.isfinite(parameters["quaternions"].detach().square().sum(1))
        & ~parameters["logit_opacities"].detach().isnan()
    )
    sane &= (sh.abs() < limit).flatten(1).all(1)
    row = [
        torch.as_tensor(m, dtype=means.dtype, device=means.device)
        for m in (camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3])
    ]
    x, y, z = (means @ row[0].T + row[1]).unbind(1)
    in_pixels = focal / z * torch.maximum(torch.maximum(x.abs(), y.abs()), 2 * REACH * scales)
    return sane & ((z <= near_m) | (in_pixels < limit))


class GsplatRasteriser:
    """Forward and backward passes on a CUDA device, with arrays in and out and the attributes of ``Rasteriser``.

    ``pair_count`` counts gsplat's tile intersections.
    """

    def __init__(
        self, *, near_m: float, antialias: bool = False, place: str = "cuda", function: Rasterization | None = None
    ) -> None:
        if not near_m > 0:
            raise ValueError(f"near_m ({near_m}) must be above 0")
        self.near_m, self.antialias = float(near_m), bool(antialias)
        self.refused = self.visible_count = 0
        self._place, self._function = place, function or gsplat_function()
        self._view: DeviceView | None = None

    def own_threads(self) -> AbstractContextManager[None]:
        """An empty context: the CPU's threads do not draw."""
        return nullcontext()

    def forward(
        self,
        gaussians: Drawable,
        camera: Camera,
        background_rgb: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        normals: bool = False,
        values: Num[np.ndarray, "N C"] | None = None,
    ) -> Rendering:
        """As ``Rasteriser.forward``."""
        import torch

        self._camera = camera
        arrays, self._degree = _raw(gaussians)
        self._leaves = {
            name: torch.tensor(array, device=self._place, requires_grad=True) for name, array in zip(FIELDS, arrays)
        }
        self._background = torch.tensor(np.asarray(background_rgb, np.float32), device=self._place, requires_grad=True)
        self._view = None
        if gaussians.count == 0:
            self.refused = self.visible_count = 0
            hw = camera.hw
            rgb = np.broadcast_to(np.asarray(background_rgb, np.float32), (*hw, 3)).copy()
            rendering = Rendering(rgb, np.zeros(hw, np.float32), np.zeros(hw, np.float32))
        else:
            self._view = draw_view(
                self._leaves,
                camera,
                self._background,
                self.near_m,
                degree=self._degree,
                antialias=self.antialias,
                function=self._function,
            )
            self.refused, self.visible_count = int(self._view.refused), int(self._view.visible.sum())
            rendering = Rendering(
                *(_array(image) for image in (self._view.rgb, self._view.alpha, expected_depth(self._view)))
            )
        wanted = [] if values is None else [check_values(values, gaussians.count)]
        if normals:
            wanted.append(facing_normals(arrays[0], arrays[1], arrays[2], camera.centre_m))
        blended = self._blended(np.hstack(wanted)) if wanted else np.zeros((*rendering.alpha.shape, 0), np.float32)
        parts = split_channels(blended, 0 if values is None else values.shape[1], normals)
        return Rendering(rendering.rgb, rendering.alpha, rendering.depth_m, *parts)

    def _blended(self, values: np.ndarray) -> np.ndarray:
        """Values (N, C) of the Gaussians just drawn, blended like colours over 0: (H, W, C) float32."""
        import torch

        if len(values) == 0:
            return np.zeros((*self._camera.hw, values.shape[1]), np.float32)
        with torch.no_grad():
            painted = torch.tensor(np.nan_to_num(values.astype(np.float32)), device=self._place)
            drawn = draw_view(
                self._leaves,
                self._camera,
                self._background,
                self.near_m,
                degree=self._degree,
                antialias=self.antialias,
                function=self._function,
                values=painted,
            )
        return _array(drawn.rgb)

    def backward(
        self,
        grad_rgb: Num[np.ndarray, "H W 3"] | None,
        grad_alpha: Num[np.ndarray, "H W"] | None = None,
        grad_depth: Num[np.ndarray, "H W"] | None = None,
    ) -> GaussianGradients:
        """As ``Rasteriser.backward``, once per ``forward``; raises as it does."""
        import torch

        if self._view is None:
            if not hasattr(self, "_leaves") or len(self._leaves["means_m"]):
                raise ValueError("backward needs a forward pass first, and each takes one")
            nothing = [value.detach().cpu().numpy() for value in self._leaves.values()]
            behind = np.zeros(3) if grad_rgb is None else grad_rgb.sum(axis=(0, 1))
            return GaussianGradients(*[*nothing, np.zeros(0, np.float32), behind.astype(np.float32)])
        drawn, self._view = self._view, None
        images = (drawn.rgb, drawn.alpha, expected_depth(drawn))
        given = [
            (image, gradient)
            for image, gradient in zip(images, (grad_rgb, grad_alpha, grad_depth))
            if gradient is not None
        ]
        for image, gradient in given:
            if gradient.shape != tuple(image.shape):
                raise ValueError(f"a gradient has shape {gradient.shape}, expected {tuple(image.shape)}")
        total = sum(
            (image * torch.as_tensor(np.asarray(g, np.float32), device=self._place)).sum() for image, g in given
        )
        if given:
            assert isinstance(total, torch.Tensor)
            total.backward()
        found = {name: _gradient(leaf) for name, leaf in self._leaves.items()}
        screen = np.linalg.norm(_gradient(drawn.centres)[0], axis=1)
        gradients = [*(found[name] for name in FIELDS), screen.astype(np.float32), _gradient(self._background)]
        return GaussianGradients(*gradients)


def _array(image: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(image.detach().cpu().numpy(), np.float32)


def expected_depth(drawn: DeviceView) -> torch.Tensor:
    """(H, W) blended depth over alpha, 0 where alpha is below 1e-4."""
    import torch

    enough = drawn.alpha >= float(DEPTH_ALPHA_MIN)
    return torch.where(enough, drawn.depth_sum / torch.where(enough, drawn.alpha, 1.0), 0.0)


def _gradient(tensor: torch.Tensor) -> np.ndarray:
    return (
        np.zeros(tuple(tensor.shape), np.float32)
        if tensor.grad is None
        else tensor.grad.cpu().numpy().astype(np.float32)
    )


def _raw(drawn: Gaussians | BlockedGaussians) -> tuple[list[np.ndarray], int]:
    """The five arrays of ``FIELDS`` and the degree of harmonics."""
    if isinstance(drawn, Gaussians):
        return [getattr(drawn, name) for name in FIELDS], drawn.sh_degree
    rows = drawn.parameters.reshape(-1, BLOCK_FLOATS // LANES, LANES)

    def rows_of(first: int, size: int) -> np.ndarray:
        return rows[:, first : first + size].transpose(0, 2, 1).reshape(-1, size)[: drawn.count].copy()

    bands = (drawn.degree + 1) ** 2
    opacity = rows_of(OPACITY, 1)[:, 0].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = (np.log(opacity) - np.log1p(-opacity)).astype(np.float32)
        log_scales = np.log(rows_of(SCALE, 3))
    sh = rows_of(SH, 3 * bands).reshape(-1, bands, 3)
    return [rows_of(MEAN, 3), rows_of(QUATERNION, 4), log_scales, logits, sh], drawn.degree
