# SPDX-License-Identifier: Apache-2.0
"""Depth networks in ONNX, on a CPU: MoGe-2 (Wang et al. 2025), Depth Anything V2 (Yang et al. 2024), a user's own.

MoGe's export answers with points in an affine frame, a mask and a metric scale; the shift of z that makes the points
project to their pixels is fitted here, as upstream does outside its network. Depth Anything answers with inverse depth
up to scale and shift. Any other network is shown a picture as Depth Anything is, and its one map is taken as it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.images.sizes import as_float, resample, resample_corners
from studiorecon.machine.onnx_network import open_network
from studiorecon.models.catalogue.card import HUB, Card, Kind, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import staged_weights

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_PATCH = 14
# Upstream suggests 1,200 to 2,500 tokens for MoGe: the most of them, for four plates only.
_TOKENS = 2500
# Depth Anything's shorter side, and the statistics of ImageNet with which it standardises pictures.
_SHORTER = 518
_MEAN, _DEVIATION = np.array([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]], np.float32)
# Points of the grid on which MoGe's shift is fitted, as upstream's.
_GRID = 64
_UNCHECKED = "its real weights: upstream's code, exported with random weights, ran"


def _card(name: str, title: str, kind: Kind, terms: Terms, file: WeightFile, release: str) -> Card:
    return Card(
        name=name,
        title=title,
        kind=kind,
        terms=terms,
        weights=(file,),
        runtime=Runtime(image="core", python=">=3.11", torch="", pins=("onnxruntime",), commit=release),
        memory=Memory(None, "runs on a CPU"),
        tried="random weights",
        unchecked=_UNCHECKED,
    )


def _moge(name: str, title: str, repository: str, size_gb: float, revision: str, sha256: str) -> Card:
    place = f"Ruicheng/{repository}/resolve/{revision}/model.onnx"
    file = WeightFile(
        f"moge/{repository}.onnx",
        f"{HUB}, and its mirror",
        size_gb=size_gb,
        remote="model.onnx",
        how="mirrors",
        mirrors=(f"huggingface.co/{place}", f"hf-mirror.com/{place}"),
        sha256=sha256,
    )
    terms = Terms(code="MIT, DINOv2 part Apache-2.0", weights="MIT", commercial="yes")
    return _card(name, title, "monocular depth", terms, file, f"{revision[:7]} of the authors' export")


_ANYTHING = "onnx-community/depth-anything-v2-small/resolve/4472b7362082ad9968fee890ca0f1e5aca36b93d/onnx/model.onnx"
CARDS = (
    _moge(
        "moge_vits",
        "MoGe-2 (ViT-S, ONNX)",
        "moge-2-vits-normal-onnx",
        0.141,
        "e50ffda41565591092adea54c6ac83d6212e1e23",
        "24eacb5dc7a2c54c7bc98f7de085ffbed79ad006ea5b664c2c2cdc02ff3a52f0",
    ),
    _moge(
        "moge_vitb",
        "MoGe-2 (ViT-B, ONNX)",
        "moge-2-vitb-normal-onnx",
        0.419,
        "2d247a122ada42ce700fe59273cd62e076da1f32",
        "bbf14e07a30f11e69d36ab861590123f5598ababcbc8946a063eb4a966f35a21",
    ),
    _card(
        "depth_anything",
        "Depth Anything V2 (Small, ONNX)",
        "inverse depth",
        Terms(code="Apache-2.0", weights="Apache-2.0", commercial="yes"),
        WeightFile(
            "depth_anything/depth-anything-v2-small.onnx",
            f"{HUB}, and its mirror",
            size_gb=0.099,
            remote="model.onnx",
            how="mirrors",
            mirrors=(f"huggingface.co/{_ANYTHING}", f"hf-mirror.com/{_ANYTHING}"),
            sha256="afb6a5c28f3b6bf1618c6e43f02073ef9dfdc70e937502d51603e57b0a1df10c",
        ),
        "4472b73 of the export by onnx-community",
    ),
)
"""Checksums as recorded by people who fetched these revisions in 2026; the weights could not be fetched here."""


class DepthNetwork:
    """A depth network in ONNX of any of these forms, opened once; raises UserError for another file."""

    def __init__(self, path: Path, title: str) -> None:
        self._path, self._title = path, title
        self._session = open_network(path, "set depth.network to a readable file", threads=0)
        given = self._session.get_inputs()
        pictures = [one for one in given if len(one.shape or ()) == 4]
        if len(pictures) != 1 or len(given) > 2 or pictures[0].type != "tensor(float)":
            inputs = ", ".join(f"{one.name} {tuple(one.shape)} {one.type}" for one in given)
            raise UserError(f"{path} takes {inputs}; a depth network takes one picture (1, 3, H, W) of float32")
        self._input = pictures[0]
        self._tokens = next((one.name for one in given if one is not self._input), "")
        self._outputs = [one.name for one in self._session.get_outputs()]
        self._with_points = "points" in self._outputs

    def depth(self, picture: Integer[np.ndarray, "H W 3"], focal_px: float | None) -> Float[np.ndarray, "H W"]:
        """Depth, or what the network says instead of it, of one picture; see ``models.protocols.MonocularDepth``."""
        shape = picture.shape[:2]
        if self._with_points:
            found = self._run(resample(as_float(picture), self._size(moge_size(shape))))
            points, mask = found["points"][0], found["mask"][0] > 0.5 if "mask" in found else None
            focal = focal_px / (np.hypot(*shape) / 2) if focal_px else None
            scale = next((found[name] for name in ("metric_scale", "scale") if name in found), np.ones(1))
            made = moge_depth(points, mask, focal) * float(np.ravel(scale)[0])
            return self._known(resample_known(made, shape))
        found = self._run((resized_cubic(picture, self._size(anything_size(shape))) - _MEAN) / _DEVIATION)
        maps = {name: np.squeeze(value) for name, value in found.items() if np.squeeze(value).ndim == 2}
        masks = [name for name in maps if "mask" in name or "valid" in name]
        depths = [name for name in maps if name not in masks]
        if not depths:
            answers = ", ".join(f"{name} {value.shape}" for name, value in found.items())
            raise UserError(f"{self._path} answers with {answers}; a depth network answers with one map (1, H, W)")
        made = resample_corners(maps[depths[0]], shape[:2])
        if masks:
            made = np.where(resample_corners(maps[masks[0]], shape[:2]) > 0.5, made, 0)
        return self._known(made)

    def _size(self, wanted: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns to show: those that the file fixes, else ``wanted``."""
        rows, columns = (a if isinstance(a, int) else b for a, b in zip(self._input.shape[2:], wanted))
        return rows, columns

    def _run(self, picture: np.ndarray) -> dict[str, np.ndarray]:
        feed: dict[str, Any] = {self._input.name: np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)}
        if self._tokens:
            rows, columns = (side // _PATCH for side in picture.shape[:2])
            feed[self._tokens] = np.array(rows * columns, np.int64)
        return dict(zip(self._outputs, self._session.run(None, feed)))

    def _known(self, made: np.ndarray) -> np.ndarray:
        known = np.isfinite(made) & (made > 0)
        if not known.any():
            raise UserError(
                f"{self._title} sees no surface in the whole picture; check the picture, or set depth.source to "
                "embedded"
            )
        return np.where(known, made, 0).astype(np.float32)


class StagedDepthNetwork(DepthNetwork):
    """A network of ``CARDS``; satisfies ``MonocularDepth``. Its device is the CPU whatever is wanted."""

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        super().__init__(staged_weights(card, weights) / card.weights[0].path, card.title)


def moge_size(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of whole patches, about ``_TOKENS`` of them, that MoGe would make of a picture itself."""
    aspect = shape[1] / shape[0]
    rows, columns = round((_TOKENS / aspect) ** 0.5), round((_TOKENS * aspect) ** 0.5)
    return rows * _PATCH, columns * _PATCH


def anything_size(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of whole patches with a shorter side of at least 518."""
    scale = max(_SHORTER / side for side in shape[:2])
    rows, columns = (max(round(scale * side / _PATCH) * _PATCH, _SHORTER) for side in shape[:2])
    return rows, columns


def resized_cubic(picture: Integer[np.ndarray, "H W 3"], hw: tuple[int, int]) -> Float[np.ndarray, "h w 3"]:
    """A picture in [0, 1] at another size, cubic and without antialias, as Depth Anything was shown them."""
    import cv2

    return cv2.resize(as_float(picture), hw[::-1], interpolation=cv2.INTER_CUBIC)


def moge_depth(
    points: Float[np.ndarray, "H W 3"], mask: Bool[np.ndarray, "H W"] | None, focal: float | None
) -> Float[np.ndarray, "H W"]:
    """Z of MoGe's affine points after the shift that projects them to their pixels; 0 outside the mask.

    ``focal`` is in halves of the picture's diagonal, fitted where it is None.
    """
    from scipy.optimize import least_squares

    height, width = points.shape[:2]
    half = np.hypot(height, width)
    across, down = ((2 * np.arange(side) + 1 - side) / half for side in (width, height))
    rows, columns = ((np.arange(_GRID) * side / _GRID).astype(int) for side in (height, width))
    there = np.ix_(rows, columns)
    chosen = np.ones((_GRID, _GRID), bool) if mask is None else mask[there]
    uv = np.stack(np.meshgrid(across[columns], down[rows]), axis=-1)[chosen]
    xy, z = points[there][chosen][:, :2].astype(np.float64), points[there][chosen][:, 2].astype(np.float64)

    def residual(shift: np.ndarray) -> np.ndarray:
        seen = xy / (z + shift)[:, None]
        f = focal or (seen * uv).sum() / np.square(seen).sum()
        return (f * seen - uv).ravel()

    shift = float(least_squares(residual, x0=0, ftol=1e-3, method="lm").x[0]) if len(uv) >= 2 else 0.0
    depth = points[..., 2] + np.float32(shift)
    return np.where(depth > 0 if mask is None else mask & (depth > 0), depth, 0).astype(np.float32)


def resample_known(depth: Float[np.ndarray, "h w"], shape: tuple[int, ...]) -> Float[np.ndarray, "H W"]:
    """A depth map at another size, bilinear among known pixels; 0 where fewer than half of the weight is known."""
    import cv2

    known = (depth > 0).astype(np.float32)
    total, share = (cv2.resize(a, shape[1::-1], interpolation=cv2.INTER_LINEAR) for a in (depth * known, known))
    return np.where(share > 0.5, total / np.maximum(share, 1e-6), 0)


ADAPTER = StagedDepthNetwork
