# SPDX-License-Identifier: Apache-2.0
"""Cameras from films of a moved board: poses, lenses and delays against the truth of made films."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.board.pattern import Board, read_board
from studiorecon.calibration.files import read_calibration
from studiorecon.errors import UserError
from studiorecon.footage.video import write_watchable
from studiorecon.geometry.distortion import undistort
from studiorecon.geometry.rotations import angle, exp
from studiorecon.plan.discovery import open_dataset

WH, FPS, FRAMES = (640, 480), 15.0, 110
FOCALS, RADIALS, LATE_S = (520.0, 560.0, 610.0, 540.0), (-0.25, -0.1, 0.08, -0.2), (0.0, 0.12, -0.31, 0.2)
# Squares of the printed board: about as large as in the films, so that sampling does not alias.
SQUARE_PX = 32
CHARUCO = "{columns: 5, rows: 4, square_m: 0.1, dictionary: DICT_4X4_50}"
CHESS = "{columns: 8, rows: 5, square_m: 0.06}"


def rig() -> list[np.ndarray]:
    """Poses of four cameras on an arc of 90°, 1.6 m from the board's place, camera from world."""
    poses = []
    for bearing in np.radians([-45.0, -15.0, 15.0, 45.0]):
        place = np.array([1.6 * np.sin(bearing), -1.6 * np.cos(bearing), 0.25 * np.sin(3 * bearing)])
        forward = -place / np.linalg.norm(place)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(forward, right), forward])
        poses.append(np.block([[turn, -(turn @ place)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    return poses


def board_pose(time_s: float, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """World from board: it stands upright, wanders and tilts."""
    upright = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    tilt = exp(np.array([0.5 * np.sin(1.3 * time_s), 0.4 * np.sin(0.9 * time_s + 1), 0.5 * np.sin(0.7 * time_s)]))
    middle = np.array([0.45 * np.sin(1.1 * time_s), 0.3 * np.sin(0.8 * time_s), 0.35 * np.cos(1.1 * time_s)])
    turn = tilt @ upright
    return turn, middle - turn @ np.array([board.columns, board.rows, 0]) * board.square_m / 2


def printed(board: Board) -> np.ndarray:
    if not board.dictionary:
        squares = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2 * 255
        return np.kron(squares, np.ones((SQUARE_PX, SQUARE_PX))).astype(np.uint8)
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker_share, markers)
    return pattern.generateImage((board.columns * SQUARE_PX, board.rows * SQUARE_PX))


@cache
def rays(view: int) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(WH[0]), np.arange(WH[1]))
    bent = (np.stack([columns, rows], axis=-1) + 0.5 - np.array(WH) / 2) / FOCALS[view]
    ideal, _ = undistort(bent.reshape(-1, 2), "opencv", np.array([RADIALS[view], 0, 0, 0]))
    return np.c_[ideal, np.ones(len(ideal))]


def picture(board: Board, texture: np.ndarray, pose: np.ndarray, view: int, time_s: float) -> np.ndarray:
    """What a camera sees: every pixel's ray meets the board's plane."""
    turn, place = board_pose(time_s, board)
    towards = rays(view) @ pose[:3, :3] @ turn
    centre = turn.T @ (-pose[:3, :3].T @ pose[:3, 3] - place)
    on_board = centre[:2] - towards[:, :2] * (centre[2] / towards[:, 2])[:, None]
    padded = cv2.copyMakeBorder(texture, *4 * [SQUARE_PX], cv2.BORDER_CONSTANT, value=255)
    at = (on_board / board.square_m * SQUARE_PX + SQUARE_PX - 0.5).astype(np.float32).reshape(WH[1], WH[0], 2)
    grey = cv2.remap(padded, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
    noise = np.random.default_rng(int(1000 * time_s) + view + 10**6).normal(0, 2, grey.shape)
    return np.repeat(np.clip(cv2.GaussianBlur(grey, (0, 0), 0.7) + noise, 0, 255).astype(np.uint8)[..., None], 3, -1)


def film_board(folder: Path, board: Board, cameras: int = 4) -> None:
    for view, pose in enumerate(rig()[:cameras]):
        frames = (picture(board, printed(board), pose, view, 1 + t / FPS - LATE_S[view]) for t in range(FRAMES))
        write_watchable(folder / f"cam{view}.mp4", frames, FPS)


@pytest.fixture(scope="module", params=[CHARUCO, CHESS], ids=["charuco", "chessboard"])
def capture(request, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    (folder / "videos").mkdir()
    (folder / "board.yaml").write_text(request.param)
    film_board(folder / "videos", read_board(folder / "board.yaml"))
    return folder


def test_a_moved_board_gives_cameras_lenses_and_delays(capture):
    dataset = open_dataset(capture)
    assert dataset.calibration[0].name == "board.yaml"
    assert not [note for note in dataset.notes if "not used" in note]
    found = read_calibration(dataset.calibration)
    assert [c.name for c in found.cameras] == list(dataset.footage)
    for view, camera in enumerate(found.cameras):
        assert camera.intrinsics[0, 0] == pytest.approx(FOCALS[view], rel=0.005)
        assert camera.distortion[0] == pytest.approx(RADIALS[view], abs=0.02)
    stated_deg = float(found.notes[0].split("±")[1].split("°")[0])
    assert stated_deg < 1
    for a, b in combinations(range(4), 2):
        between, true = (
            poses[a] @ np.linalg.inv(poses[b]) for poses in ([c.camera_from_world for c in found.cameras], rig())
        )
        assert np.degrees(angle(between[:3, :3], true[:3, :3])) < min(stated_deg, 0.25)
        assert np.linalg.norm(between[:3, 3]) == pytest.approx(np.linalg.norm(true[:3, 3]), abs=0.005)
    for note, late in zip(found.notes[1:], LATE_S, strict=True):
        assert float(note.split("film ")[1].split(" s")[0]) == pytest.approx(late, abs=0.01)


def test_a_camera_that_never_sees_the_board_is_named(capture, tmp_path):
    dataset = open_dataset(capture)
    write_watchable(tmp_path / "blind.mp4", np.full((20, *WH[::-1], 3), 90, np.uint8), FPS)
    with pytest.raises(UserError, match=r"camera blind shows the board .* in 0 pictures"):
        read_calibration((*dataset.calibration[:3], tmp_path / "blind.mp4"))


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("{columns: 8, rows: 6, square_m: 0.06}", "{columns: 8, rows: 5, square_m: 0.06}"),
        ("{columns: 8, rows: 5}", "{columns: 8, rows: 5, square_m: 0.06}"),
        ("{columns: 8, rows: 5, square_m: 60}", "{columns: 8, rows: 5, square_m: 0.06}"),
        ("{columns: 8, rows: 5, square_m: 0.06, dictionary: DICT_9}", "{columns: 8, rows: 5, square_m: 0.06}"),
        ("{columns: 8, rows: 5, square_m: 0.06, squares: 3}", "{columns: 8, rows: 5, square_m: 0.06}"),
    ],
)
def test_a_description_that_is_no_board_is_refused_and_the_remedy_read(text, remedy, tmp_path):
    path = tmp_path / "board.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=r"board.yaml"):
        read_board(path)
    path.write_text(remedy)
    assert read_board(path).square_m == 0.06


def test_caliscopes_board_is_read_in_metres(tmp_path):
    path = tmp_path / "charuco.toml"
    path.write_text(
        'columns = 4\nrows = 5\nboard_height = 11.0\nboard_width = 8.5\ndictionary = "DICT_4X4_1000"\nunits = "inch"\n'
        "aruco_scale = 0.75\nsquare_size_override_cm = 5.4\ninverted = true\n"
    )
    assert read_board(path) == Board(4, 5, pytest.approx(0.054), "DICT_4X4_1000", 0.75, True)


def test_a_board_in_films_of_its_own_is_preferred_to_the_captures(capture, tmp_path):
    (tmp_path / "videos").mkdir()
    (tmp_path / "board").mkdir()
    for film in (capture / "videos").iterdir():
        (tmp_path / "videos" / film.name).symlink_to(film)
        (tmp_path / "board" / film.name).symlink_to(film)
    (tmp_path / "board" / "board.yaml").write_text(CHESS)
    dataset = open_dataset(tmp_path)
    assert {path.parent.name for path in dataset.calibration} == {"board"}
    assert len(dataset.calibration) == 1 + len(dataset.footage)


@pytest.mark.real
def test_a_board_before_real_webcams_finds_the_one_that_lags(real_data: Path, tmp_path: Path) -> None:
    """Its own calibration takes the films as simultaneous; from so small a board the rest is open by degrees."""
    webcams = real_data / "caliscope_webcams"
    (tmp_path / "videos").mkdir()
    for film in sorted((webcams / "calibration_session").glob("*.mp4")):
        (tmp_path / "videos" / film.name).symlink_to(film)
    (tmp_path / "charuco.toml").write_bytes((webcams / "charuco.toml").read_bytes())
    found = read_calibration(open_dataset(tmp_path).calibration)
    given = {c.name: c.camera_from_world for c in read_calibration((webcams / "camera_array.toml",)).cameras}
    stated_deg = float(found.notes[0].split("±")[1].split("°")[0])
    both = {c.name: c.camera_from_world for c in found.cameras}, given
    off_deg = [
        np.degrees(angle(*((poses[a] @ np.linalg.inv(poses[b]))[:3, :3] for poses in both)))
        for a, b in combinations(given, 2)
    ]
    late_s = [float(note.split("film ")[1].split(" s")[0]) for note in found.notes[1:]]
    print(f"off by {min(off_deg):.1f} to {max(off_deg):.1f}°, stated ±{stated_deg:g}°; films late by {late_s} s")
    assert max(off_deg) < 1.2 * stated_deg
    assert int(np.argmax(np.abs(late_s))) == 1
    assert 0.06 < late_s[1] < 0.12
