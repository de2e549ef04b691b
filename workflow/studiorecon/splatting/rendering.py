# SPDX-License-Identifier: Apache-2.0
"""What a rasteriser takes and gives, whichever back end draws: sets of Gaussians, rendered views, gradients."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields

import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.splatting.blocks import BlockedGaussians

Drawable = Gaussians | BlockedGaussians | Sequence[Gaussians]
"""One set, one set already in blocks, or several sets that are composited in one pass (room first, then people, say)."""

SIDE_OUTPUTS = ("set_id", "normals")


@dataclass(frozen=True)
class Rendering:
    """One rendered view.

    Attributes:
        rgb: (H, W, 3) float32 over the background; not clamped above.
        alpha: (H, W) float32, 1 − transmittance.
        depth_m: (H, W) float32 expected z-depth (the blended depth over alpha), 0 where alpha is below 1e-4.
        set_id: (H, W) int16, which of several sets has the largest share of the pixel; −1 where the background has. None unless asked.
        normals: (H, W, 3) float32 unit normals in the world, 0 where nothing is drawn: the Gaussians' shortest axes, turned towards the
            camera and blended like colours. None unless asked.
        values: (H, W, C) float32, the caller's values of the Gaussians blended like colours. None unless given.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    depth_m: np.ndarray
    set_id: np.ndarray | None = None
    normals: np.ndarray | None = None
    values: np.ndarray | None = None


@dataclass(frozen=True)
class GaussianGradients:
    """Gradients by the stored form of N Gaussians (log scales, logit opacities); 0 for the invisible.

    Attributes:
        screen: (N,) length of the gradient by the projected centre, per pixel. 3DGS' densification threshold is for normalised
            coordinates: multiply by half the image width.
        background_rgb: (3,) gradient by the colour behind the Gaussians.
    """

    means_m: np.ndarray
    quaternions: np.ndarray
    log_scales: np.ndarray
    logit_opacities: np.ndarray
    sh: np.ndarray
    screen: np.ndarray
    background_rgb: np.ndarray

    def split(self, counts: Sequence[int]) -> list[GaussianGradients]:
        """The gradients of sets that were drawn together, set by set; each keeps the harmonics of the largest set.

        Raises ValueError when the counts do not add up to them.
        """
        ends = np.cumsum(counts)
        if not len(ends) or ends[-1] != len(self.means_m):
            raise ValueError(f"sets of {list(counts)} are not the {len(self.means_m)} Gaussians of these gradients")
        per_gaussian = [field.name for field in fields(self) if field.name != "background_rgb"]
        parts = [{name: getattr(self, name)[end - n : end] for name in per_gaussian} for n, end in zip(counts, ends)]
        return [GaussianGradients(**part, background_rgb=self.background_rgb) for part in parts]


def together(drawn: Drawable) -> tuple[Gaussians | BlockedGaussians, np.ndarray]:
    """All sets as one, and where each begins and ends, (sets + 1,)."""
    if isinstance(drawn, (Gaussians, BlockedGaussians)):
        return drawn, np.array([0, drawn.count])
    return concatenate(list(drawn)), np.cumsum([0, *(gaussians.count for gaussians in drawn)])


def check_sides(sides: Collection[str]) -> None:
    """Raises ValueError for a side output that nobody makes."""
    for side in sides:
        if side not in SIDE_OUTPUTS:
            raise ValueError(f"there is no side output {side!r}; there are {', '.join(SIDE_OUTPUTS)}")


def checked_crop(camera: Camera, crop: tuple[int, int, int, int] | None) -> tuple[int, int, int, int]:
    """The box (left, top, right, bottom) to draw, in whole pixels; the whole frame for None. Raises ValueError when it leaves it."""
    left, top, right, bottom = (0, 0, *camera.wh) if crop is None else crop
    if not (0 <= left < right <= camera.wh[0] and 0 <= top < bottom <= camera.wh[1]):
        raise ValueError(f"camera {camera.name}: the box {crop} does not lie in its {camera.wh[0]}×{camera.wh[1]} pixels")
    return left, top, right, bottom


def facing_normals(means_m: np.ndarray, quaternions: np.ndarray, scales: np.ndarray, centre_m: np.ndarray) -> np.ndarray:
    """(N, 3) float32 unit shortest axes in the world, turned towards a camera at ``centre_m``."""
    with np.errstate(invalid="ignore", over="ignore"):
        q = quaternions.astype(np.float64)
        w, x, y, z = (q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-12)).T
        columns = np.stack([
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1),
            np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1),
            np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ])  # fmt: skip
        axes = columns[np.argmin(scales, axis=1), np.arange(len(scales))]
        away = np.einsum("ni,ni->n", axes, means_m - centre_m) > 0
    return np.where(away[:, None], -axes, axes).astype(np.float32)


def checked_values(values: np.ndarray, count: int) -> np.ndarray:
    """The values as given. Raises ValueError unless they are (count, C)."""
    if values.ndim != 2 or len(values) != count:
        raise ValueError(f"values of shape {values.shape} do not fit {count} Gaussians")
    return values


def taken_apart(
    blended: np.ndarray, channels: int, sets: int, sides: Collection[str], alpha: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """(H, W, C) of the caller's ``channels``, then membership of ``sets``, then normals → set_id, normals, values of a ``Rendering``."""
    member = channels + (sets if "set_id" in sides else 0)
    return (
        largest_share(blended[..., channels:member], 1 - alpha) if "set_id" in sides else None,
        unit_or_zero(blended[..., member:]) if "normals" in sides else None,
        blended[..., :channels] if channels else None,
    )


def largest_share(shares: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """(H, W) int16 index of the largest of ``shares`` (H, W, sets), the first of equals; −1 where ``rest`` (H, W) is larger than all."""
    best = np.argmax(shares, axis=2)
    return np.where(np.take_along_axis(shares, best[..., None], 2)[..., 0] >= rest, best, -1).astype(np.int16)


def unit_or_zero(normals: np.ndarray) -> np.ndarray:
    """Vectors (H, W, 3) at unit length; those shorter than 1e-4 become 0."""
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    return np.where(length < 1e-4, 0, normals / np.maximum(length, 1e-4)).astype(np.float32)
