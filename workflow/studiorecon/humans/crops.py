# SPDX-License-Identifier: Apache-2.0
"""The training pictures of one person: a crop per frame and camera, with a class for every pixel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.scene.spool import Slot, Spool

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

IGNORED, OUTSIDE, PERSON = 0, 1, 2

_MIN_INSET_PX = 1.5  # a smaller inset is the fitted shape's own error


class Crop(Protocol):
    """One picture of one person.

    Attributes:
        frame: 0-based working frame.
        view: index of the training camera.
        camera: the camera cut to the crop.
        verdict: PERSON, OUTSIDE (no part of the person) or IGNORED (undecided).
    """

    @property
    def frame(self) -> int: ...
    @property
    def view(self) -> int: ...
    @property
    def camera(self) -> Camera: ...
    @property
    def rgb(self) -> Integer[np.ndarray, "h w 3"]: ...
    @property
    def verdict(self) -> Integer[np.ndarray, "h w"]: ...


@dataclass(frozen=True)
class HeldCrop:
    """A crop in memory."""

    frame: int
    view: int
    camera: Camera
    rgb: Integer[np.ndarray, "h w 3"]
    verdict: Integer[np.ndarray, "h w"]


@dataclass(frozen=True)
class SpooledCrop:
    """A crop whose pixels are read from disk on access: those of a minute fill gigabytes."""

    frame: int
    view: int
    camera: Camera
    spool: Spool
    picture: Slot
    verdict_slot: Slot

    @property
    def rgb(self) -> Integer[np.ndarray, "h w 3"]:
        return self.spool.get(self.picture)

    @property
    def verdict(self) -> Integer[np.ndarray, "h w"]:
        return self.spool.get(self.verdict_slot)


@dataclass(frozen=True)
class TrainingCrop:
    """The input of a ``Crop``: its picture, with mask labels and the fitted body's silhouette."""

    frame: int
    view: int
    camera: Camera
    rgb: Integer[np.ndarray, "h w 3"]
    labels: Integer[np.ndarray, "h w"]
    body: Bool[np.ndarray, "h w"]


def box_around(
    pixels: Float[np.ndarray, "V 2"], mask: Bool[np.ndarray, "H W"], wh: tuple[int, int], margin_px: int
) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom (exclusive) of a box in the picture around projected body points and a mask.

    Points behind the camera are NaN. None when neither is in the picture.
    """
    inside = np.all((pixels >= 0) & (pixels < np.array(wh)), axis=1)  # NaN compares false
    across, down = [pixels[inside, 0]], [pixels[inside, 1]]
    if mask.any():
        x, y, w, h = cv2.boundingRect(mask.astype(np.uint8))
        across.append(np.array([x, x + w - 1.0]))
        down.append(np.array([y, y + h - 1.0]))
    columns, rows = np.concatenate(across), np.concatenate(down)
    if len(columns) == 0:
        return None
    left, top = max(int(columns.min()) - margin_px, 0), max(int(rows.min()) - margin_px, 0)
    right, bottom = min(int(columns.max()) + 1 + margin_px, wh[0]), min(int(rows.max()) + 1 + margin_px, wh[1])
    return left, top, right, bottom


def crop_camera(camera: Camera, box: tuple[int, int, int, int]) -> Camera:
    """The part of a camera inside a pixel box; only the principal point moves."""
    left, top, right, bottom = box
    intrinsics = camera.intrinsics.copy()
    intrinsics[:2, 2] -= (left, top)
    return replace(camera, wh=(right - left, bottom - top), intrinsics=intrinsics)


def classify_pixels(
    labels: Integer[np.ndarray, "h w"],
    body: Bool[np.ndarray, "h w"],
    label: int,
    edge_px: int,
    occluder_px: int,
    inset_px: int = 0,
) -> Integer[np.ndarray, "h w"]:
    """Classes of pixels, from mask labels and the body's silhouette.

    Labels are 0 background, k+1 person k, 255 unassigned. Where masks are too small (``mask_inset_px``), pixels up to
    ``inset_px`` around them inside the silhouette are the person's too, and so are limbs that such a mask misses.
    Ignored are: pixels of other people and unassigned foreground, which may hide the person; a seam of ``edge_px`` on
    either side of the outline, whose colours are mixed with the background and would leave a halo; and pixels deeper
    than ``occluder_px`` inside the silhouette that the mask calls background, because furniture is in front of the
    person.
    """
    person = labels == label
    if inset_px > 0:
        kernel = np.ones((2 * inset_px + 1, 2 * inset_px + 1), np.uint8)
        thick = cv2.morphologyEx(body.astype(np.uint8), cv2.MORPH_OPEN, kernel)
        around = cv2.dilate(person.astype(np.uint8), kernel) > 0
        lost = body & (labels == 0) & (around | (thick == 0))
        _, parts = cv2.connectedComponents((person | lost).astype(np.uint8))
        person |= lost & np.isin(parts, np.unique(parts[person]))
    verdict = np.where(person, PERSON, np.where(labels == 0, OUTSIDE, IGNORED)).astype(np.uint8)
    if edge_px > 0:
        kernel = np.ones((2 * edge_px + 1, 2 * edge_px + 1), np.uint8)
        stamp = person.astype(np.uint8)
        # The picture is continued beyond its border, which would otherwise count as an outline.
        kept = cv2.erode(stamp, kernel, borderType=cv2.BORDER_REPLICATE)
        seam = (cv2.dilate(stamp, kernel) > 0) & (kept == 0)
        verdict[seam] = IGNORED
    # The padding keeps a silhouette that leaves the picture from being eroded there.
    kernel = np.ones((2 * occluder_px + 1, 2 * occluder_px + 1), np.uint8)
    deep = cv2.erode(body.astype(np.uint8), kernel, borderType=cv2.BORDER_REPLICATE) > 0
    verdict[deep & (labels == 0) & ~person] = IGNORED
    return verdict


def silhouette(pixels: Float[np.ndarray, "V 2"], hw: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    """The body's silhouette, from its projected vertices (NaN behind the camera) with closed gaps.

    Drawing all triangles of a dense body costs 20 ms a picture, this 0.3 ms; it differs by a pixel at the outline,
    which is not used here. Vertices are at most 3 % of a person's height apart. Vertices next to the camera project
    far away: they count one picture outside of it.
    """
    drawn = np.zeros(hw, np.uint8)
    at = np.floor(pixels[np.isfinite(pixels).all(axis=1)]).astype(np.int64)
    if len(at) == 0:
        return drawn > 0
    size = np.array([hw[1], hw[0]])
    gap = max(1, int(np.ceil(0.015 * np.ptp(np.clip(at, -size, 2 * size), axis=0).max())))
    at = at[np.all((at >= 0) & (at < size), axis=1)]
    drawn[at[:, 1], at[:, 0]] = 1
    return cv2.morphologyEx(drawn, cv2.MORPH_CLOSE, np.ones((2 * gap + 1, 2 * gap + 1), np.uint8)) > 0


def person_crops(
    view: int,
    camera: Camera,
    pictures: Iterator[Integer[np.ndarray, "H W 3"]],
    labels: Iterator[Integer[np.ndarray, "H W"]],
    vertices_m: Iterable[Float[np.ndarray, "V 3"]],
    valid: Bool[np.ndarray, " T"],
    label: int,
    margin_px: int,
    smallest_px: int,
) -> Iterator[TrainingCrop]:
    """One camera's training crops of a person: frames in which the body is valid and has ``smallest_px`` pixels.

    ``vertices_m`` is the fitted body over time; pictures and labels are the camera's frames in order.
    """
    for frame, (rgb, label_map, body_m) in enumerate(zip(pictures, labels, vertices_m)):
        if frame >= len(valid) or not valid[frame]:
            continue
        pixels, _ = camera.project(body_m)
        person = label_map == label
        box = box_around(pixels, person, camera.wh, margin_px)
        if box is None or np.count_nonzero(person) < smallest_px:
            continue
        left, top, right, bottom = box
        body = silhouette(pixels - [left, top], (bottom - top, right - left))
        picture = np.ascontiguousarray(rgb[top:bottom, left:right])
        yield TrainingCrop(
            frame, view, crop_camera(camera, box), picture, label_map[top:bottom, left:right].copy(), body
        )


def mask_inset_px(looks: Iterable[TrainingCrop], label: int) -> int:
    """How far the masks' outlines are inside the fitted body's, whole pixels; 0 below ``_MIN_INSET_PX`` and outside.

    The median over outline pixels of the signed distance, then over crops: occluders bend parts of the outline in a few
    crops, masks that are too small bend all of it. Pixels at the picture's border do not count.
    """
    insets = []
    for look in looks:
        person = (look.labels == label).astype(np.uint8)
        outline = (person > 0) & (cv2.erode(person, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE) == 0)
        if not outline.any() or not look.body.any():
            continue
        padded = np.pad(look.body.astype(np.uint8), 1)
        inside, outside = (cv2.distanceTransform(side, cv2.DIST_L2, 5)[1:-1, 1:-1] for side in (padded, 1 - padded))
        insets.append(np.median((np.maximum(inside - 1, 0) - outside)[outline]))
    inset = float(np.median(insets)) if insets else 0.0
    return round(inset) if inset >= _MIN_INSET_PX else 0


def classify_crops(
    looks: Iterable[TrainingCrop], label: int, edge_px: int, occluder_px: int, inset_px: int
) -> Iterator[HeldCrop]:
    """The crops, with classes, for the person with mask label ``label``."""
    for k in looks:
        verdict = classify_pixels(k.labels, k.body, label, edge_px, occluder_px, inset_px)
        yield HeldCrop(k.frame, k.view, k.camera, k.rgb, verdict)
