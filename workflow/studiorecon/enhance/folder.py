# SPDX-License-Identifier: Apache-2.0
"""``enhance.folder``: enhances any method's rendered pictures, with photos for reference and consistency injection.

    python -m studiorecon enhance.folder --settings config/config.yaml --pictures DIR --references DIR --output DIR
    [--first N --count M]

Pictures and references are folders of pictures (in the order of their names) or videos. A part of a clip continues from
the pictures already in the output folder, with the same bytes as one pass. So a long clip can be made in parts, and an
interrupted one continued.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.enhance.backends import network
from studiorecon.enhance.injection_settings import Enhancing, Injecting
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_image
from studiorecon.footage.video import read_frames
from studiorecon.images.encoded import write_png
from studiorecon.progress import progress, say
from studiorecon.recursive.clip import enhanced, is_still
from studiorecon.recursive.flows import load_flow
from studiorecon.scene.camera import Camera
from studiorecon.scene.numbered_files import natural
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Integer

_PICTURES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"}
_VIDEOS = {".mkv", ".mp4", ".mov", ".avi", ".webm"}


@dataclass(frozen=True)
class Settings(Enhancing, Injecting):
    """Settings of this step."""


def read_pictures(source: Path, first: int = 0, count: int | None = None) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """(H, W, 3) uint8 pictures ``first`` … of a folder, in the order of their names, or of a video.

    Raises UserError for a source that is missing, holds no pictures, or holds one that cannot be read.
    """
    stop = None if count is None else first + count
    if source.is_file() and source.suffix.lower() in _VIDEOS:
        yield from islice(read_frames(source), first, stop)
        return
    if not source.is_dir():
        raise UserError(f"{source} is neither a folder of pictures nor a video")
    files = sorted(
        (p for p in source.iterdir() if p.suffix.lower() in _PICTURES), key=lambda p: (natural(p.stem), p.name)
    )
    if not files:
        raise UserError(f"{source} holds no pictures ({', '.join(sorted(_PICTURES))})")
    for file in files[first:stop]:
        yield np.ascontiguousarray(read_image(file, cv2.IMREAD_COLOR)[..., ::-1])


def run(
    settings: Settings,
    pictures: Path,
    references: Path | None,
    output: Path,
    first: int = 0,
    count: int = 0,
    weights: Path = Path("resources/weights"),
    device: str = "auto",
) -> None:
    """Enhance pictures ``first`` … ``first + count - 1`` (0 = to the end) into ``output``/000000.png, 000001.png, …

    References are one photo for all pictures, or one per picture. Raises UserError when an enhancer needs inputs that a
    folder does not have, when the numbers of pictures and references do not agree, and when the outputs before
    ``first`` are missing.
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
    wanted = min(count or total, total - first)
    if wanted < 1:
        raise UserError(f"{pictures} holds {total} pictures, so there is no picture {first}")
    photos = list(read_pictures(references, 0, 1)) if references is not None else []
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
        say(f"{pictures} does not move, so there is nothing to steady: no earlier outputs are injected")
        injection = replace(injection, history=0)
    overlap = min(injection.history, first)
    before = list(
        zip(read_pictures(pictures, first - overlap, overlap), _earlier(output, first - overlap, overlap), strict=True)
    )
    if settings.enhancer == "difix" and not given:
        raise UserError(
            "the enhancer difix needs a photo for reference; give --references, or "
            "set enhance.enhancer to fixer or none"
        )
    enhancer = network(settings.enhancer, weights, device, settings.seed)
    search = load_flow(settings.flow, settings.flow_preset, weights, device)
    each = read_pictures(references, first, wanted) if references is not None and given == total and total > 1 else None

    def reference(step: PathStep) -> np.ndarray:
        # ``enhanced`` calls this once per picture, in order.
        return next(each) if each is not None else photos[0] if photos else np.zeros((1, 1, 3), np.uint8)

    parts = read_pictures(pictures, first, wanted)
    unknown_depth = np.zeros(next(read_pictures(pictures)).shape[:2], np.uint16)
    depths = (unknown_depth for _ in range(wanted))
    outputs = enhanced(steps[first : first + wanted], parts, depths, reference, enhancer, injection, search, before)
    for index, picture in enumerate(progress(outputs, f"pictures of {pictures.name}", total=wanted), first):
        write_png(output / f"{index:06d}.png", picture)
    say(f"{wanted} pictures of {pictures} are in {output}; the film continues from {overlap} earlier outputs")


def _earlier(output: Path, first: int, count: int) -> Iterator[np.ndarray]:
    for index in range(first, first + count):
        file = output / f"{index:06d}.png"
        if not file.is_file():
            raise UserError(
                f"{file} is missing; a part of a clip goes on from the outputs before it: "
                f"make the pictures from {index} on first"
            )
        yield np.ascontiguousarray(read_image(file, cv2.IMREAD_COLOR, "make it again")[..., ::-1])
