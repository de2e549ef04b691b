# SPDX-License-Identifier: Apache-2.0
"""MapAnything (Keetha et al. 2025): cameras and depth of a few pictures of one moment, in metres.

It shares Pi3's conventions: world-from-camera poses, points in the camera's frame, OpenCV axes, and a focal length that
is fitted here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.models.adapters.pi3 import INSTEAD, postprocess, preprocess
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    import_upstream,
    loading,
    require_finite,
    staged_weights,
    torch_device,
)
from studiorecon.models.protocols import Reconstruction

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_REVISION = "00f9c245bbcb60522d1ed7f9e9d88462c6e3f38a"
CARD = Card(
    name="mapanything",
    title="MapAnything (Apache weights)",
    kind="pose and depth",
    terms=Terms(code="Apache-2.0", weights="Apache-2.0", commercial="yes"),
    weights=(
        WeightFile(
            "mapanything/model.safetensors",
            HUB,
            "facebook/map-anything-apache",
            4.91,
            "model.safetensors",
            revision=_REVISION,
            sha256="fa06c0fdccefc5048e072c85935d5789b1e36b307f3859033c17f9dcb9fd5201",
        ),
        WeightFile(
            "mapanything/config.json",
            HUB,
            "facebook/map-anything-apache",
            remote="config.json",
            revision=_REVISION,
            sha256="65701d09d99ed37a21d295f0d138978b3d584ab3bccdbcb4a2853da212b676c5",
        ),
    ),
    runtime=Runtime(
        image="mapanything", python=">=3.10", torch=">=2.4", pins=("safetensors", "huggingface_hub"), commit="f7ebafb"
    ),
    memory=Memory(12.0, "four to sixteen views; our estimate, not a published figure"),
    tried="never",
    unchecked="its encoder, which only the image fetches",
    instead=INSTEAD,
)
CARDS = (CARD,)


class MapAnything:
    """The network, loaded once; satisfies ``PoseAndDepth``. Weights: ``mapanything/`` below ``weights``."""

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        folder = staged_weights(card, weights) / "mapanything"
        self._device = torch_device(card, where)
        network = attribute(card, import_upstream(card, "mapanything.models"), "MapAnything")
        checkout = Path(next(iter(import_upstream(card, "dinov2").__path__))).parent
        with loading(card, folder), encoder_from(checkout):
            # Strict: weights missing in the staged file would stay random.
            made = network.from_pretrained(str(folder), strict=True)
        self._network = made.to(self._device).eval()

    def reconstruct(self, pictures: Sequence[Integer[np.ndarray, "H W 3"]], names: Sequence[str]) -> Reconstruction:
        """Cameras and depth; see ``models.protocols.PoseAndDepth``."""
        tensor, taken = preprocess(pictures)
        made = infer(self._network, tensor, self._device)
        for what, values in zip(("points", "confidence", "poses"), made):
            require_finite(CARD, what, values)
        return postprocess(*made, taken, names, CARD)


@contextmanager
def encoder_from(checkout: Path) -> Iterator[None]:
    """Context in which ``torch.hub.load`` builds from ``checkout`` and without weights.

    Upstream's encoder requests DINOv2's newest code and weights, which the staged file then overwrites. A run must not
    fetch either.
    """
    import torch

    hub: Any = torch.hub  # one of its functions is replaced
    fetched = hub.load

    def local(repository: str, entry: str, *given: Any, **options: Any) -> Any:
        kept = {name: value for name, value in options.items() if name not in ("force_reload", "trust_repo", "source")}
        return fetched(str(checkout), entry, *given, **{**kept, "pretrained": False}, source="local")

    hub.load = local
    try:
        yield
    finally:
        hub.load = fetched


def infer(
    network: Any, tensor: Float[np.ndarray, "N 3 h w"], where: Any
) -> tuple[Float[np.ndarray, "N h w 3"], Float[np.ndarray, "N h w"], Float[np.ndarray, "N 4 4"]]:
    """Camera-frame points, confidence and world-from-camera poses of pictures.

    The confidence c ≥ 1 (upstream: 1 + exp(x)) becomes (c - 1) / c, which is the sigmoid of x, and 0 outside its mask.
    """
    import torch

    prepare = attribute(CARD, import_upstream(CARD, "mapanything.utils.image"), "preprocess_inputs")
    views = [{"img": torch.from_numpy(picture.transpose(1, 2, 0) * 255).round().to(torch.uint8)} for picture in tensor]
    # At their own size: another one would crop, and change intrinsics with it.
    made = network.infer(
        prepare(views, resize_mode="fixed_size", size=(tensor.shape[3], tensor.shape[2])),
        apply_mask=False,
        mask_edges=False,
    )
    points = np.stack([one["pts3d_cam"][0].float().cpu().numpy() for one in made])
    sure = np.stack([one["conf"][0].float().cpu().numpy() for one in made])
    mask = np.stack([one["non_ambiguous_mask"][0].bool().cpu().numpy() for one in made])
    poses = np.stack([one["camera_poses"][0].float().cpu().numpy() for one in made])
    return points, np.where(mask, (sure - 1) / np.maximum(sure, 1), 0).astype(np.float32), poses


ADAPTER = MapAnything
