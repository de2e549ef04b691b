# SPDX-License-Identifier: Apache-2.0
"""What exposure and light did to the pictures of every camera, and pictures without it: ``survey/gains.json``,
``survey/brightness.json``.

Both files hold factors of colours in [0, 1]: one (red, green, blue) per camera, or one per frame. Divided by them, the
pictures of all cameras are of one common exposure, and every frame is lit as the clean plate is.
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
from studiorecon.scene.intermediate import expect, read
from studiorecon.scene.schema import Named, real

if TYPE_CHECKING:
    from jaxtyping import Float, Num


_FACTORS = {"factors": Named(real("F 3", above=0))}


@dataclass(frozen=True)
class Factors:
    """``of``: camera → (1, 3) or (frames, 3) float64 factors; cameras that are not named have none, and keep their
    bytes."""

    of: Mapping[str, Float[np.ndarray, "F 3"]] = field(default_factory=dict)

    def even(self, camera: str, picture: Num[np.ndarray, "H W 3"], frame: int = 0) -> Num[np.ndarray, "H W 3"]:
        """A picture, uint8 or float32 in [0, 1], with its factor divided out, clipped; the same array without a
        factor."""
        if camera not in self.of:
            return picture
        own = self.of[camera]
        factor = own[0 if len(own) == 1 else frame]
        if picture.dtype != np.uint8:
            return np.clip(picture / factor.astype(np.float32), 0, 1)
        table = np.clip(np.rint(np.arange(256)[:, None] / factor), 0, 255).astype(np.uint8)
        return cv2.LUT(picture, np.ascontiguousarray(table[None]))

    def even_all(self, camera: str, pictures: Iterable[Num[np.ndarray, "H W 3"]]) -> Iterator[Num[np.ndarray, "H W 3"]]:
        """``even`` of every picture of a film, from its first frame on."""
        return (self.even(camera, picture, frame) for frame, picture in enumerate(pictures))


NONE = Factors()


def write_factors(path: Path, factors: Mapping[str, Num[np.ndarray, "F 3"]]) -> None:
    """Write camera → (1 or frames, 3) factors; an empty file of them says that there is nothing to divide out."""
    for camera, own in factors.items():
        require(f"factors of {camera}", own, ("F", 3), finite=True)
    write_json(path, {"factors": {camera: np.round(own, 5).tolist() for camera, own in factors.items()}})


def read_factors(paths: Sequence[Path], frames: int | None = None) -> Factors:
    """The product of what the files say; ``frames`` refuses a film's factors of another length.

    Raises UserError as ``intermediate.read`` does, also where there is not one factor, or one per frame.
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
