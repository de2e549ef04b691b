# SPDX-License-Identifier: Apache-2.0
"""A calibration board in films: its description (``board.yaml``, or Caliscope's ``charuco.toml``), and who sees it.

The board is in films of its own beside the description (``board/``), or in the capture's. Cameras are named after the
films.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.board.pattern import NAMES, read_board
from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.raw_camera import RawCamera
from studiorecon.errors import UserError
from studiorecon.scene.user_files import MAX_TEXT_BYTES, read_bytes

# Rate of pictures in folders: their order alone counts.
_PICTURE_FPS = 30.0
# A focal length known less well than this is said with a remedy: 3 % of 4 m are 12 cm.
_MAX_FOCAL_SIGMA = 0.03


def recognises(files: list[Path]) -> bool:
    return bool(files) and (files[0].name in NAMES or (files[0].suffix == ".toml" and is_board(files[0])))


def is_board(path: Path) -> bool:
    """Whether a TOML file describes a ChArUco board."""
    return "aruco_scale" in read_bytes(path, MAX_TEXT_BYTES).decode("utf-8", errors="replace")


def read(files: list[Path]) -> Reading:
    """The cameras whose films ``files`` has after the board's description."""
    # Decoding and estimating: more than a plan that lists formats should load.
    from studiorecon.board.cameras import cameras_from_board
    from studiorecon.board.corners import board_corners
    from studiorecon.footage.source import open_source

    board, films = read_board(files[0]), camera_films(files[1:])
    if len(films) < 2:
        raise UserError(
            f"{files[0]} describes a board, and {len(films)} films show it; put a film of each camera beside it, named "
            "as the camera's own"
        )
    sources = {name: open_source(path, _PICTURE_FPS) for name, path in films.items()}
    seen = {name: board_corners(source, board) for name, source in sources.items()}
    found = cameras_from_board(seen, {name: source.wh for name, source in sources.items()}, board)
    notes = [
        f"cameras are within ±{found.between_deg:.2g}° of one another (95 %), from a {board.in_words}, which two or "
        f"more see at {max(found.moments.values())} moments"
    ]
    for camera in found.cameras:
        name, sigma = camera.name, found.focal_sigma[camera.name]
        notes.append(
            f"camera {name}: focal length {camera.focal_px[0]:.0f} ± {1.96 * sigma * camera.focal_px[0]:.2g} px, "
            f"corners within {found.error_px[name]:.2g} px in the median, film {found.delays_s[name]:+.3f} s after "
            f"{found.cameras[0].name}'s" + (_MORE_VIEWS if sigma > _MAX_FOCAL_SIGMA else "")
        )
    cameras = [
        RawCamera(
            c.name, c.wh, c.intrinsics, "opencv", np.array([*found.distortion[c.name], 0.0, 0.0]), c.camera_from_world
        )
        for c in found.cameras
    ]
    return Reading("calibration board", tuple(cameras), "m", tuple(notes), has_floor=False)


_MORE_VIEWS = ": tilt the board more and move it to the picture's corners to know it better"


def camera_films(paths: list[Path]) -> dict[str, Path]:
    """Camera → film: named after it, or after its folder where films of several cameras share a name."""
    stems = [path.name if path.is_dir() else path.stem for path in paths]
    alike = len(set(stems)) < len(stems)
    return {path.parent.name if alike else stem: path for path, stem in zip(paths, stems, strict=True)}


FORMAT = CalibrationFormat(
    "board",
    "OpenCV's, Caliscope's and others' printed boards",
    "`board.yaml` or `charuco.toml`, beside the films or in `board/`, and films that show the board",
    (("board.yaml",), ("board/board.yaml",), ("board/charuco*.toml",), ("charuco*.toml",)),
    recognises,
    read,
    holds_cameras=is_board,
)
