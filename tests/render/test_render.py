# SPDX-License-Identifier: Apache-2.0
"""render: shots, the composite, and the output files of a shot."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.footage.streams import parallel_writers
from studiorecon.footage.video import read_frame, read_stack, write_lossless
from studiorecon.geometry.camera_path import scene_centre
from studiorecon.render import shot as render_shot
from studiorecon.render.composite import Composite, provenance_classes, to_millimetres
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.render.look_at_targets import LookAtTargets
from studiorecon.render.orbit import Orbit, orbit_azimuths, orbit_steps
from studiorecon.render.planning import smooth_dips
from studiorecon.render.room_light import Lamps, Light
from studiorecon.render.shading import build_shading
from studiorecon.render.shots import all_frames_path, film_times, look_at_pose
from studiorecon.render.statistics import LEDGER_COLUMNS
from studiorecon.report.sections.appendix import film_warnings
from studiorecon.scene.files import read_table
from studiorecon.scene.gaussians import Gaussians, concatenate, sh_from_rgb
from studiorecon.scene.path import PathStep, read_path
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.gaussians import with_colours
from tests.made.scene import FRAMES, WH, avatar, render_options, ring, room, write_scene
from tests.made.steps import call

ORBIT = Orbit(
    kind="orbit",
    frames=24,
    target="scene",
    radius=0.8,
    rise_m=0.0,
    zoom=1.0,
    turn_deg=360.0,
    start_deg=0.0,
    time="stretch",
)


def subjects(target_m: np.ndarray) -> LookAtTargets:
    return LookAtTargets({}, {}, {}, target_m, FRAMES, 15.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, root: Path) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root)
    return folder


@pytest.fixture
def settings(default_settings: Callable) -> render_shot.Settings:
    section = default_settings("render")
    section["shots"] = {
        "orbit": {**section["shots"]["orbit"], "frames": 8},
        "heldout": {"kind": "heldout"},
        "spiral": {"kind": "spiral"},
    }
    return settings_module.load(render_shot.Settings, section, "render")


def test_orbit_goes_once_around_inside_the_ring_and_looks_at_its_target() -> None:
    cameras = ring([10, 95, 185, 280], "cam")
    target = np.array([0.3, -0.2, 0.9])
    steps = orbit_steps(ORBIT, "orbit", cameras, subjects(target), WH, np.ones(24))
    eyes = np.array([s.camera.centre_m for s in steps])
    assert np.linalg.norm(eyes[:, :2], axis=1) == pytest.approx(0.8 * 2.4, abs=1e-5)
    assert eyes[:, 2] == pytest.approx(1.6)
    turned = np.unwrap(np.arctan2(eyes[:, 1], eyes[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(2 * np.pi * 23 / 24)
    for step in steps:
        pixel, depth = step.camera.project(target)
        assert pixel == pytest.approx((WH[0] / 2, WH[1] / 2), abs=1e-6)
        assert depth > 0
        assert step.camera.camera_from_world[0, 2] == pytest.approx(0, abs=1e-12), "the horizon is level"
        rotation = step.camera.camera_from_world[:3, :3]
        assert np.linalg.det(rotation) == pytest.approx(1)


def test_cameras_on_an_arc_are_not_orbited_beyond_it() -> None:
    cameras = ring([0, 40, 80, 120], "cam")
    angles = orbit_azimuths(ORBIT, cameras, scene_centre(cameras))
    assert np.degrees(angles.min()) >= -0.02
    assert np.degrees(angles.max()) == pytest.approx(120, abs=0.02)
    assert angles[0] == pytest.approx(0, abs=1e-3)
    assert abs(angles[-1] - angles[0]) < np.radians(3), "it comes back to where it began"


def test_an_oblong_ring_is_orbited_oblong() -> None:
    cameras = [*ring([0, 180], "far", 4.0), *ring([90, 270], "near", 2.0)]
    steps = orbit_steps(ORBIT, "orbit", cameras, subjects(np.array([0, 0, 1.0])), WH, np.ones(24))
    radius = np.array([np.linalg.norm(s.camera.centre_m[:2]) for s in steps])
    assert radius.max() == pytest.approx(3.2, abs=0.05)
    assert radius.min() == pytest.approx(1.6, abs=0.05)


def test_cameras_of_different_sizes_share_a_film_with_their_picture_at_the_top_left() -> None:
    wide, narrow = ring([0, 90], "cam")
    narrow = narrow.resized((WH[0] - 2, WH[1]))
    steps = all_frames_path([wide, narrow], 3)
    assert {step.camera.wh for step in steps} == {WH}
    point = np.array([[0.1, 0.2, 1.0]])
    np.testing.assert_array_equal(steps[-1].camera.project(point)[0], narrow.project(point)[0])


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("stretch", [0, 0.5, 1, 1.5, 2]),
        ("loop", [0, 1, 2, 0, 1]),
        ("swing", [0, 1, 2, 1, 0]),
        ("hold", [0, 0, 0, 0, 0]),
        (1.0, [1, 1, 1, 1, 1]),
        (9.0, [2, 2, 2, 2, 2]),
    ],
)
def test_time_advances_as_named_and_stays_inside_the_capture(kind: str | float, expected: list[float]) -> None:
    assert film_times(kind, 5, 3) == pytest.approx(expected)
    assert (film_times(kind, 5, 1) == 0).all()


def test_a_shot_leaves_pictures_depth_truth_and_path(scene: Path, settings: render_shot.Settings) -> None:
    options = render_options(scene, "heldout")
    call(render_shot.run, settings, **options)
    steps, fps = read_path(options["path"])
    assert [s.segment for s in steps] == ["view0"] * FRAMES + ["view1"] * FRAMES
    assert [s.frame for s in steps] == [*range(FRAMES)] * 2
    assert fps == 15.0
    # The footage was rendered from the same Gaussians, so the shot must reproduce it.
    assert np.abs(read_frame(options["video"], 2).astype(int) - read_frame(scene / "capture/view0.mkv", 2)).max() <= 1
    truth = read_stack(options["truth"])
    assert set(np.unique(truth)) == {0, 128, 255}
    depth = read_stack(options["depth"])
    assert depth.dtype == np.uint16
    rows = read_table(options["ledger"], LEDGER_COLUMNS)
    assert [(row["segment"], float(row["frame"])) for row in rows] == [(s.segment, s.frame) for s in steps]
    shares = np.array([[float(row[name]) for name in ("measured", "inferred", "invented")] for row in rows])
    assert shares.sum(axis=1) == pytest.approx(1, abs=2e-4)
    assert shares[:, 0] == pytest.approx((truth == 255).mean(axis=(1, 2)), abs=1e-4)
    assert float(rows[0]["angle_deg"]) == pytest.approx(45, abs=10), "held out half way between two training cameras"
    centre = depth[0, WH[1] // 2, WH[0] // 2]
    assert 1500 < centre < 2600, "the person stands about two metres in front of the camera"


def test_a_person_in_a_filled_frame_is_not_called_measured(scene: Path, settings: render_shot.Settings) -> None:
    options = render_options(scene, "heldout")
    call(render_shot.run, settings, **options)
    last = FRAMES - 1
    away = np.abs(read_frame(options["depth"], last).astype(int) - read_frame(options["depth"], 0)) > 300
    near = away & (read_frame(options["depth"], last) < 2700)
    assert near.sum() > 30, "the person is where nobody was in the first frame"
    assert (read_frame(options["truth"], last)[near] == 255).mean() < 0.1


def test_the_same_inputs_give_the_same_bytes(scene: Path, settings: render_shot.Settings) -> None:
    options = render_options(scene, "orbit")
    contents = []
    for _ in range(2):
        call(render_shot.run, settings, **options)
        contents.append([options[name].read_bytes() for name in ("video", "truth", "depth", "path", "ledger")])
    assert contents[0] == contents[1]


@pytest.mark.parametrize(("shot", "sentence"), [("dolly", "no shot 'dolly'"), ("spiral", "kind 'spiral'")])
def test_unknown_shots_are_refused(scene: Path, settings: render_shot.Settings, shot: str, sentence: str) -> None:
    with pytest.raises(UserError, match=sentence):
        call(render_shot.run, settings, **render_options(scene, shot))
    assert not (scene / f"render/{shot}.mkv").exists()


def test_provenance_of_another_background_is_refused(
    scene: Path, settings: render_shot.Settings, tmp_path: Path
) -> None:
    np.savez(tmp_path / "other.npz", provenance=np.zeros(3, np.uint8))
    with pytest.raises(UserError, match=r"other\.npz .*provenance .*N = "):
        call(render_shot.run, settings, **{**render_options(scene, "orbit"), "provenance": tmp_path / "other.npz"})


def flat(points: np.ndarray, rgb: np.ndarray) -> Gaussians:
    count = len(points)
    return Gaussians(
        points,
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full((count, 3), np.log(0.3)),
        np.full(count, 6.0),
        sh_from_rgb(rgb)[:, None],
    )


def test_nothing_reconstructed_shows_the_background_colour_and_counts_as_invented() -> None:
    camera = ring([0], "cam")[0]
    scene = Composite(flat(np.array([[0.0, 0, 1.0]]), np.full((1, 3), 0.5)), np.zeros(1, np.uint8), [])
    rgb, truth, depth = render_shot.draw_step(
        CompositeRenderer(scene, 0.2), PathStep(camera, 0.0, "00"), (1.0, 0.0, 0.0)
    )
    assert rgb[0, 0].tolist() == [255, 0, 0]
    assert (truth[0, 0], depth[0, 0]) == (0, 0)
    assert truth[WH[1] // 2, WH[0] // 2] == 255


def test_the_canvas_draws_what_rasterising_everything_together_draws(root: Path) -> None:
    rng = np.random.default_rng(0)
    body = BodyModel.load(root / "resources/body.npz")
    static = room(rng, 0.2).take(np.arange(1003))  # not a whole number of blocks
    scene = Composite(
        static, rng.integers(0, 3, static.count).astype(np.uint8), [avatar(body, rng, "p0"), avatar(body, rng, "p1")]
    )
    canvas, camera = CompositeRenderer(scene, 0.2), ring([30], "cam")[0]
    for frame in (0.0, 3.5, FRAMES - 1.0):
        gaussians = concatenate([static, *(person.posed(frame) for person in scene.people)])
        classes = np.concatenate([scene.classes, *(provenance_classes(person, frame) for person in scene.people)])
        rendering, shares = canvas.draw(camera, frame, (0.1, 0.2, 0.3))
        expected = Rasteriser(near_m=0.2).forward(gaussians, camera, (0.1, 0.2, 0.3))
        np.testing.assert_array_equal(rendering.rgb, expected.rgb)
        np.testing.assert_array_equal(rendering.depth_m, expected.depth_m)
        coloured = Rasteriser(near_m=0.2).forward(with_colours(gaussians, np.eye(3)[classes]), camera)
        np.testing.assert_allclose(shares, coloured.rgb, atol=1e-6)


def test_a_picture_does_not_depend_on_those_drawn_before_it(root: Path) -> None:
    """State that persists between pictures: poses, classes of measured and interpolated frames, shade."""
    rng = np.random.default_rng(0)
    person = avatar(BodyModel.load(root / "resources/body.npz"), rng, "p0")
    static, lamp = room(rng, 0.2), Lamps(np.array([[0.5, 0.5, 2.5]]), np.array([[0, 0, -1.0]]), np.array([0.3]))
    light = Light(True, "", lamp, np.array([0.6]), np.array([0.16]), 0.1, 0.1, 0.1, 0.0)
    scene = Composite(
        static, np.zeros(static.count, np.uint8), [person], build_shading(light, static, [person], [person])
    )
    assert scene.shading is not None
    camera, used = ring([30], "cam")[0], CompositeRenderer(scene, 0.2)
    for frame in (FRAMES - 1.0, 0.0, 2.5, 2.5, FRAMES - 1.0):
        drawn, shares = used.draw(camera, frame, (0, 0, 0))
        alone, of_alone = CompositeRenderer(scene, 0.2).draw(camera, frame, (0, 0, 0))
        np.testing.assert_array_equal(drawn.rgb, alone.rgb)
        np.testing.assert_array_equal(shares, of_alone)
    unshaded = CompositeRenderer(replace(scene, shading=None), 0.2).draw(camera, 0.0, (0, 0, 0))[0]
    assert np.abs(unshaded.rgb - CompositeRenderer(scene, 0.2).draw(camera, 0.0, (0, 0, 0))[0].rgb).max() > 0.1


def test_depth_in_millimetres_keeps_unknown_and_saturates() -> None:
    depth = np.array([[0.0, 1.2345, 70.0, np.nan, np.inf]])
    assert to_millimetres(depth).tolist() == [[0, 1234, 65535, 0, 65535]]


def test_an_orbit_through_a_wall_is_shrunk_until_it_is_clear(scene: Path, settings: render_shot.Settings) -> None:
    wide = {"orbit": {**settings.shots["orbit"], "radius": 1.2}}
    options = render_options(scene, "orbit")
    call(
        render_shot.run,
        settings_module.load(render_shot.Settings, {**vars(settings), "shots": wide}, "render"),
        **options,
    )
    radius = max(np.linalg.norm(step.camera.centre_m[:2]) for step in read_path(options["path"])[0])
    assert 2.0 < radius < 2.75, "the walls stand 3 m away and 0.3 m must stay clear"


def test_a_path_through_a_person_and_a_wall_is_warned_about(
    scene: Path, settings: render_shot.Settings, root: Path
) -> None:
    """A planted path: clear of everything, into the head of a person, into a wall, out of the room."""
    options = render_options(scene, "planted")
    person = read_avatar(options["gaussians"][0], options["avatars"][0], BodyModel.load(root / "resources/body.npz"))
    head = person.joints_m(2.0)[15]
    frames = []
    for eye in (np.array([1.5, -1.5, 1.5]), head, np.array([2.95, 0, 1.3]), np.array([5.0, 0, 1.3])):
        world_from_camera = np.linalg.inv(look_at_pose(eye, np.array([0.0, 0.05, 1.0])))
        pose = world_from_camera @ np.diag([1.0, -1, -1, 1])
        frames.append({"transform_matrix": pose.tolist(), "frame": 2})
    file = scene / "planted.json"
    file.write_text(json.dumps({"fl_x": 60, "w": 96, "h": 64, "frames": frames}))
    shots = {"planted": {"kind": "path", "file": str(file), "time": "hold"}}
    call(
        render_shot.run,
        settings_module.load(render_shot.Settings, {**vars(settings), "shots": shots}, "render"),
        **options,
    )
    rows = read_table(options["ledger"], LEDGER_COLUMNS)
    assert [row["near"] for row in rows] == ["", "p0", "background", ""]
    reported = [sentence for _, sentence in film_warnings([options["ledger"]], 0.5, 60.0)]
    assert "shot planted passes through p0 in 1 of 4 pictures (1)" in reported
    assert "shot planted passes through walls or furniture in 1 of 4 pictures (2)" in reported
    assert any("shows less than 50 % measured surfaces" in s for s in reported), (
        "from outside the walls' backs are seen, or nothing"
    )


def test_a_dip_in_the_radius_is_smooth_and_deep_enough() -> None:
    factors = np.ones(120)
    factors[[0, 1, 60]] = 0.7, 0.7, 0.8
    smooth = smooth_dips(factors)
    assert (smooth <= factors + 1e-12).all()
    assert smooth[[30, 90]] == pytest.approx(1.0)
    assert np.abs(np.diff(smooth, append=smooth[0])).max() < 0.06
    assert smooth_dips(np.array([0.9])) == pytest.approx(0.9)


def test_a_failing_maker_leaves_no_video(tmp_path: Path) -> None:
    def fail_after_two_frames() -> None:
        with parallel_writers([lambda frames: write_lossless(tmp_path / "a.mkv", frames, 10.0)]) as put:
            put(np.zeros((16, 16), np.uint8))
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail_after_two_frames()
    assert list(tmp_path.iterdir()) == []


def test_a_failing_writer_stops_the_maker(tmp_path: Path) -> None:
    def broken(frames: object) -> None:
        raise OSError("disk full")

    def make() -> None:
        with parallel_writers([broken, lambda frames: write_lossless(tmp_path / "b.mkv", frames, 10.0)]) as put:
            for _ in range(1000):
                put(np.zeros((16, 16), np.uint8), np.zeros((16, 16), np.uint8))

    with pytest.raises(OSError, match="disk full"):
        make()
    assert list(tmp_path.iterdir()) == []
