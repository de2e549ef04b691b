# SPDX-License-Identifier: Apache-2.0
"""objects.find: balls that fly, are held and are hidden, before walls whose every colour is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.video import write_lossless
from studiorecon.objects.find import ObjectView, Settings, add_typical_difference, find_objects, run
from studiorecon.objects.residual import (
    LOOSE,
    ROOM,
    UNKNOWN,
    loose_regions,
    pixel_states,
    shadow_free_difference,
    typical_difference,
)
from studiorecon.objects.rotation import NEVER_DB
from studiorecon.objects.sightings import find_sightings
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.factors import write_factors
from studiorecon.scene.provenance import MEASURED
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.rigid_object import RigidObject, read_objects

from tests.made.objects import (  # noqa: F401
    CAMERAS,
    FPS,
    FRAMES,
    RADIUS_M,
    UNSEEN,
    WH,
    Ball,
    around,
    bouncing,
    drawn,
    nobody,
    plate_of,
)

Hidden = Callable[[Camera, int], np.ndarray]


def moments(
    balls: list[Ball], hidden: Hidden, showing: tuple[str, ...]
) -> Iterator[tuple[list[np.ndarray], list[np.ndarray]]]:
    for frame in range(FRAMES):
        people = [hidden(camera, frame) for camera in CAMERAS]
        pictures = [drawn(camera, balls if camera.name in showing else [], frame) for camera in CAMERAS]
        # A person is of one colour, before the ball.
        yield [np.where(p[..., None], np.uint8((60, 60, 160)), rgb) for p, rgb in zip(people, pictures)], people


@pytest.fixture(scope="module")
def settings(default_settings: Callable) -> Settings:
    loaded = settings_module.load(Settings, default_settings("objects"), "objects")
    # That things turn is another file's subject.
    turn, shape = (replace(loaded.turn, gain_db=NEVER_DB), replace(loaded.shape, gaussians=300, iterations=150))
    return replace(loaded, turn=turn, shape=shape)


def found(
    settings: Settings, balls: list[Ball], hidden: Hidden = nobody, showing: tuple[str, ...] = ("c0", "c1", "c2", "c3")
) -> list[RigidObject]:
    views = [ObjectView(c, Path(), plate_of(c), np.ones(c.hw, bool), np.zeros(c.hw, np.float32)) for c in CAMERAS]
    seen = list(moments(balls, hidden, showing))
    return find_objects(iter(seen), add_typical_difference(views, iter(seen), settings.loose), FRAMES, FPS, settings, 1)


@pytest.fixture(scope="module")
def thrown(settings: Settings) -> RigidObject:
    (ball,) = found(settings, [Ball(bouncing())])
    return ball


def test_a_thrown_ball_is_followed_to_the_centimetre(thrown: RigidObject) -> None:
    assert thrown.valid.sum() >= FRAMES - 2
    error_m = np.linalg.norm(thrown.centres_m - bouncing(), axis=1)[thrown.valid]
    assert np.median(error_m) < 0.006
    assert error_m.max() < 0.02
    assert thrown.radius_m == pytest.approx(RADIUS_M, rel=0.1)


def test_a_thrown_ball_looks_like_itself_from_where_no_camera_was(thrown: RigidObject) -> None:
    frame = 9
    truth = drawn(UNSEEN, [Ball(bouncing())], frame).astype(float) / 255
    empty = plate_of(UNSEEN)
    picture = Rasteriser(near_m=0.05, threads=1).forward(thrown.posed(frame), UNSEEN)
    made = picture.rgb + (1 - picture.alpha[..., None]) * empty
    shown = np.abs(truth - empty).max(axis=-1) > 0.1
    assert 100 < shown.sum() < 1000
    db = [-10 * np.log10(np.square(p - truth)[shown].mean()) for p in (made, empty)]
    assert db[0] > db[1] + 8
    assert (thrown.provenance == MEASURED).mean() > 0.7


def test_nothing_is_found_where_nothing_is(settings: Settings, capsys: pytest.CaptureFixture) -> None:
    assert found(settings, []) == []
    assert "films show none" in capsys.readouterr().out


def test_what_one_camera_sees_has_no_place(settings: Settings, capsys: pytest.CaptureFixture) -> None:
    assert found(settings, [Ball(bouncing())], showing=("c1",)) == []
    assert "c1: in" in (reported := capsys.readouterr().out)
    assert "no second camera confirms" in reported


def test_a_thing_that_stands_still_belongs_on_the_plate(settings: Settings, capsys: pytest.CaptureFixture) -> None:
    assert found(settings, [Ball(np.tile([0.2, 0.1, 0.7], (FRAMES, 1)))]) == []
    assert "does not move" in capsys.readouterr().out


def hand(camera: Camera, frame: int) -> np.ndarray:
    """Somebody's arm over a third of the ball from frame 8 to 13, in every camera, and all of it in frames 14 and
    15."""
    covered = np.zeros(camera.hw, np.uint8)
    if 8 <= frame < 16:
        pixel, depth_m = camera.project(bouncing()[frame])
        reach = RADIUS_M * camera.focal_px[0] / depth_m
        below = (-0.45 if frame < 14 else 1.5) * reach
        corners = pixel + np.array([[-2.5 * reach, -3 * reach], [2.5 * reach, below]])
        cv2.rectangle(covered, *(tuple(map(round, corner.tolist())) for corner in corners), 1, -1)
    return covered > 0


def test_a_held_ball_is_followed_by_what_the_hand_leaves_of_it(settings: Settings) -> None:
    (ball,) = found(settings, [Ball(bouncing())], hidden=hand)
    error_m = np.linalg.norm(ball.centres_m - bouncing(), axis=1)
    assert ball.valid[8:14].sum() >= 4, "two thirds of it are seen"
    assert error_m[8:14][ball.valid[8:14]].max() < 0.04
    assert not ball.valid[14:16].any()
    assert ball.present[14:16].all(), "a short gap is filled"
    assert ball.radius_m == pytest.approx(RADIUS_M, rel=0.1)


def test_a_ball_that_is_gone_for_long_is_left_out_not_guessed(settings: Settings) -> None:
    def wall(camera: Camera, frame: int) -> np.ndarray:
        return np.full(camera.hw, frame >= 14)

    (ball,) = found(settings, [Ball(bouncing())], hidden=wall)
    assert ball.present[:14].sum() >= 12
    assert not ball.present[14:].any()
    drawing = Rasteriser(near_m=0.05, threads=1)
    assert drawing.forward(ball.posed(5), UNSEEN).alpha.max() > 0.5
    assert drawing.forward(ball.posed(20), UNSEEN).alpha.max() == 0
    assert np.isfinite(ball.posed(20).means_m).all()
    assert ball.posed(20).count == ball.posed(5).count


def test_two_balls_are_two_things(settings: Settings) -> None:
    other = Ball(bouncing(y_m=-0.7)[::-1] + np.array([0, 0, 0.15]), 0.16, ((0.1, 0.2, 0.8), (0.1, 0.7, 0.3)))
    things = found(settings, [Ball(bouncing(y_m=0.6)), other])
    assert len(things) == 2
    for thing, ball in zip(sorted(things, key=lambda t: t.radius_m), (Ball(bouncing(y_m=0.6)), other)):
        error_m = np.linalg.norm(thing.centres_m - ball.path_m, axis=1)[thing.valid]
        assert np.median(error_m) < 0.01
        assert error_m.max() < 0.04
        assert thing.radius_m == pytest.approx(ball.radius_m, rel=0.12)


def test_shadows_and_people_are_nothing_loose(settings: Settings) -> None:
    camera, plate = CAMERAS[0], plate_of(CAMERAS[0])
    picture = plate.copy()
    picture[20:40, 20:60] *= 0.7
    picture[60:90, 100:130] = (0.9, 0.1, 0.1)
    person = np.zeros(camera.hw, bool)
    person[50:100, 120:150] = True
    differing = shadow_free_difference(np.rint(picture * 255).astype(np.uint8), plate, settings.loose)
    state = pixel_states(differing, 0 * differing, np.ones(camera.hw, bool), person, settings.loose)
    assert (state[22:38, 22:58] == ROOM).all(), "a shadow changes no colour"
    assert (state[person] == UNKNOWN).all()
    assert (state[62:88, 102:118] == LOOSE).all()
    (region,) = loose_regions(np.zeros((*camera.hw, 3), np.uint8), state, 0, settings.loose.min_share)
    assert not region.free, "a person touches it"
    assert region.outline_px[:, 0].max() < 120, "where the person begins is not its outline"


def test_what_always_differs_is_the_plates_fault(settings: Settings) -> None:
    loose = settings.loose
    patterned, ball = np.zeros((20, 20), np.float32), np.zeros((20, 20), np.float32)
    patterned[5:10] = 1.4 * loose.difference
    ball[5:15, 5:15] = 5 * loose.difference
    nobody_there, somebody = np.zeros((20, 20), bool), np.ones((20, 20), bool)
    usual = typical_difference([patterned, patterned, ball], [nobody_there] * 3)
    assert (usual == patterned).all(), "a thing is there for a moment only"
    state = pixel_states(patterned + ball, usual, ~nobody_there, nobody_there, loose)
    assert (state[:, :5] == ROOM).all()
    assert (state[6:14, 6:14] == LOOSE).all()
    assert (typical_difference([ball], [somebody]) == 0).all()
    stands = pixel_states(
        ball, typical_difference([ball, ball], [nobody_there] * 2), ~nobody_there, nobody_there, loose
    )
    assert (stands[7:13, 7:13] == LOOSE).all(), "what differs by far stood there"


def test_cameras_that_see_the_room_deny_a_chance_meeting_of_rays(settings: Settings) -> None:
    balls = [Ball(np.tile([0.5, 0.0, 0.9], (FRAMES, 1))), Ball(np.tile([0.0, 0.5, 0.9], (FRAMES, 1)))]
    o = settings
    pictures = [drawn(c, balls, 0) for c in CAMERAS]
    away = np.zeros(WH[::-1], bool)
    shown = [
        pixel_states(shadow_free_difference(p, plate_of(c), o.loose), np.zeros(c.hw), ~away, away, o.loose)
        for p, c in zip(pictures, CAMERAS)
    ]
    loose = [loose_regions(p, s, v, o.loose.min_share) for v, (p, s) in enumerate(zip(pictures, shown))]
    things = find_sightings(CAMERAS, shown, loose, o.gate_m, o.radius_m)
    places = sorted((tuple(np.round(t.centre_m, 1)) for t in things), reverse=True)
    assert places == [(0.5, 0.0, 0.9), (0.0, 0.5, 0.9)]


def test_the_step_divides_gains_and_light_out(settings: Settings, tmp_path: Path) -> None:
    """Files in, file out: a camera of its own gain, and light that grows, give the same colours as a capture
    without."""
    course = np.linspace(0.85, 1.1, FRAMES)
    write_model(tmp_path / "model", CAMERAS)
    footage = tuple(
        Footage(c.name, False, WH, c.intrinsics.tolist(), FPS, FRAMES, 0, f"{c.name}.mp4", "", WH, 0, 0.0, [])
        for c in CAMERAS
    )
    write_manifest(tmp_path / "manifest.json", Manifest("made", FPS, FRAMES, footage))
    write_factors(tmp_path / "gains.json", {"c1": np.array([[1.2, 1.2, 1.2]])})
    write_factors(tmp_path / "brightness.json", {c.name: course[:, None].repeat(3, axis=1) for c in CAMERAS})
    made = {}
    for name, gain, light in (("plain", 1.0, np.ones(FRAMES)), ("faulty", 1.2, course)):
        for camera in CAMERAS:
            own = gain if camera.name == "c1" else 1.0
            films = (
                np.clip(np.rint(drawn(camera, [Ball(bouncing())], t) * own * light[t]), 0, 255) for t in range(FRAMES)
            )
            write_lossless(tmp_path / f"{name}-{camera.name}.mkv", (film.astype(np.uint8) for film in films), FPS)
            plate = np.clip(np.rint(plate_of(camera) * own * 255), 0, 255).astype(np.uint8)
            cv2.imwrite(str(tmp_path / f"{name}-{camera.name}.png"), plate[..., ::-1])
        videos, plates = ([tmp_path / f"{name}-{c.name}.{end}" for c in CAMERAS] for end in ("mkv", "png"))
        factors = (
            {}
            if name == "plain"
            else {"gains": [tmp_path / "gains.json"], "brightness": [tmp_path / "brightness.json"]}
        )
        out = tmp_path / f"{name}.npz"
        run(
            settings,
            tmp_path / "model/images.txt",
            tmp_path / "manifest.json",
            videos,
            plates,
            [],
            None,
            1,
            out,
            **factors,
        )
        (made[name],) = read_objects(out)
    plain, faulty = made["plain"], made["faulty"]
    assert np.linalg.norm(plain.centres_m - faulty.centres_m, axis=1).max() < 0.01
    assert np.abs(plain.gaussians.sh[:, 0].mean(axis=0) - faulty.gaussians.sh[:, 0].mean(axis=0)).max() < 0.1


def test_between_frames_a_thing_is_between_its_places(thrown: RigidObject) -> None:
    whole = replace(thrown, centres_m=bouncing(), valid=np.ones(FRAMES, bool), present=np.ones(FRAMES, bool))
    np.testing.assert_allclose(whole.centre_at(4.25), 0.75 * bouncing()[4] + 0.25 * bouncing()[5])
    gone = replace(whole, present=np.arange(FRAMES) < 5)
    np.testing.assert_array_equal(gone.centre_at(4.4), bouncing()[4])
    assert gone.centre_at(4.6) is None
    assert whole.centre_at(99.0) is not None, "a film may hold the end"
