# SPDX-License-Identifier: Apache-2.0
"""``enhance.folder``: enhances any method's rendered pictures, with photos for reference and consistency injection.

    python -m studiorecon enhance.folder --settings config/config.yaml --pictures DIR --references DIR --output DIR

Pictures and references are folders of pictures (in the order of their names) or videos.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.enhance.backends import load_enhancer
from studiorecon.enhance.injection_settings import Enhancing, Injecting
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_image
from studiorecon.footage.video import read_frames
from studiorecon.images.encoded import write_png
from studiorecon.progress import progress, say
from studiorecon.recursive.flows import load_flow
from studiorecon.recursive.sequence import enhance_sequence, is_still
from studiorecon.scene.camera import Camera
from studiorecon.scene.numbered_files import natural_sort_key
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Integer

_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"}
_VIDEOS = {".mkv", ".mp4", ".mov", ".avi", ".webm"}


@dataclass(frozen=True)
class Settings(Enhancing, Injecting):
    """Settings of this step."""


def read_pictures(source: Path) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Pictures of a folder, in the order of their names, or of a video.

    Raises UserError for a source that is missing, holds no pictures, or holds one that cannot be read.
    """
    if source.is_file() and source.suffix.lower() in _VIDEOS:
        yield from read_frames(source)
        return
    if not source.is_dir():
        raise UserError(f"{source} is neither a folder of pictures nor a video")
    files = sorted(
        (p for p in source.iterdir() if p.suffix.lower() in _PICTURES), key=lambda p: (natural_sort_key(p.stem), p.name)
    )
    if not files:
        raise UserError(f"{source} holds no pictures ({', '.join(sorted(_PICTURES))})")
    for file in files:
        yield np.ascontiguousarray(read_image(file, cv2.IMREAD_COLOR)[..., ::-1])


def run(
    settings: Settings,
    pictures: Path,
    references: Path | None,
    output: Path,
    weights: Path = Path("resources/weights"),
    device: str = "auto",
) -> None:
    """Enhance pictures into ``output``/000000.png, 000001.png, …, with one reference for all, or one per picture.

    Raises UserError where an enhancer needs what a folder does not have, and where the numbers do not fit.
    """
    if settings.enhancer == "residual":
        raise UserError(
            "the enhancer residual needs cameras, depth and renders of the training photos, "
            "which a folder of pictures does not have; "
            "set enhance.enhancer to none, which injects earlier outputs only, or to a network"
        )
    if settings.enhancer == "precomputed":
        raise UserError(
            "the enhancer precomputed is for films of a scene's shots; set enhance.enhancer to none or to a network"
        )
    total = sum(1 for _ in read_pictures(pictures))
    photos = list(islice(read_pictures(references), 1)) if references is not None else []
    given = sum(1 for _ in read_pictures(references)) if references is not None else 0
    if given not in (0, 1, total):
        raise UserError(
            f"{references} holds {given} references for {total} pictures of "
            f"{pictures}; give one for all or one for each"
        )
    injection = settings.injection
    unknown = Camera(pictures.name, (1, 1), np.eye(3), np.eye(4))
    steps = [PathStep(unknown, float(index), "00") for index in range(total)]
    if injection.history and is_still(steps, read_pictures(pictures)):
        say(f"{pictures} does not move: no earlier outputs are injected")
        injection = replace(injection, history=0)
    if settings.enhancer == "difix" and not given:
        raise UserError(
            "the enhancer difix needs a photo for reference; give --references, or "
            "set enhance.enhancer to fixer or none"
        )
    enhancer = load_enhancer(settings.enhancer, weights, device, settings.seed)
    search = load_flow(settings.flow, settings.flow_preset, weights, device)
    each = read_pictures(references) if references is not None and given == total and total > 1 else None

    def reference(step: PathStep) -> np.ndarray:
        # ``enhance_sequence`` calls this once per picture, in order.
        return next(each) if each is not None else photos[0] if photos else np.zeros((1, 1, 3), np.uint8)

    unknown_depth = np.zeros(next(read_pictures(pictures)).shape[:2], np.uint16)
    depths = (unknown_depth for _ in range(total))
    outputs = enhance_sequence(steps, read_pictures(pictures), depths, reference, enhancer, injection, search)
    for index, picture in enumerate(progress(outputs, f"pictures of {pictures.name}", total=total)):
        write_png(output / f"{index:06d}.png", picture)
    say(f"{total} pictures of {pictures} are in {output}")
