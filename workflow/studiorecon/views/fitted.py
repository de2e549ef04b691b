# SPDX-License-Identifier: Apache-2.0
"""``views.fitted``: converts a generated film of one gap to the working size, and measures its support by photos.

Parts that no photo shows are the network's invention and are marked so: 0 in the mask, whatever the picture holds. If
the network's input shows people, they are in its views, and the mask marks them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.video import read_frames, to_bytes, to_float, write_lossless
from studiorecon.images.regions import dilate
from studiorecon.models.catalogue.selection import CHOICES
from studiorecon.models.choices import Synthesizer
from studiorecon.models.loading import adapter
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.step_files import require
from studiorecon.scene.support import EXCLUDED, support_levels
from studiorecon.signature import Written
from studiorecon.views.first_moment import FirstMomentPeople
from studiorecon.views.forward_warp import WarpSource, blend_photos
from studiorecon.views.frame import fit_network_frame
from studiorecon.views.synthesize import paint_holes, read_photos, read_segment
from studiorecon.views.warp_settings import PeopleInViews, ViewSource, Warping

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer


@dataclass(frozen=True)
class Settings(ViewSource, PeopleInViews, Warping):
    """Source of the film, and settings of the support.

    ``dilation_px``, with first_frames: side of the square by which people in the views are dilated (U24).
    """

    dilation_px: int = 21


def network_sizes(synthesizer: Synthesizer) -> list[tuple[int, int]]:
    """(h, w) of this network's films; of all networks for films from other tools."""
    networks = CHOICES["views.synthesizer"].networks
    return [adapter("view synthesizer", name).hw for name in networks if synthesizer in (name, "precomputed")]


def fit_picture(
    picture: Integer[np.ndarray, "h w 3"], camera: Camera, sizes: Sequence[tuple[int, int]], radius: int
) -> tuple[Integer[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """Uint8 working picture from a film's picture, and which pixels the film shows.

    Other pixels are painted from the film's rim, for people to look at; the training leaves them out. ``sizes`` are
    those of networks. Raises UserError for a picture of another size than these or the camera's.
    """
    if picture.shape[:2] == camera.hw:
        return picture, np.ones(camera.hw, bool)
    if picture.shape[:2] not in sizes:
        own = " or ".join(f"{width}×{height}" for height, width in sizes)
        raise UserError(
            f"the film's pictures are {picture.shape[1]}×{picture.shape[0]}; they must be {own}, the "
            f"network's own size, or {camera.wh[0]}×{camera.wh[1]}, the working size"
        )
    made, inside = fit_network_frame(camera.hw, picture.shape[:2]).back(to_float(picture))
    return (to_bytes(made) if inside.all() else paint_holes(made, inside.astype(np.float32), radius)), inside


def fit_views(
    film: Iterator[Integer[np.ndarray, "h w 3"]],
    cameras: list[Camera],
    photos: list[WarpSource],
    people: Callable[[Camera, tuple[int, int]], Bool[np.ndarray, "H W"]] | None,
    settings: Settings,
) -> Iterator[tuple]:
    """Uint8 picture and support of every camera of the gap; ``people`` gives the mask of people in the next view."""
    sizes = network_sizes(settings.synthesizer)
    for camera, picture in zip(progress(cameras, "views"), film):
        own, inside = fit_picture(picture, camera, sizes, settings.inpaint_radius)
        _, support, _ = blend_photos(
            camera, photos, settings.oversampling, settings.z_tolerance, np.radians(settings.fade_deg)
        )
        excluded = ~inside
        if people:
            excluded = excluded | dilate(people(camera, picture.shape[:2]), settings.dilation_px)
        yield own, support_levels(support, excluded)


def read_person_masks(film: Path) -> Callable[[Camera, tuple[int, int]], Bool[np.ndarray, "H W"]]:
    """A function that returns the mask of people of each view in turn, from a network's ``film`` of masks."""
    masks = read_frames(film)

    def people(camera: Camera, hw: tuple[int, int]) -> np.ndarray:
        mask = next(masks, np.zeros(0, np.uint8))
        require(film, mask.shape == hw, "it is not of the film whose views it is about")
        if hw == camera.hw:
            return mask > 0
        shown = np.repeat(mask[..., None] > 0, 3, axis=2).astype(np.float32)
        return fit_network_frame(camera.hw, hw).back(shown)[0][..., 0] >= 0.5

    return people


def run(
    settings: Settings,
    segment: str,
    film: Path,
    path: Path,
    model: Path,
    plates: list[Path],
    depths: list[Path],
    gains: list[Path],
    fits: list[Path],
    body: Path | None,
    seen: list[Path],
    views: Written,
    support: Written,
) -> None:
    """Write the pictures and the support of one gap from its ``film``, one picture per view of the path.

    ``fits`` and their ``body`` are given only if the network's input showed people, ``seen`` only if another network
    detects them in its views.
    """
    photos = read_photos(model, plates, depths, gains, settings.depth_jump)
    cameras, fps = read_segment(path, segment)
    count = sum(1 for _ in read_frames(film))
    if count != len(cameras):
        raise UserError(
            f"{film} has {count} pictures for {len(cameras)} views of segment {segment}; "
            f"set views.views_per_segment to {count - 1}"
        )
    who: Callable[[Camera, tuple[int, int]], np.ndarray] | None = None
    if seen:
        who = read_person_masks(seen[0])
    elif settings.key_frames == "first_frames":
        standing = FirstMomentPeople.read(fits, body)
        who = lambda camera, hw: standing.depth_m(camera) > 0  # noqa: E731
    made = list(fit_views(read_frames(film), cameras, photos, who, settings))
    holes = np.mean([mask == 0 for _, mask in made])
    say(f"segment {segment}: {len(made)} generated views; {holes:.1%} of their pixels appear in no photo (mask 0)")
    if who:
        covered = np.mean([mask == EXCLUDED for _, mask in made])
        source = "people by the network's masks" if seen else f"{len(fits)} people"
        say(f"segment {segment}: {covered:.1%} of their pixels show {source}, left out of the training")
    write_lossless(views, (picture for picture, _ in made), fps)
    write_lossless(support, (mask for _, mask in made), fps)
