# SPDX-License-Identifier: Apache-2.0
"""The corners of a board in the pictures of a film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.board.pattern import Board
from studiorecon.footage.frames import read_stills, spread_frames
from studiorecon.footage.source import FootageSource

if TYPE_CHECKING:
    from jaxtyping import Num

# Pictures of a film in which the board is searched at first: one each 3 s of ten minutes.
_GLIMPSES = 200
# Pictures between the first and the last of these with the board: ten a second of one minute.
_PICTURES = 600
# Fewer corners do not determine a board's pose well: a homography needs 4.
MIN_CORNERS = 6
# A corner is refined within this share of the least distance between corners, so that it does not reach another one.
_REFINED_SHARE = 0.25

Finder = Callable[["Num[np.ndarray, 'H W']"], "Num[np.ndarray, 'N 2'] | None"]


@dataclass(frozen=True)
class Corners:
    """The board's corners in T pictures of a film that show it.

    Attributes:
        times_s: on the film's own time line, ascending.
        pixels: pixel centres at +0.5; NaN where not found.
        step_s: time between pictures that were searched.
    """

    times_s: Num[np.ndarray, " T"]
    pixels: Num[np.ndarray, "T N 2"]
    step_s: float


def board_corners(source: FootageSource, board: Board) -> Corners:
    """The corners of ``board`` in ``source``, of which T may be 0."""
    finder = _charuco(board) if board.dictionary else _chessboard(board)
    times_s = np.array(source.times_s) if source.times_s else np.arange(source.frames) / source.fps
    numbers = np.unique(np.linspace(0, source.frames - 1, _GLIMPSES).round().astype(int))
    found = _search(source, board, finder, numbers)
    if found:
        first, last = min(found), max(found)
        step = max(1, -(-(last - first + 1) // _PICTURES))
        numbers = np.arange(first, last + 1, step)
        found |= _search(source, board, finder, np.setdiff1d(numbers, list(found)))
    shown = sorted(found)
    step_s = float(np.median(np.diff(times_s[numbers]))) if len(numbers) > 1 else 1 / source.fps
    pixels = np.stack([found[n] for n in shown]) if shown else np.zeros((0, len(board.corners_m), 2))
    return Corners(times_s[shown], pixels, step_s)


def _search(
    source: FootageSource, board: Board, finder: Finder, numbers: Num[np.ndarray, " K"]
) -> dict[int, Num[np.ndarray, "N 2"]]:
    """Frame → corners, for those of ``numbers`` that show the board."""
    found = {}
    read = spread_frames if len(numbers) <= _GLIMPSES else read_stills
    for number, picture in zip(numbers.tolist(), read(source, numbers.tolist())):
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        pixels = finder(255 - grey if board.inverted else grey)
        if pixels is not None and np.isfinite(pixels[:, 0]).sum() >= MIN_CORNERS:
            found[number] = pixels + 0.5
    return found


def _charuco(board: Board) -> Finder:
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    detectors = []
    # Boards with an even number of rows were printed with another first square by OpenCV before 4.6.
    for legacy in (False, True) if board.rows % 2 == 0 else (False,):
        marker_m = board.square_m * board.marker_share
        pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, marker_m, markers)
        pattern.setLegacyPattern(legacy)
        detectors.append(cv2.aruco.CharucoDetector(pattern))

    def find(grey: np.ndarray) -> np.ndarray | None:
        pixels = np.full((len(board.corners_m), 2), np.nan)
        for detector in detectors:
            corners, numbers, _, _ = detector.detectBoard(grey)
            if numbers is not None and len(numbers) > np.isfinite(pixels[:, 0]).sum():
                pixels[:] = np.nan
                pixels[np.ravel(numbers)] = np.reshape(corners, (-1, 2))
        return _refined(grey, pixels, board)

    return find


def _chessboard(board: Board) -> Finder:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK

    def find(grey: np.ndarray) -> np.ndarray | None:
        there, corners = cv2.findChessboardCorners(grey, board.inner, None, flags)
        if not there:
            return None
        pixels = np.asarray(corners, np.float64).reshape(-1, 2)
        return _refined(grey, pixels if _first_square_is_black(grey, pixels, board) else pixels[::-1], board)

    return find


def _first_square_is_black(grey: np.ndarray, pixels: Num[np.ndarray, "N 2"], board: Board) -> bool:
    """Whether the squares diagonally inside of corners 0, 2, … of the first rows are darker than their neighbours."""
    across, down = board.inner
    grid = pixels.reshape(down, across, 2)
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    column, row = np.moveaxis(middles.round().astype(int), -1, 0)
    shades = grey[row.clip(0, grey.shape[0] - 1), column.clip(0, grey.shape[1] - 1)].astype(float)
    even = np.add.outer(np.arange(down - 1), np.arange(across - 1)) % 2 == 0
    return bool(shades[even].mean() < shades[~even].mean())


def _refined(grey: np.ndarray, pixels: Num[np.ndarray, "N 2"], board: Board) -> Num[np.ndarray, "N 2"]:
    """The corners to a fraction of a pixel."""
    there = np.isfinite(pixels[:, 0])
    grid = pixels.reshape(board.inner[1], board.inner[0], 2)
    apart = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    gaps = np.concatenate(apart)
    if not np.isfinite(gaps).any():
        return pixels
    half = int(max(2, _REFINED_SHARE * np.nanmin(gaps)))
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    found = pixels.copy()
    found[there] = cv2.cornerSubPix(grey, pixels[there, None].astype(np.float32), (half, half), (-1, -1), ends).reshape(
        -1, 2
    )
    return found
