# SPDX-License-Identifier: Apache-2.0
"""humans.objects: a board that tumbles, of two colours and with outlines that tell, and things of which nothing tells that they turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon import settings as settings_module
from studiorecon.errors import Refusal
from studiorecon.geometry import rotations
from studiorecon.humans.objects import Settings, View, objects_in, rested
from studiorecon.humans.turning import NEVER_DB
from studiorecon.masks.things import without_things
from studiorecon.scene.camera import Camera
from studiorecon.scene.objects import MEASURED_TURNS, NO_TURNS, RigidObject, read_objects, write_objects
from studiorecon.splatting.rasterise import Rasteriser

from tests.stages.test_humans_objects import CAMERAS, FPS, FRAMES, UNSEEN, WH, Ball, bouncing, drawn, nobody, plate_of

HALF_M = np.array([0.24, 0.09, 0.045])
COLOURS = np.array([[0.8, 0.15, 0.1], [0.15, 0.25, 0.75]], np.float32)


@dataclass(frozen=True)
class Board:
    """A board of two colours, one at each end, along ``path_m`` (T, 3), turned by ``world_from_board`` (T, 3, 3)."""

    path_m: np.ndarray
    world_from_board: np.ndarray
    half_m: tuple[float, float, float] = tuple(HALF_M)

    def over(self, camera: Camera, picture: np.ndarray, frame: int) -> np.ndarray:
        """The picture (H, W, 3) with the board, one ray a pixel."""
        turn = self.world_from_board[frame]
        origin, rays = camera.rays()
        start, along = (origin - self.path_m[frame]) @ turn, rays @ turn
        half = np.array(self.half_m)
        with np.errstate(divide="ignore"):
            low, high = (-half - start) / along, (half - start) / along
            near, far = np.minimum(low, high), np.maximum(low, high)
        enters, leaves = near.max(axis=-1), far.min(axis=-1)
        point = start + enters[..., None] * along
        return np.where((enters < leaves)[..., None], COLOURS[(point[..., 0] > 0).astype(int)], picture)


def tumbling(frames: int = FRAMES) -> Board:
    """A board thrown through the room that turns by 150° about a slanted axis and by 60° about the vertical one."""
    phase = np.linspace(0, 1, frames)
    axis = np.array([0.35, 0.9, 0.25])
    tilt = rotations.exp(np.radians(150) * (phase + 0.06 * np.sin(6 * phase))[:, None] * axis / np.linalg.norm(axis))
    spin = rotations.exp(np.radians(60) * phase[:, None] * [0, 0, 1.0])
    path = np.stack([np.linspace(-0.6, 0.6, frames), np.full(frames, 0.1), 0.6 + 2.4 * phase * (1 - phase)], axis=1)
    return Board(path, spin @ tilt @ rotations.exp(np.array([0.3, -0.4, 0.2])))


def shown(board: Board, camera: Camera, frame: int) -> np.ndarray:
    """(H, W, 3) uint8 picture, four rays a pixel, with noise of one grey level."""
    fine = camera.resized((2 * WH[0], 2 * WH[1]))
    picture = board.over(fine, cv2.resize(plate_of(camera), fine.wh, interpolation=cv2.INTER_NEAREST), frame)
    small = cv2.resize(picture.astype(np.float32), WH, interpolation=cv2.INTER_AREA) * 255
    noise = np.random.default_rng([3, frame, CAMERAS.index(camera) if camera in CAMERAS else 9]).normal(0, 1, small.shape)
    return np.clip(np.rint(small + noise), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def settings(default_settings: Callable) -> Settings:
    loaded = settings_module.load(Settings, default_settings("humans"), "humans")
    return replace(loaded, objects=replace(loaded.objects, shape=replace(loaded.objects.shape, gaussians=400, iterations=200)))


def found(settings: Settings, pictured: Callable[[Camera, int], np.ndarray]) -> list[RigidObject]:
    moments = [([pictured(c, frame) for c in CAMERAS], [nobody(c, frame) for c in CAMERAS]) for frame in range(FRAMES)]
    views = [View(c, Path(), plate_of(c), np.ones(c.hw, bool), np.zeros(c.hw, np.float32)) for c in CAMERAS]
    return objects_in(iter(moments), rested(views, iter(moments), settings.objects.loose), FRAMES, FPS, settings.objects, 1)


def pictured(camera: Camera, frame: int) -> np.ndarray:
    return shown(tumbling(), camera, frame)


@pytest.fixture(scope="module")
def tumbled(settings: Settings) -> RigidObject:
    (thing,) = found(settings, pictured)
    return thing


def turn_errors_deg(thing: RigidObject, board: Board) -> np.ndarray:
    """(T,) degrees between true and found turns; which way the thing's own axes lie is its own affair."""
    board_from_object, _ = rotations.mean(np.swapaxes(board.world_from_board, 1, 2)[thing.valid] @ thing.world_from_object[thing.valid])
    return np.degrees(rotations.angle(board.world_from_board @ board_from_object, thing.world_from_object))


def test_a_tumbling_board_is_followed_in_place_and_turn(tumbled: RigidObject) -> None:
    board = tumbling()
    assert tumbled.turns == MEASURED_TURNS
    assert tumbled.valid.sum() >= FRAMES - 2
    error_deg = turn_errors_deg(tumbled, board)[tumbled.valid]
    assert np.median(error_deg) < 3
    assert error_deg.max() < 8
    assert np.median(np.linalg.norm(tumbled.centres_m - board.path_m, axis=1)[tumbled.valid]) < 0.01


def seen_db(thing: RigidObject | None, pictured: Callable[[Camera, int], np.ndarray]) -> float:
    """PSNR in what the thing truly covers at a camera that nobody has, over every third picture."""
    squares, count = 0.0, 0
    for frame in range(1, FRAMES, 3):
        truth, made = pictured(UNSEEN, frame) / 255, plate_of(UNSEEN)
        mask = np.abs(truth - made).max(axis=-1) > 0.1
        if thing is not None:
            picture = Rasteriser(near_m=0.05, threads=1).forward(thing.posed(frame), UNSEEN)
            made = picture.rgb + (1 - picture.alpha[..., None]) * made
        squares += float(np.square(made - truth)[mask].sum())
        count += 3 * int(mask.sum())
    return -10 * np.log10(squares / count)


def test_a_thing_that_turns_looks_better_for_it(settings: Settings, tumbled: RigidObject, capsys: pytest.CaptureFixture) -> None:
    never = replace(settings, objects=replace(settings.objects, turn=replace(settings.objects.turn, gain_db=NEVER_DB)))
    (still,) = found(never, pictured)
    assert still.turns == NO_TURNS
    assert (still.world_from_object == np.eye(3)).all()
    assert "not determined" in capsys.readouterr().out
    assert seen_db(tumbled, pictured) > seen_db(still, pictured) + 4


@pytest.mark.parametrize("colours", [((0.8, 0.15, 0.1), (0.8, 0.15, 0.1)), ((0.8, 0.15, 0.1), (0.9, 0.85, 0.2))], ids=["plain", "halved"])
def test_of_a_ball_nothing_tells_that_it_turns(settings: Settings, colours: tuple) -> None:
    """Of one colour nothing could; of two, which do not turn, nothing does."""
    (ball,) = found(settings, lambda camera, frame: drawn(camera, [Ball(bouncing(), colours=colours)], frame))
    assert ball.turns == NO_TURNS
    assert (ball.world_from_object == np.eye(3)).all()
    error_m = np.linalg.norm(ball.centres_m - bouncing(), axis=1)[ball.valid]
    assert np.median(error_m) < 0.006


def test_a_turned_things_own_outline_is_nobodys(tumbled: RigidObject) -> None:
    board = tumbling()
    for frame in (2, 10, 20):
        camera = CAMERAS[1]
        truth = np.abs(board.over(camera, np.zeros((*camera.hw, 3)), frame)).max(axis=-1) > 0
        outline = tumbled.outline(camera, frame, 1.15) > 0
        assert outline[truth].mean() > 0.95
        assert truth[outline].mean() > 0.55, "it is no sphere of that reach"
        labels = without_things(np.ones(camera.hw, np.uint8), [tumbled], np.zeros((1, *camera.hw), np.float32), camera, frame)
        assert ((labels == 255) == outline).all()


def test_a_turned_thing_looks_as_from_a_turned_camera(tumbled: RigidObject) -> None:
    """Means, discs and colours that depend on the view turn together."""
    rng = np.random.default_rng(0)
    glossy = np.concatenate([tumbled.gaussians.sh, rng.normal(0, 0.1, (tumbled.gaussians.count, 8, 3))], axis=1)
    thing = replace(tumbled, gaussians=replace(tumbled.gaussians, sh=glossy))
    for frame in (3, 11.5):
        camera_from_object = UNSEEN.camera_from_world @ thing.pose_at(frame)
        from_it = replace(UNSEEN, camera_from_world=camera_from_object)
        drawing = Rasteriser(near_m=0.05, threads=1)
        there, here = drawing.forward(thing.posed(frame), UNSEEN), drawing.forward(thing.gaussians, from_it)
        assert there.alpha.max() > 0.9
        np.testing.assert_allclose(there.rgb, here.rgb, atol=2e-3)


def test_between_frames_a_thing_is_between_its_turns(tumbled: RigidObject) -> None:
    first, second = tumbled.world_from_object[4:6]
    whole = rotations.angle(first, second)
    assert whole > np.radians(3)
    assert rotations.angle(first, tumbled.turn_at(4.25)) == pytest.approx(whole / 4, rel=1e-3)


def test_turns_survive_their_file_and_an_older_file_is_refused(tumbled: RigidObject, tmp_path: Path) -> None:
    write_objects(tmp_path / "objects.npz", [tumbled], FRAMES)
    (again,) = read_objects(tmp_path / "objects.npz")
    assert again.turns == MEASURED_TURNS
    np.testing.assert_array_equal(again.world_from_object, tumbled.world_from_object)
    with np.load(tmp_path / "objects.npz") as data:
        np.savez(tmp_path / "older.npz", **{name: data[name] for name in data.files if not name.endswith("turns")})
    with pytest.raises(Refusal, match="does not say how o0 turns"):
        read_objects(tmp_path / "older.npz")
