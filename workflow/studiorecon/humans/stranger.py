# SPDX-License-Identifier: Apache-2.0
"""``humans.stranger``: cuts a person outside the capture out of a photo, for ``canonical``.

A photo with alpha is already cut. In any other the embedded detector locates the person, and GrabCut (Rother et al.
2004) draws the outline where the detector's coarse mask leaves it open.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.detector.blazepose import MASK_PX, Landmarks
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_image, read_plate
from studiorecon.images.encoded import write_png
from studiorecon.progress import say
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Limits of the detector's mask (0 to 1): surely not, and surely the person; between them the colours decide.
_OUT, _IN = 0.02, 0.9
_ASK = "bring a photo of one whole person, or one that is cut out (PNG with alpha)"


def whole_mask(seen: Landmarks, wh: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Float32 in [0, 1]: the detector's mask of a person over the whole picture of ``wh`` pixels."""
    # OpenCV counts pixels from the first one's centre.
    affine = seen.region.crop_from_picture(MASK_PX)
    affine[:, 2] += affine[:, :2].sum(1) / 2 - 0.5
    grey = seen.mask.astype(np.float32) / np.float32(255)
    return cv2.warpAffine(grey, affine, wh, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def segment_person(picture: Integer[np.ndarray, "H W 3"], sure: Float[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """The person in ``picture`` by colours, where ``sure`` in [0, 1] is undecided; one region."""
    height, width = sure.shape
    # Longer side of the picture that GrabCut sees: finer than the detector's mask, and done in seconds.
    scale = min(1.0, 1000 / max(height, width))
    small = (max(1, round(width * scale)), max(1, round(height * scale)))
    colours = cv2.resize(picture, small, interpolation=cv2.INTER_AREA)
    there = cv2.resize(sure, small, interpolation=cv2.INTER_AREA)
    marks = np.where(there >= 0.5, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    marks[there <= _OUT], marks[there >= _IN] = cv2.GC_BGD, cv2.GC_FGD
    if (marks == cv2.GC_BGD).any() and (marks == cv2.GC_FGD).any():
        cv2.setRNGSeed(0)
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(colours, marks, (0, 0, 0, 0), *models, 5, cv2.GC_INIT_WITH_MASK)
    own = np.isin(marks, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(own)
    if len(sizes) > 1:
        own = (labels == 1 + int(np.argmax(sizes[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)
    return cv2.resize(own.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) >= 0.5


def run(stranger: str, photo: Path, networks: list[Path], cut: Written) -> None:
    """Write the person of ``photo`` as a PNG whose alpha is their mask; ``networks`` are the embedded detector's.

    Raises UserError for a photo without people, or with several people of similar size.
    """
    stored = read_image(photo, cv2.IMREAD_UNCHANGED)
    if stored.ndim == 3 and stored.shape[-1] == 4:
        rgb, own = read_plate(photo)
        picture = np.rint(255 * rgb).astype(np.uint8)
        if own.all() or not own.any():
            raise UserError(f"{photo} has an alpha channel without a person; {_ASK}")
        say(f"{stranger}: the photo's alpha is the mask")
    else:
        # Decoded again, because this way the photo's orientation tag is applied.
        picture = np.ascontiguousarray(read_image(photo, cv2.IMREAD_COLOR)[..., ::-1])
        wh = picture.shape[1], picture.shape[0]
        found = DetectorFiles(networks).detector().detect_new_people(picture)
        found = sorted(found, key=lambda seen: -seen.region.side)
        if not found:
            raise UserError(f"{photo} shows no person to the built-in detector; {_ASK}")
        if len(found) > 1:
            # The person in a photo must be this many times as large as every other one.
            if found[1].region.side * 1.5 > found[0].region.side:
                raise UserError(f"{photo} shows several people of similar size; {_ASK}")
            say(f"{stranger}: the photo shows {len(found)} people; the largest one is used")
        own = segment_person(picture, whole_mask(found[0], wh))
        say(f"{stranger}: the mask comes from the built-in detector and colours; check it in {cut.name}")
    rows = np.flatnonzero(own.any(axis=1))
    say(f"{stranger}: {len(rows) and int(np.ptp(rows)) + 1} px high in the photo")
    write_png(cut, np.dstack([picture, np.where(own, np.uint8(255), np.uint8(0))]))
