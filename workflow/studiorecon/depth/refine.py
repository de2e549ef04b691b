# SPDX-License-Identifier: Apache-2.0
"""One camera's final depth: the room box and the furniture at the working size, and how well photos confirm them.

Writes ``depth/<camera>.exr``: Z metres, A confidence. Pixels that no other camera confirms, or that show a wall to
which no photo was fitted, have A at or below ``default_confidence``; measured ones are above it. With a network's depth
(``depth.source``) box, furniture and network compete for every pixel (``fusion``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from studiorecon.camera_files.colmap import camera_named, read_model
from studiorecon.configuration.setting import setting
from studiorecon.depth.estimates import read_camera_estimate
from studiorecon.depth.fusion import NetworkTerm, calibrate_network, label_with_network
from studiorecon.depth.layout.primitives import depth_with_primitives, read_primitives
from studiorecon.depth.stereo.kernels import FIRST
from studiorecon.depth.stereo.photo_cost import PhotoCostVolume, Surface
from studiorecon.depth.stereo.plates import Picture, equalise_exposure, read_pictures
from studiorecon.depth.sweep_settings import Comparison, DefaultConfidence
from studiorecon.footage.exr import write_depth
from studiorecon.footage.stills import read_plate
from studiorecon.images.sizes import resample_nearest
from studiorecon.progress import say
from studiorecon.scene.room import read_room
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Colour difference (sum over channels) at which a neighbour's surface is half as likely, when surfaces are carried to
# full size.
_EDGE_CONTRAST = 0.15


@dataclass(frozen=True)
class Settings(Comparison, NetworkTerm, DefaultConfidence):
    """The size at which photos are compared."""

    refine_width: int = setting(
        320,
        "Picture width at which photos confirm surfaces and a network's depth competes, at most the working width.",
        minimum=32,
        maximum=4096,
    )


def depth_confidence(
    surface: Surface, stated: Bool[np.ndarray, "H W"], default_confidence: float
) -> Float[np.ndarray, "H W"]:
    """Float32: 1 for a perfect match down to ``default_confidence`` for none; half of it where depth is a default.

    A default is a pixel that no other camera confirms, and every pixel that is not ``stated``: the sky of an open
    place looks the same from everywhere, which is no evidence for a wall.
    """
    quality = np.clip(1 - surface.cost, 0, 1)
    measured = default_confidence + (1 - default_confidence) * np.maximum(quality, 1 / 255)
    return np.where(surface.confirmed & stated, measured, default_confidence / 2).astype(np.float32)


def upsample_indices(
    values: Integer[np.ndarray, "h w"], guide: Float[np.ndarray, "h w 3"], rgb: Float[np.ndarray, "H W 3"]
) -> Integer[np.ndarray, "H W"]:
    """Index into the flattened small picture: the small pixel whose surface each full-size pixel takes.

    ``values`` are the small picture's surfaces, ``guide`` its colours, ``rgb`` the full picture. The surface with the
    most weight among the 3×3 nearest small pixels wins; weight falls with distance and colour difference.
    """
    return _carry(
        np.ascontiguousarray(values, np.int64),
        guide.astype(np.float32),
        rgb.astype(np.float32),
        np.float32(_EDGE_CONTRAST),
    )


@njit(cache=True)
def _carry(values, guide, rgb, contrast):
    height, width = rgb.shape[:2]
    small_height, small_width = values.shape
    source = np.zeros((height, width), np.int64)
    weights, where = np.zeros(9), np.zeros(9, np.int64)
    for y in range(height):
        v = (y + 0.5) * small_height / height
        for x in range(width):
            u = (x + 0.5) * small_width / width
            n = 0
            for j in range(int(v) - 1, int(v) + 2):
                for i in range(int(u) - 1, int(u) + 2):
                    if j < 0 or i < 0 or j >= small_height or i >= small_width:
                        continue
                    far = (u - i - 0.5) ** 2 + (v - j - 0.5) ** 2
                    apart = 0.0
                    for c in range(3):
                        apart += abs(rgb[y, x, c] - guide[j, i, c])
                    weights[n] = np.exp(-far - apart / contrast)
                    where[n] = j * small_width + i
                    n += 1
            best, best_weight = 0, -1.0
            for a in range(n):
                total = 0.0
                for b in range(n):
                    if values.flat[where[a]] == values.flat[where[b]]:
                        total += weights[b]
                # Cost and confidence come from the winning pixel of the largest weight.
                total += 1e-6 * weights[a]
                if total > best_weight:
                    best, best_weight = a, total
            source[y, x] = where[best]
    return source


@dataclass(frozen=True)
class _CameraSurfaces:
    """The surfaces of one camera: its picture, the room box and the furniture in front of it, at this size.

    ``fitted``: pixels on a face of the box that was fitted to the photos.
    """

    picture: Picture
    box: Surface
    furniture: Surface
    fitted: Bool[np.ndarray, "H W"]

    def confidences(self, network: Surface, default: float) -> list[Float[np.ndarray, "H W"]]:
        """Confidence of box, furniture and a network's surface."""
        everywhere = np.ones_like(self.fitted)
        pairs = ((self.box, self.fitted), (self.furniture, everywhere), (network, everywhere))
        return [depth_confidence(surface, stated, default) for surface, stated in pairs]


def compete_with_network(
    built: _CameraSurfaces,
    volume: PhotoCostVolume,
    index: int,
    estimate: Float[np.ndarray, "H W"],
    rgb: Float[np.ndarray, "H W 3"],
    at_full_size_m: Sequence[Float[np.ndarray, "H W"]],
    settings: Settings,
) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Depth and confidence where a network's ``estimate`` competes with box and furniture (``at_full_size_m``)."""
    picture = built.picture
    calibration, learned = calibrate_network(
        estimate, picture, built.box, built.furniture, built.fitted, settings.output
    )
    network = volume.of_depth(index, learned.depth_m)
    textured = picture.textured(settings.refine_window)
    labels = label_with_network(picture, built.box, built.furniture, network, learned, textured, settings)
    small_m = np.choose(labels, [built.box.depth_m, built.furniture.depth_m, learned.depth_m])
    small_confidence = np.choose(labels, built.confidences(network, settings.default_confidence))
    source = upsample_indices(labels, picture.rgb, rgb)
    found_m = small_m.ravel()[source]
    depth_m = np.choose(labels.ravel()[source], [*at_full_size_m, calibration.sharp_depth(estimate, rgb)])
    # A surface can end just beyond its last small pixel: never further than its neighbours' depth.
    runaway = (depth_m <= 0) | (depth_m > 1.5 * found_m + 0.1)
    say(f"{picture.camera.name}: {(labels == 2).mean():.0%} of the pixels show the network's own surface")
    return np.where(runaway, found_m, depth_m).astype(np.float32), small_confidence.ravel()[source]


def run(
    settings: Settings,
    camera: str,
    model: Path,
    plates: list[Path],
    room_box: Path,
    primitives: Path,
    estimates: list[Path],
    depth: Written,
) -> None:
    """Write one camera's depth and confidence; ``estimates`` is a network's depth of it, if there is one."""
    cameras = read_model(model.parent)
    names = [c.name for c in cameras]
    camera_named(cameras, camera, model)
    index = names.index(camera)
    room, furniture = read_room(room_box, names), read_primitives(primitives)
    gains = np.stack([room.gains[name] for name in names])
    pictures = equalise_exposure(read_pictures(cameras, plates, settings.refine_width), gains)
    volume = PhotoCostVolume(pictures, room, settings.refine_window, settings.mean_weight, looks=False)
    hw, whole = pictures[index].camera.hw, cameras[index]
    box, face = volume.nearest(index, hw)
    fitted = np.append(room.fitted, False)[face]
    volume.replace_all(np.array([primitive.numbers for primitive in furniture]))
    seen, number = volume.nearest(index, hw)
    in_view = number >= FIRST
    box_m = room.intersect(*whole.rays())[0].astype(np.float32)
    if not estimates:
        depth_m, _ = depth_with_primitives(furniture, whole, box_m)
        certainty = depth_confidence(seen, fitted | in_view, settings.default_confidence)
        certainty = resample_nearest(certainty, whole.hw)
    for path in estimates:
        in_front_m = replace(seen, depth_m=np.where(in_view, seen.depth_m, 0))
        built = _CameraSurfaces(pictures[index], box, in_front_m, fitted)
        rgb = read_plate(plates[index], whole.wh)[0] / gains[index].astype(np.float32)
        surfaces_m = [box_m, depth_with_primitives(furniture, whole, np.zeros_like(box_m))[0]]
        estimate = read_camera_estimate(path, whole)
        depth_m, certainty = compete_with_network(built, volume, index, estimate, rgb, surfaces_m, settings)
    say(
        f"{camera}: {in_view.mean():.0%} of the pixels show boxes; "
        f"{(certainty <= settings.default_confidence).mean():.0%} have default depth, because no other camera "
        "confirms that surface"
    )
    write_depth(depth, depth_m, certainty)
