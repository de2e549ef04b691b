# SPDX-License-Identifier: Apache-2.0
"""The picture of the doctor and refinement: one frame per camera with reprojected points, and all cameras from
above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

_TILE_H = 480
_INK, _PAPER = (30, 30, 30), 245
_TRAINING, _HELD_OUT, _POINT = (200, 60, 30), (40, 90, 200), (20, 200, 60)
_KEYPOINT = (255, 40, 160)


def contact_sheet(
    training: Sequence[Camera],
    held_out: Sequence[Camera],
    pictures: Sequence[Integer[np.ndarray, "H W 3"] | None],
    points_m: Num[np.ndarray, "N 3"],
    report: dict[str, Any],
    keypoints: Sequence[Num[np.ndarray, "M 2"]] = (),
) -> Integer[np.ndarray, "H W 3"]:
    """RGB, uint8: the pictures in rows, then the view from above; a line of text each.

    ``keypoints``: per camera the detected pixels, drawn as rings in which the points' dots should be.
    """
    before = report.get("before_px_per_camera") or [None] * len(training)
    after = report.get("after_px_per_camera") or [None] * len(training)
    tiles = []
    for v, (camera, picture, first, last) in enumerate(zip(training, pictures, before, after)):
        tile = _photo(camera, picture, points_m, keypoints[v] if keypoints else np.zeros((0, 2)))
        text = camera.name + (
            "" if last is None else f"  {first:.1f} -> {last:.1f} px" if first is not None else f"  {last:.1f} px"
        )
        tiles.append(_add_label(tile, text))
    tiles.append(_add_label(_from_above(training, held_out, points_m), "from above, grid 1 m"))
    return _in_rows(tiles)


def _in_rows(tiles: Sequence[np.ndarray]) -> np.ndarray:
    """Tiles of one height, in rows that fit a screen."""
    rows: list[list[np.ndarray]] = [[]]
    for tile in tiles:
        if rows[-1] and sum(t.shape[1] for t in rows[-1]) + tile.shape[1] > 1900:
            rows.append([])
        rows[-1].append(tile)
    width = max(sum(t.shape[1] for t in row) for row in rows)
    blanks = [np.full((row[0].shape[0], width - sum(t.shape[1] for t in row), 3), 255, dtype=np.uint8) for row in rows]
    return np.concatenate([np.concatenate([*row, blank], axis=1) for row, blank in zip(rows, blanks)], axis=0)


def _photo(camera: Camera, picture: np.ndarray | None, points_m: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
    width = max(1, round(_TILE_H * camera.wh[0] / camera.wh[1]))
    if picture is None:
        tile: np.ndarray = np.full((_TILE_H, width, 3), _PAPER, dtype=np.uint8)
    else:
        tile = cv2.resize(picture, (width, _TILE_H), interpolation=cv2.INTER_AREA)
    pixels, depth = camera.resized((width, _TILE_H)).project(points_m)
    for pixel in keypoints * (np.array([width, _TILE_H]) / camera.wh):
        cv2.circle(tile, (int(pixel[0]), int(pixel[1])), 5, _KEYPOINT, 1, cv2.LINE_AA)
    for pixel in pixels[(depth > 0) & (np.abs(pixels) < 1e4).all(-1)]:
        cv2.circle(tile, (int(pixel[0]), int(pixel[1])), 3, _INK, -1, cv2.LINE_AA)
        cv2.circle(tile, (int(pixel[0]), int(pixel[1])), 2, _POINT, -1, cv2.LINE_AA)
    return tile


def _from_above(training: Sequence[Camera], held_out: Sequence[Camera], points_m: np.ndarray) -> np.ndarray:
    """(_TILE_H, _TILE_H, 3) x to the right, y up: frusta, names, points."""
    centres = np.array([c.centre_m[:2] for c in (*training, *held_out)])
    everything = np.concatenate([centres, points_m[:, :2]])
    low, high = np.quantile(everything, 0.0, axis=0), np.quantile(everything, 1.0, axis=0)
    extent = max(float((high - low).max()) * 1.35, 1.0)
    middle = (low + high) / 2
    tile = np.full((_TILE_H, _TILE_H, 3), _PAPER, dtype=np.uint8)

    def place(xy: np.ndarray) -> tuple[int, int]:
        x, y = ((np.asarray(xy) - middle) / extent * [1, -1] + 0.5) * _TILE_H
        return round(float(x)), round(float(y))

    for line in range(int(np.floor(-extent)), int(np.ceil(extent)) + 1):
        for axis in range(2):
            ends = np.array([middle - extent, middle + extent])
            ends[:, axis] = np.floor(middle[axis]) + line
            cv2.line(tile, place(ends[0]), place(ends[1]), (225, 225, 225), 1)
    for point in points_m[:: max(1, len(points_m) // 2000)]:
        cv2.circle(tile, place(point[:2]), 1, _POINT, -1)
    for cameras, colour in ((training, _TRAINING), (held_out, _HELD_OUT)):
        for camera in cameras:
            corners = camera.unproject(
                np.array([[0.0, camera.wh[1] / 2], [camera.wh[0], camera.wh[1] / 2]]),
                np.full(2, 0.18 * extent),
            )
            outline = np.array([place(camera.centre_m[:2]), *(place(c[:2]) for c in corners)], dtype=np.int32)
            cv2.polylines(tile, [outline], True, colour, 1, cv2.LINE_AA)
            x, y = place(camera.centre_m[:2])
            cv2.putText(tile, camera.name, (x + 5, y - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
    return tile


def _add_label(tile: np.ndarray, text: str) -> np.ndarray:
    band = np.full((28, tile.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(band, text, (6, 19), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _INK, 1, cv2.LINE_AA)
    return np.concatenate([band, tile], axis=0)
