# SPDX-License-Identifier: Apache-2.0
"""Brightness factors of every camera and frame, and pictures without them (``survey/{gains,brightness}.json``).

Both files hold factors of colours in [0, 1]: one (red, green, blue) per camera, or one per frame. Dividing by them
gives the pictures of all cameras one common exposure, and gives every frame the light of the clean plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.arrays import require
from studiorecon.scene.files import write_json
from studiorecon.scene.schema import MappingOf, real
from studiorecon.scene.step_files import expect, read

if TYPE_CHECKING:
    from jaxtyping import Float, Num


_FACTORS = {"factors": MappingOf(real("F 3", above=0))}


@dataclass(frozen=True)
class Factors:
    """``by_camera``: camera → (1, 3) or (frames, 3) float64 factors; pictures of other cameras stay unchanged."""

    by_camera: Mapping[str, Float[np.ndarray, "F 3"]] = field(default_factory=dict)

    def normalise(self, camera: str, picture: Num[np.ndarray, "H W 3"], frame: int = 0) -> Num[np.ndarray, "H W 3"]:
        """A picture, uint8 or float32 in [0, 1], divided by its factor and clipped; the same array without a factor."""
        if camera not in self.by_camera:
            return picture
        own = self.by_camera[camera]
        factor = own[0 if len(own) == 1 else frame]
        if picture.dtype != np.uint8:
            return np.clip(picture / factor.astype(np.float32), 0, 1)
        table = np.clip(np.rint(np.arange(256)[:, None] / factor), 0, 255).astype(np.uint8)
        return cv2.LUT(picture, np.ascontiguousarray(table[None]))

    def normalise_film(
        self, camera: str, pictures: Iterable[Num[np.ndarray, "H W 3"]]
    ) -> Iterator[Num[np.ndarray, "H W 3"]]:
        """Pictures of a film as from ``normalise``, from its first frame on."""
        return (self.normalise(camera, picture, frame) for frame, picture in enumerate(pictures))


NONE = Factors()


def write_factors(path: Path, factors: Mapping[str, Num[np.ndarray, "F 3"]]) -> None:
    """Write camera → (1 or frames, 3) factors; empty factors mean that there is nothing to divide out."""
    for camera, own in factors.items():
        require(f"factors of {camera}", own, ("F", 3), finite=True)
    write_json(path, {"factors": {camera: np.round(own, 5).tolist() for camera, own in factors.items()}})


def read_factors(paths: Sequence[Path], frames: int | None = None) -> Factors:
    """The product of the files' factors, one or one per frame; another number than ``frames`` is refused.

    Raises UserError as ``step_files.read`` does.
    """

    def made(content: dict[str, Any]) -> dict[str, np.ndarray]:
        found = {camera: np.asarray(listed, np.float64) for camera, listed in content["factors"].items()}
        for camera, own in found.items():
            fits = len(own) > 0 if frames is None else len(own) in (1, frames)
            expect(fits, f"{len(own)} factors of camera {camera} for {frames or '1 to all'} frames")
        return found

    product: dict[str, np.ndarray] = {}
    for path in paths:
        for camera, own in read(path, _FACTORS, made).items():
            product[camera] = product[camera] * own if camera in product else own
    return Factors(product)
