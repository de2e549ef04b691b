# SPDX-License-Identifier: Apache-2.0
"""Points on the floor that distant cameras share: carpets, boards, tape, the edges of a platform.

From a quarter turn away a room looks different, except for a plane of known position: seen from straight above, a
carpet is the same for every camera. So every picture is projected onto the floor. Edges are compared by their
directions, which do not depend on light and exposure (Fitch et al., Orientation correlation, 2002), and matched patches
give correspondences. A small error of the floor or of a camera only shifts them: every pair of cameras must have one
homography.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.arrays import require
from studiorecon.geometry.statistics import peak_position
from studiorecon.images.channels import channel_sum
from studiorecon.rig.room_picture import RoomPicture
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num

# Half the width of the compared part of the floor around people, metres.
_HALF_M = 2.5
# Size of a cell of the floor: coarse, to align whole floors; fine, the least and largest at the pictures' resolution.
_COARSE_M, _FINEST_M, _WIDEST_M = 0.02, 0.004, 0.02
# Candidate heights of the floor relative to the given one.
_HEIGHTS_M = np.arange(-0.16, 0.161, 0.04)
# Size and spacing of patches, metres; correlation of a patch with its neighbourhood above which it is ambiguous, and of
# a match.
_PATCH_M, _EVERY_M, _BESIDE_M = 0.30, 0.12, 0.03
_SELF_ALIKE, _ALIKE, _SECOND = 0.75, 0.35, 0.85
# Share of a patch with edges in it.
_MIN_EDGES = 0.04
# One homography: within so many cells, for so many patches and such a share of them, spread over so much of the floor.
# Unrelated floors: 9 to 19 patches match, 32 to 65 % of all matches. The same floor: hundreds, 75 % or more.
_SAME_PLACES, _MIN_PATCHES, _MIN_SHARE, _MIN_SPREAD_M = 2.0, 20, 0.7, 0.25
# Sigma of a match, as a share of a cell; error of unmodelled lenses, as a share of the longer side.
_SHARP, _LENS_SHARE = 0.4, 0.001
# Largest distance of a match from the coarse alignment.
_BEYOND_M = 0.06


@dataclass(frozen=True)
class FloorMarks:
    """N points on the floor as V cameras see them.

    Attributes:
        pixels: (V, N, 2), NaN where not seen; every point in two cameras at least.
        points_m: by the given cameras.
        sigma_px: sigma of a point in every camera's picture.
        seen_by: pairs of cameras → number of points that they share.
    """

    pixels: Num[np.ndarray, "V N 2"]
    points_m: Num[np.ndarray, "N 3"]
    sigma_px: Num[np.ndarray, " V"]
    seen_by: dict[tuple[int, int], int]

    def of(self, which: Bool[np.ndarray, " N"]) -> FloorMarks:
        """The chosen points."""
        return replace(self, pixels=self.pixels[:, which], points_m=self.points_m[which])


@dataclass(frozen=True)
class _FloorImage:
    """A picture projected onto the floor: (H, W, 2) doubled directions of edges (both sides of an edge are one), with
    their strength up to 1, and (H, W) where the floor is known."""

    edges: Float[np.ndarray, "H W 2"]
    known: Bool[np.ndarray, "H W"]


def floor_marks(
    cameras: Sequence[Camera],
    rooms: Sequence[RoomPicture | None],
    middle_m: Num[np.ndarray, " 2"],
    height_m: float,
    reach_m: float,
) -> FloorMarks | None:
    """Points on the floor around ``middle_m``, near ``height_m``, that cameras with a picture share; None without.

    ``cameras`` are right up to shifts of ``reach_m`` on the floor. Raises ValueError for pictures of another size.
    """
    for camera, room in zip(cameras, rooms, strict=True):
        if room is not None:
            require("grey", room.grey, camera.hw)
            require("known", room.known, camera.hw)
    views = [v for v, room in enumerate(rooms) if room is not None]
    if len(views) < 2:
        return None
    plane_m, shifts = _coarse(cameras, rooms, views, middle_m, height_m, reach_m)
    middle = np.append(middle_m, plane_m)
    pixel_m = np.array([_pixel_m(camera, middle) for camera in cameras])
    # The pictures' resolution, within the useful range.
    place_m = float(np.clip(np.median(pixel_m[views]), _FINEST_M, _WIDEST_M))
    grid_m = _grid(middle_m, place_m)
    laid = {v: _project_to_floor(rooms[v], cameras[v], grid_m, plane_m) for v in views}

    def matched(a: int) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Places on the floor of view ``a`` that others share, and where each other has them, NaN where it does not."""
        at = _edge_places(laid[a], place_m)
        patches = [_patch(laid[a], place, place_m) for place in at]
        again = {
            b: _match_back(patches, at, laid[b], shifts[a, b] if (a, b) in shifts else -shifts[b, a], place_m)
            for b in views
            if b != a
        }
        # Most have no match, so their surroundings need no check.
        some = np.any([np.isfinite(moved[:, 0]) for moved in again.values()], axis=0)
        some[some] = _are_distinct(laid[a], at[some], place_m, reach_m)
        agreed = {b: _one_homography(at[some], moved[some], place_m) for b, moved in again.items()}
        return at[some], {b: np.where(ok[:, None], again[b][some], np.nan) for b, ok in agreed.items() if ok.any()}

    places: list[tuple[int, np.ndarray, dict[int, np.ndarray]]] = []
    seen_by: dict[tuple[int, int], int] = {}
    for a in views:
        at, found = matched(a)
        seen_by |= {(a, b): int(np.isfinite(moved[:, 0]).sum()) for b, moved in found.items()}
        places += [(a, place, {b: m[k] for b, m in found.items()}) for k, place in enumerate(at)]
    kept = [p for p in places if any(np.isfinite(at).all() for at in p[2].values())]
    if not kept:
        return None
    pixels = np.full((len(cameras), len(kept), 2), np.nan)
    corner_m = np.asarray(middle_m) - _HALF_M
    at_m = np.array([np.append(corner_m + p[1] * place_m, plane_m) for p in kept])
    for k, (a, _, others) in enumerate(kept):
        pixels[a, k] = cameras[a].project(at_m[k : k + 1])[0][0]
        for b, moved in others.items():
            if np.isfinite(moved).all():
                there_m = np.append(corner_m + moved * place_m, plane_m)
                pixels[b, k] = cameras[b].project(there_m[None])[0][0]
    sigma_px = np.maximum(_SHARP * place_m / pixel_m, [_LENS_SHARE * max(c.wh) for c in cameras])
    return FloorMarks(pixels, at_m, sigma_px, seen_by)


def _grid(middle_m: np.ndarray, place_m: float) -> np.ndarray:
    """(H, W, 2) middles of the cells of the floor, metres."""
    along = np.arange(-_HALF_M, _HALF_M, place_m) + place_m / 2
    x, y = np.meshgrid(middle_m[0] + along, middle_m[1] + along)
    return np.stack([x, y], axis=-1)


def _pixel_m(camera: Camera, place_m: np.ndarray) -> float:
    """Size of a pixel at a position on the floor, metres: the mean of along and across the line of sight."""
    away_m = float(np.linalg.norm(camera.centre_m - place_m))
    slope = abs(camera.centre_m[2] - place_m[2]) / away_m
    return away_m / float(np.mean(camera.focal_px)) / float(np.sqrt(max(slope, 0.1)))


def _project_to_floor(room: RoomPicture | None, camera: Camera, grid_m: np.ndarray, plane_m: float) -> _FloorImage:
    assert room is not None
    shape = grid_m.shape[:2]
    pixels, depth_m = camera.project(np.concatenate([grid_m, np.full((*shape, 1), plane_m)], axis=-1).reshape(-1, 3))
    pixels, depth_m = pixels.reshape(*shape, 2), depth_m.reshape(shape)
    (x, y), (width, height) = np.moveaxis(pixels, -1, 0), camera.wh
    known = (depth_m > 0) & (x >= 1) & (y >= 1) & (x < width - 1) & (y < height - 1)
    at = np.where(known[..., None], pixels, -1.0).astype(np.float32) - 0.5
    # Where cells are larger than pixels, the pixels between them count too.
    shrink = max(1.0, float(np.median(_spacing_px(pixels)[known[:-1, :-1]]))) if known[:-1, :-1].any() else 1.0
    grey = cv2.GaussianBlur(room.grey, (0, 0), 0.5 * shrink) if shrink > 1.2 else room.grey
    grey = cv2.remap(grey.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    shown = cv2.remap(room.known.astype(np.uint8), at[..., 0], at[..., 1], cv2.INTER_NEAREST)
    known = cv2.erode((known & (shown > 0)).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, *way, ksize=3) for way in ((1, 0), (0, 1)))
    strength = np.hypot(across, down)
    usual = float(np.quantile(strength[known], 0.9)) if known.any() else 1.0
    weight = np.where(known & (strength > 0.25 * usual), np.minimum(strength / max(usual, 1e-6), 1.0), 0.0)
    per = weight / np.maximum(strength, 1e-6) ** 2
    edges = np.stack([(across**2 - down**2) * per, 2 * across * down * per], axis=-1)
    return _FloorImage(edges.astype(np.float32), known)


def _spacing_px(pixels: np.ndarray) -> np.ndarray:
    """(H - 1, W - 1) pixels from a cell to the next, the lesser of both ways."""
    x, y = np.moveaxis(pixels, -1, 0)
    right, below = (np.diff(x)[:-1], np.diff(y)[:-1]), (np.diff(x, axis=0)[:, :-1], np.diff(y, axis=0)[:, :-1])
    nearest: np.ndarray = np.sqrt(np.minimum(*(across**2 + down**2 for across, down in (right, below))))
    return nearest


def _coarse(
    cameras: Sequence[Camera],
    rooms: Sequence[RoomPicture | None],
    views: Sequence[int],
    middle_m: np.ndarray,
    height_m: float,
    reach_m: float,
) -> tuple[float, dict[tuple[int, int], np.ndarray]]:
    """The height at which the floors of all cameras agree best, and the shift of each pair there, all in metres."""
    grid_m, reach = _grid(middle_m, _COARSE_M), max(1, round(reach_m / _COARSE_M))

    def agreement(plane_m: float) -> tuple[float, float, dict[tuple[int, int], np.ndarray]]:
        spectra = {v: _spectra(_project_to_floor(rooms[v], cameras[v], grid_m, plane_m)) for v in views}
        total, shifts = 0.0, {}
        for a, b in itertools.combinations(views, 2):
            score = _correlate(spectra[a], spectra[b], grid_m.shape[:2], reach)
            row, column = np.unravel_index(int(np.argmax(score)), score.shape)
            total += float(score[row, column])
            shifts[a, b] = (np.array([column, row]) - reach) * _COARSE_M
        return total, plane_m, shifts

    _, plane_m, shifts = max(
        (agreement(plane_m) for plane_m in (height_m + _HEIGHTS_M).tolist()), key=lambda one: one[0]
    )
    return plane_m, shifts


def _spectra(laid: _FloorImage) -> np.ndarray:
    """(4, H', W') padded Fourier transforms of the edges' two parts, of their squared strength and of known cells."""
    shape = [scipy.fft.next_fast_len(2 * n, real=True) for n in laid.known.shape]
    across, down = np.moveaxis(laid.edges, -1, 0)
    spectra: np.ndarray = scipy.fft.rfft2(
        np.stack([across, down, across**2 + down**2, laid.known.astype(np.float32)]), shape
    )
    return spectra


def _correlate(first: np.ndarray, second: np.ndarray, shape: Sequence[int], reach: int) -> np.ndarray:
    """(2 reach + 1, 2 reach + 1) correlation of floors of ``shape`` by the second's shift; -1 with little overlap."""
    padded, at = [scipy.fft.next_fast_len(2 * n, real=True) for n in shape], np.arange(-reach, reach + 1)
    (across, down, strength, known), (other_across, other_down, other_strength, other_known) = np.conj(first), second
    products = across * other_across + down * other_down, strength * other_known, known * other_strength
    edges, of_first, of_second, shared = scipy.fft.irfft2(np.stack([*products, known * other_known]), padded)[
        :, at[:, None], at
    ]
    similarity = edges / np.sqrt(np.maximum(of_first, 1.0) * np.maximum(of_second, 1.0))
    return np.where(shared > 1.0 / _COARSE_M**2, similarity, -1.0)


def _half(place_m: float) -> int:
    return max(1, round(_PATCH_M / 2 / place_m))


def _edge_places(laid: _FloorImage, place_m: float) -> np.ndarray:
    """(K, 2) columns and rows of the middles of patches of known floor that have edges."""
    half, step = _half(place_m), max(1, round(_EVERY_M / place_m))
    size, (height, width) = (2 * half + 1, 2 * half + 1), laid.known.shape
    share = cv2.boxFilter(_has_edge(laid.edges).astype(np.float32), -1, size)
    seen = cv2.boxFilter(laid.known.astype(np.float32), -1, size)
    rows, columns = np.meshgrid(range(half, height - half, step), range(half, width - half, step), indexing="ij")
    wanted = (share[rows, columns] >= _MIN_EDGES) & (seen[rows, columns] >= 0.9)
    return np.stack([columns[wanted], rows[wanted]], axis=1)


def _patch(laid: _FloorImage, place: np.ndarray, place_m: float) -> np.ndarray:
    column, row, half = *place, _half(place_m)
    return laid.edges[row - half : row + half + 1, column - half : column + half + 1]


def _are_distinct(laid: _FloorImage, at: np.ndarray, place_m: float, reach_m: float) -> np.ndarray:
    """(K,) whether the patch at each cell differs from all of its neighbourhood."""
    beside = max(1, round(_BESIDE_M / place_m))
    reach = max(2 * beside, round(reach_m / place_m))
    edges, size = _bordered(laid.edges, _half(place_m) + reach), 2 * (_half(place_m) + reach) + 1
    distinct = np.zeros(len(at), bool)
    for k, (column, row) in enumerate(at):
        around = edges[row : row + size, column : column + size]
        similarity = cv2.matchTemplate(around, _patch(laid, at[k], place_m), cv2.TM_CCORR_NORMED)
        similarity[_disc(similarity.shape, reach, reach, beside)] = -1
        distinct[k] = similarity.max() < _SELF_ALIKE
    return distinct


def _has_edge(edges: np.ndarray) -> np.ndarray:
    """(H, W) where there is any edge."""
    return np.asarray(channel_sum(np.abs(edges)) > 0)


def _bordered(edges: np.ndarray, cells: int) -> np.ndarray:
    """The edges (H, W, 2) with so many cells without edges around them."""
    return np.asarray(cv2.copyMakeBorder(edges, *(cells,) * 4, cv2.BORDER_CONSTANT))


def _disc(shape: tuple[int, ...], row: int, column: int, radius: int) -> np.ndarray:
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    return np.asarray((rows - row) ** 2 + (columns - column) ** 2 <= radius**2)


def _match_back(
    patches: Sequence[np.ndarray], at: np.ndarray, laid: _FloorImage, shift_m: np.ndarray, place_m: float
) -> np.ndarray:
    """(K, 2) column and row of each patch's match in another camera's floor near ``shift_m``, NaN without one."""
    found = np.full((len(patches), 2), np.nan)
    reach, beside = max(2, round(_BEYOND_M / place_m)), max(1, round(_BESIDE_M / place_m))
    begin = np.rint(np.asarray(shift_m) / place_m).astype(int)
    half = _half(place_m) + reach
    margin, size = half + int(np.abs(begin).max()), 2 * half + 1
    edges = _bordered(laid.edges, margin)
    share = cv2.boxFilter(_has_edge(edges).astype(np.float32), -1, (size, size), borderType=cv2.BORDER_CONSTANT)
    for k, patch in enumerate(patches):
        column, row = (int(i) for i in at[k] + begin)
        if share[row + margin, column + margin] < _MIN_EDGES / 2:
            continue
        top, left = row + margin - half, column + margin - half
        around = edges[top : top + size, left : left + size]
        similarity = cv2.matchTemplate(around, patch, cv2.TM_CCORR_NORMED)
        top, left = (int(i) for i in np.unravel_index(int(np.argmax(similarity)), similarity.shape))
        best = float(similarity[top, left])
        if best < _ALIKE or not (0 < top < 2 * reach and 0 < left < 2 * reach):
            continue
        rest = similarity.copy()
        rest[_disc(similarity.shape, top, left, beside)] = -1
        if rest.max() > _SECOND * best:
            continue
        down = peak_position(similarity[top - 1 : top + 2, left])
        across = peak_position(similarity[top, left - 1 : left + 2])
        found[k] = column + left - reach + across, row + top - reach + down
    return found


def _one_homography(here: np.ndarray, there: np.ndarray, place_m: float) -> np.ndarray:
    """(K,) which patches (K, 2), matched at ``there``, one homography explains.

    None if these are too few, or a minority, or too near one another.
    """
    known = np.flatnonzero(np.isfinite(there).all(-1))
    agreed = np.zeros(len(here), bool)
    if len(known) < _MIN_PATCHES:
        return agreed
    cv2.setRNGSeed(0)
    _, mask = cv2.findHomography(
        here[known].astype(np.float64), there[known], cv2.RANSAC, _SAME_PLACES, maxIters=5000, confidence=0.9999
    )
    inside = known[mask.reshape(-1) > 0] if mask is not None else known[:0]
    if len(inside) < max(_MIN_PATCHES, _MIN_SHARE * len(known)):
        return agreed
    spread_m = place_m * np.sqrt(np.linalg.eigvalsh(np.cov(here[inside].T.astype(float)))[0])
    if spread_m < _MIN_SPREAD_M:
        return agreed
    agreed[inside] = True
    return agreed
