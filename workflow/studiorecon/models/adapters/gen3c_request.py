# SPDX-License-Identifier: Apache-2.0
"""Checks whether a GEN3C request is worth a GPU hour: renders its cache here by a z-buffer and compares the results.

Silent faults that it detects: camera-to-world poses, depth of another scale than the poses, shifted pixel centres, a
path that does not start at the first key frame, people left in. Each shows when one key frame is warped into another.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num, Shaped

HW = (704, 1280)
CHUNK = 121
"""Frames that the network makes at once; the next chunk starts with the last of them."""
_SURFACE = 0.05
"""Share of depth within which two samples belong to one surface."""
_FIELDS = (
    "images_key_frames",
    "depth_key_frames",
    "mask_key_frames",
    "K_key_frames",
    "w2cs_key_frames",
    "w2cs_all",
    "Ks_all",
)


@dataclass(frozen=True)
class Evidence:
    """The measures of a re-rendered request.

    Attributes:
        own_error_levels: mean colour difference of key frame 0 rendered into its own camera, levels of 255.
        depth_agreement: worst key frame's median relative difference between its depth warped into other pictures (or
            theirs into its) and those pictures' own depth; NaN where no two can be compared.
        shared: share of key-frame pixels on which two key frames could be compared at all.
        coverage: share of the path's pixels that some key frame shows, at the frames of ``frames``.
        frames: rendered frames of the path.
    """

    own_error_levels: float
    depth_agreement: float
    shared: float
    coverage: Float[np.ndarray, " T"]
    frames: Integer[np.ndarray, " T"]


def splat(
    colour: Float[np.ndarray, "3 H W"],
    depth: Float[np.ndarray, "H W"],
    mask: Num[np.ndarray, "H W"],
    source: tuple,
    target: tuple,
) -> tuple[Float[np.ndarray, "3 H W"], Float[np.ndarray, "H W"]]:
    """Colours in [−1, 1] (−1 in holes) and depth (0 in holes) of one key frame in another camera.

    ``source`` and ``target`` are (K, w2c) with pixel centres at whole numbers. Every sample goes to its four nearest
    pixels with bilinear weights; a pixel uses those within 5 % of its nearest depth.
    """
    height, width = depth.shape
    rows, columns = np.nonzero((mask > 0) & (depth > 0))
    z = depth[rows, columns].astype(np.float64)
    rays = np.linalg.solve(source[0].astype(np.float64), np.stack([columns, rows, np.ones(len(z))]))
    target_from_source = target[1].astype(np.float64) @ np.linalg.inv(source[1].astype(np.float64))
    seen = target[0].astype(np.float64) @ (target_from_source[:3, :3] @ (rays * z) + target_from_source[:3, 3:])
    front = seen[2] > 1e-6
    u, v, w = seen[0, front] / seen[2, front], seen[1, front] / seen[2, front], seen[2, front]
    values = colour[:, rows[front], columns[front]].astype(np.float64)
    nearest = np.full(height * width, np.inf)
    total, weight = np.zeros((4, height * width)), np.zeros(height * width)
    for gather in (False, True):
        for across, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
            x, y = np.floor(u).astype(np.int64) + across, np.floor(v).astype(np.int64) + down
            share = (1 - np.abs(u - x)) * (1 - np.abs(v - y))
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (share > 1e-3)
            place = y[inside] * width + x[inside]
            if not gather:
                np.minimum.at(nearest, place, w[inside])
                continue
            kept = w[inside] <= nearest[place] * (1 + _SURFACE)
            place, portion = place[kept], share[inside][kept]
            weight += np.bincount(place, portion, height * width)
            for channel in range(3):
                total[channel] += np.bincount(place, portion * values[channel, inside][kept], height * width)
            total[3] += np.bincount(place, portion * w[inside][kept], height * width)
    filled = weight > 0
    mean = np.where(filled, total / np.where(filled, weight, 1), np.array([[-1.0], [-1.0], [-1.0], [0.0]]))
    return mean[:3].reshape(3, height, width), mean[3].reshape(height, width)


def coverage(
    request: dict[str, Shaped[np.ndarray, " ..."]], frames: Integer[np.ndarray, " T"]
) -> Iterator[Bool[np.ndarray, "H W"]]:
    """Which pixels some key frame shows, per frame of the path; a second per key frame and frame at full size."""
    for frame in frames:
        target = request["Ks_all"][frame], request["w2cs_all"][frame]
        yield np.any([_carried(request, i, target)[1] > 0 for i in range(len(request["K_key_frames"]))], axis=0)


def _carried(request: dict[str, np.ndarray], index: int, target: tuple) -> tuple[np.ndarray, np.ndarray]:
    colour, depth, mask = (request[f"{n}_key_frames"][index] for n in ("images", "depth", "mask"))
    return splat(colour, depth[0], mask[0], (request["K_key_frames"][index], request["w2cs_key_frames"][index]), target)


def check_form(request: dict[str, Shaped[np.ndarray, " ..."]]) -> None:
    """Raises ValueError for a request that GEN3C would misread: arrays, sizes, ranges, lengths, start, rotations."""
    missing = [name for name in _FIELDS if name not in request]
    if missing:
        raise ValueError(f"the GEN3C request lacks {', '.join(missing)}")
    images, depth, mask = (request[f"{n}_key_frames"] for n in ("images", "depth", "mask"))
    count, _, height, width = images.shape
    shapes: dict[str, tuple[object, object]] = {
        "depth": (depth.shape, (count, 1, height, width)),
        "mask": (mask.shape, (count, 1, height, width)),
        "w2cs": (request["w2cs_key_frames"].shape, (count, 4, 4)),
        "Ks_all": (request["Ks_all"].shape[0], len(request["w2cs_all"])),
    }
    for name, (given, wanted) in shapes.items():
        if given != wanted:
            raise ValueError(f"{name} of the GEN3C request has shape {given}, expected {wanted}")
    if not all(np.isfinite(request[name]).all() for name in _FIELDS):
        raise ValueError("the GEN3C request holds values that are no numbers; infinite depth must be 0 with mask 0")
    if images.min() < -1 or images.max() > 1 or images.min() >= 0:
        raise ValueError(
            f"colours of the GEN3C request are in [{images.min():.2f}, {images.max():.2f}], expected [−1, 1]"
        )
    frames = len(request["w2cs_all"])
    if frames < CHUNK or frames % (CHUNK - 1) != 1:
        raise ValueError(f"the GEN3C request asks for {frames} frames; it must be 121, 241, 361, …")
    for name in ("w2cs_key_frames", "w2cs_all"):
        turned = request[name][:, :3, :3].astype(np.float64)
        if np.abs(turned @ turned.transpose(0, 2, 1) - np.eye(3)).max() > 1e-4 or (np.linalg.det(turned) < 0).any():
            raise ValueError(f"{name} of the GEN3C request holds a matrix that is no rotation")
    if np.abs(request["w2cs_all"][0] - request["w2cs_key_frames"][0]).max() > 1e-5:
        raise ValueError("the GEN3C request does not start at its first key frame, which alone seeds the film")
    if np.abs(request["Ks_all"][0] - request["K_key_frames"][0]).max() > 1e-2:
        raise ValueError("the GEN3C request starts with other intrinsics than its first key frame has")
    if depth[mask > 0].min(initial=1.0) <= 0 or depth.max() > 100 or not (mask > 0).any():
        raise ValueError(
            "depth of the GEN3C request must be in (0, 100] where the mask is 1, and the mask must not be empty"
        )


def evidence(request: dict[str, Shaped[np.ndarray, " ..."]], samples: int = 5) -> Evidence:
    """The measures of a well-formed request: its cache rendered into its key frames and ``samples`` frames of the
    path."""
    images, depth, mask = (request[f"{n}_key_frames"] for n in ("images", "depth", "mask"))
    targets = list(zip(request["K_key_frames"], request["w2cs_key_frames"]))
    own, _ = _carried(request, 0, targets[0])
    usable = mask[0, 0] > 0
    error = float(np.abs(own - images[0])[:, usable].mean()) * 127.5
    gaps: list[list[np.ndarray]] = [[] for _ in images]
    compared, of = 0, 0
    for i in range(len(images)):
        for j in range(len(images)):
            if i == j:
                continue
            _, seen = _carried(request, i, targets[j])
            both = (seen > 0) & (mask[j, 0] > 0)
            gap = np.abs(seen[both] / depth[j, 0][both] - 1)
            gaps[i].append(gap)
            gaps[j].append(gap)
            compared, of = compared + int(both.sum()), of + int((mask[j, 0] > 0).sum())
    medians = [float(np.median(joined)) for own_gaps in gaps if own_gaps and len(joined := np.concatenate(own_gaps))]
    frames = np.unique(np.linspace(0, len(request["w2cs_all"]) - 1, samples).round().astype(int))
    shown = np.array([seen.mean() for seen in coverage(request, frames)])
    agreement = max(medians, default=float("nan"))
    return Evidence(error, agreement, compared / max(of, 1), shown, frames)


def check_evidence(found: Evidence, most_error: float = 2.0, most_gap: float = 0.1, least: float = 0.05) -> None:
    """Raises UserError when key frames do not reproduce themselves, contradict each other, or miss the path."""
    if not found.own_error_levels <= most_error:
        raise UserError(
            "key frame 0 of the GEN3C request differs from itself by "
            f"{found.own_error_levels:.1f} levels: its intrinsics are wrong"
        )
    if found.shared > 0.01 and not found.depth_agreement <= most_gap:
        raise UserError(
            "key frames of the GEN3C request disagree about depth by "
            f"{100 * found.depth_agreement:.0f} % in the median: depth has another "
            "scale than the poses, or poses are camera-to-world"
        )
    worst = int(np.argmin(found.coverage))
    if found.coverage[worst] < least:
        raise UserError(
            f"at frame {found.frames[worst]} of the path the key frames show "
            f"{100 * found.coverage[worst]:.0f} % of the picture: GEN3C "
            "would invent it; bring cameras nearer to one another or leave the widest gap out "
            '(survey.force: {closed_path: "off"})'
        )
