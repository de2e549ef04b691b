# SPDX-License-Identifier: Apache-2.0
"""The description of a calibration board: its squares, their size and, for ChArUco, its markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.user_files import read_toml, read_yaml
from studiorecon.scene.user_values import as_mapping, number, whole

if TYPE_CHECKING:
    from jaxtyping import Num

NAMES = ("board.yaml", "board.yml", "charuco.toml")
_EXAMPLE = "{columns: 10, rows: 7, square_m: 0.04}, with dictionary: DICT_4X4_50 for a ChArUco board"
_KEYS = {"columns", "rows", "square_m", "dictionary", "marker_share", "inverted"}
_SIZES = ("4X4", "5X5", "6X6", "7X7")
DICTIONARIES = (
    *(f"DICT_{size}_{count}" for size in _SIZES for count in (50, 100, 250, 1000)),
    *("DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12"),
    *(f"DICT_APRILTAG_{name}" for name in ("16h5", "25h9", "36h10", "36h11")),
)
"""OpenCV's names of sets of markers."""
# Fewer squares leave too few corners for a pose; more are not printed.
MIN_SQUARES, MAX_SQUARES = 3, 60
# From a page in the hand to a banner on a wall.
MIN_SQUARE_M, MAX_SQUARE_M = 0.003, 1.0
# Metres per unit of Caliscope's files.
_UNITS_M = {"inch": 0.0254, "cm": 0.01}


@dataclass(frozen=True)
class Board:
    """A board of squares.

    Attributes:
        columns, rows: number of squares across and down.
        square_m: side of a square.
        dictionary: OpenCV's name of the ArUco markers; "" for a plain chessboard.
        marker_share: side of a marker relative to a square's.
        inverted: printed white on black.
    """

    columns: int
    rows: int
    square_m: float
    dictionary: str = ""
    marker_share: float = 0.75
    inverted: bool = False

    @property
    def inner(self) -> tuple[int, int]:
        """Number of inner corners across and down."""
        return self.columns - 1, self.rows - 1

    @property
    def corners_m(self) -> Num[np.ndarray, "N 3"]:
        """Inner corners row by row, on the board's plane z = 0."""
        down, across = np.mgrid[: self.rows - 1, : self.columns - 1]
        return np.stack([across, down, 0 * down], axis=-1).reshape(-1, 3) * self.square_m

    @property
    def in_words(self) -> str:
        kind = f"ChArUco board of {self.dictionary}" if self.dictionary else "chessboard"
        return f"{kind}, {self.columns}×{self.rows} squares of {1000 * self.square_m:g} mm"


def read_board(path: Path) -> Board:
    """The board in a ``board.yaml`` or Caliscope's ``charuco.toml``; raises UserError naming file and key."""
    given = _from_caliscope(read_toml(path), path) if path.suffix == ".toml" else read_yaml(path)
    table = as_mapping(given, str(path), _EXAMPLE)
    if unknown := sorted(set(map(str, table)) - _KEYS):
        raise UserError(f"{path} has the unknown key {unknown[0]!r}; it must have the form {_EXAMPLE}")
    if missing := [key for key in ("columns", "rows", "square_m") if key not in table]:
        raise UserError(f"{path} lacks {missing[0]}; it must have the form {_EXAMPLE}")
    columns, rows = (whole(table[k], f"{path}: {k}", MIN_SQUARES, MAX_SQUARES) for k in ("columns", "rows"))
    square_m = number(table["square_m"], f"{path}: square_m", MIN_SQUARE_M, MAX_SQUARE_M, "a square's side in metres")
    dictionary = str(table.get("dictionary") or "")
    if dictionary and dictionary not in DICTIONARIES:
        raise UserError(f"{path}: dictionary is {dictionary!r}; it must be one of {', '.join(DICTIONARIES)}")
    if not dictionary and (columns + rows) % 2 == 0:
        raise UserError(
            f"{path}: a chessboard of {columns}×{rows} squares looks the same after half a turn, so cameras on both "
            "sides of it cannot be told apart; use one with an even and an odd number of squares, or a ChArUco board"
        )
    share = number(table.get("marker_share", 0.75), f"{path}: marker_share", 0.1, 1.0, "a share of a square's side")
    return Board(columns, rows, square_m, dictionary, share, bool(table.get("inverted", False)))


def _from_caliscope(content: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The keys of a ``board.yaml`` for those of ``charuco.toml``."""
    try:
        unit = _UNITS_M[content["units"]]
        widths = content["board_width"] / content["columns"], content["board_height"] / content["rows"]
        square_m = content.get("square_size_override_cm", 0) / 100 or min(widths) * unit
        wanted = {key: content[key] for key in ("columns", "rows", "dictionary")}
    except (KeyError, TypeError, ZeroDivisionError) as error:
        raise UserError(
            f"{path} is no Caliscope board ({error!r}); write a board.yaml of the form {_EXAMPLE}"
        ) from None
    share = content.get("aruco_scale", 0.75)
    return {**wanted, "square_m": square_m, "marker_share": share, "inverted": content.get("inverted", False)}
