# SPDX-License-Identifier: Apache-2.0
"""render.light and the shade of films: planted lamps are recovered, and no light is estimated without shadows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.capsules import build_occluder
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.geometry.rotations import exp
from studiorecon.images.plate import write_plate
from studiorecon.render import light as render_light
from studiorecon.render import shot as render_shot
from studiorecon.render.area_lights import lamp_patches
from studiorecon.render.occlusion import body_proximity, hidden_shares, hidden_sky_share, sky_discs
from studiorecon.render.room_light import Lamps, Light, read_light, write_light
from studiorecon.render.shading import build_shading, dim_gaussians, robust_mode, upward_share
from studiorecon.scene.gaussians import SH_C0, Gaussians, sh_from_rgb
from studiorecon.scene.people import Person
from studiorecon.scene.room import Platform, RoomBox, write_room
from studiorecon.splatting.conventions import SH
from studiorecon.splatting.cpu.blocks import block
from studiorecon.splatting.discs import make_discs
from studiorecon.splatting.rigid_object import RigidObject

from tests.made.fitted import fitted_person
from tests.made.scene import avatar, render_options, ring, room, write_scene
from tests.made.steps import call

ROOM_BOX = RoomBox(0.0, np.array([-3.0, -3.0, 0.0]), np.array([3.0, 3.0, 2.8]), np.ones(6, bool), np.ones(6))
LAMP_M, LAMP_HALF_M, LAMP_SHARE = np.array([-1.2, 0.9, 2.8]), 0.3, 0.5
MOMENTS = 16


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources/body.npz")


@pytest.fixture
def settings(default_settings: Callable) -> render_light.LightSettings:
    return settings_module.load(render_light.Settings, default_settings("render"), "render").light


def walking(body: BodyModel, frames: int = MOMENTS) -> Avatar:
    """A person who crosses the room along x, then y."""
    person = avatar(body, np.random.default_rng(0), "p0", frames)
    half = frames // 2
    across = np.linspace(-1.3, 1.3, half), np.linspace(-1.3, 1.3, frames - half)
    trans = person.trans.copy()
    trans[:half, 0], trans[half:, 0] = across[0], 0.3
    trans[:half, 1], trans[half:, 1] = -0.2, across[1]
    return replace(person, trans=trans, valid=np.ones(frames, bool))


def capsules(person: Avatar) -> list[np.ndarray]:
    shape = build_occluder(person.model, person.betas)
    return [shape.posed(t) for t in person.model.joint_transforms(person.poses, person.betas, person.trans)]


def floor_grid(step_m: float = 0.2) -> np.ndarray:
    x, y = (g.ravel() for g in np.meshgrid(*[np.arange(-2.2, 2.21, step_m)] * 2))
    return np.stack([x, y, 0 * x], axis=1)


def sampled_shade(points: np.ndarray, body: np.ndarray) -> np.ndarray:
    """(N,) hidden share of the planted lamp by brute force: 25 points on a square, hard rays, sampled every 3 cm."""
    spots = np.linspace(-LAMP_HALF_M, LAMP_HALF_M, 5)
    blocked = np.zeros(len(points))
    low, high = np.minimum(body[:, :3], body[:, 3:6]).min(0) - 0.3, np.maximum(body[:, :3], body[:, 3:6]).max(0) + 0.3
    for dx in spots:
        for dy in spots:
            lamp = LAMP_M + np.array([dx, dy, 0])
            along = np.linspace(0, 1, 90)[None, :, None]
            ray = points[:, None] + along * (lamp - points)[:, None]
            inside = ((ray > low) & (ray < high)).all(-1)
            row, at = np.nonzero(inside)
            a, b, r = body[:, :3], body[:, 3:6], body[:, 6]
            q = ray[row, at]
            share = np.einsum("ncx,cx->nc", q[:, None] - a, b - a) / np.maximum(((b - a) ** 2).sum(-1), 1e-9)
            near = np.linalg.norm(q[:, None] - a - share.clip(0, 1)[..., None] * (b - a), axis=-1) < r
            hit = np.zeros(len(points), bool)
            hit[row[near.any(1)]] = True
            blocked += hit
    return blocked / 25


@pytest.fixture(scope="module")
def planted(body: BodyModel) -> tuple[np.ndarray, np.ndarray, list[list[np.ndarray]]]:
    """Floor points, their ratio to the unshaded floor (P, T) under the planted lamp, with noise, and the bodies."""
    points, bodies = floor_grid(), [[b] for b in capsules(walking(body))]
    shade = np.stack([sampled_shade(points, b[0]) for b in bodies], axis=1)
    assert (shade > 0.5).any(axis=0).all(), "there is a shadow at every moment"
    cosine = np.square(LAMP_M[2]) / ((points - LAMP_M) ** 2).sum(-1)
    falloff = cosine**2 / np.mean(cosine**2)
    part = LAMP_SHARE * falloff / (1 + LAMP_SHARE * (falloff - 1))
    noise = np.random.default_rng(1).normal(0, 0.02, shade.shape)
    return points, 1 - part[:, None] * shade + noise, bodies


def found_lamp_deg(light: Light) -> float:
    """Angle in degrees, at the middle of the floor, between the planted lamp and the middle of the estimated one."""
    ways = light.lamps.positions_m / np.linalg.norm(light.lamps.positions_m, axis=1, keepdims=True)
    middle = (light.share[:, None] * ways).sum(axis=0)
    return float(np.degrees(np.arccos(middle @ LAMP_M / np.linalg.norm(middle) / np.linalg.norm(LAMP_M))))


def in_closed_form(points: np.ndarray, lamp: np.ndarray, body: np.ndarray) -> np.ndarray:
    """(N,) the lamp's share that a body hides, computed for every capsule and point without culling."""
    towards = lamp[:3] - points
    away = np.linalg.norm(towards, axis=1, keepdims=True)
    ray, left = towards / away, np.ones(len(points))
    for capsule in body:
        axis, from_end = capsule[3:6] - capsule[:3], points - capsule[:3]
        squared, slant = max(axis @ axis, 1e-12), ray @ axis
        at_axis, at_ray = from_end @ axis, (from_end * ray).sum(axis=1)
        across = np.maximum(squared - slant**2, 1e-12)
        share = np.clip((at_axis - slant * at_ray) / across, 0, 1)
        along = np.clip(share * slant - at_ray, 0, away[:, 0])
        share = np.clip((at_axis + along * slant) / squared, 0, 1)
        gap = np.linalg.norm(from_end + along[:, None] * ray - share[:, None] * axis, axis=1)
        wide = np.maximum(lamp[3] / away[:, 0] * along, 1e-4)
        edge = np.clip(0.5 + 0.5 * (capsule[6] - gap) / wide, 0, 1)
        left *= 1 - edge**2 * (3 - 2 * edge) * np.minimum(1, 4 / np.pi * capsule[6] / wide)
    return 1 - left


def test_no_capsule_that_hides_anything_is_passed_over(body: BodyModel) -> None:
    """Groups of points, near, far and in between, on the floor and above it; lamps overhead, low, and the sky."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-3, -3, 0], [3, 3, 1.2], (1500, 3)) * [1, 1, 0] ** np.arange(2).repeat(750)[:, None]
    lamps = np.concatenate([rng.uniform([-4, -4, 0.5, 0.05], [4, 4, 3, 0.5], (6, 4)), sky_discs()[::6]])
    bodies = capsules(walking(body))[3:9:5]
    found = hidden_shares(points, lamps, bodies)
    for k, lamp in enumerate(lamps):
        expected = in_closed_form(points, lamp, np.concatenate(bodies))
        assert expected.max() > 0.3
        np.testing.assert_allclose(found[:, k], expected, atol=2e-3)
        assert np.abs(found[:, k] - expected).mean() < 1e-5


def test_light_from_everywhere_and_contact_fade_with_distance() -> None:
    ball = np.array([[0, 0, 0.1, 0, 0, 0.1, 0.1]])
    points = np.array([[0.12, 0, 0], [0.4, 0, 0], [2.0, 0, 0]])
    sky, near = hidden_sky_share(points, [ball]), body_proximity(points, [ball], 0.1)
    assert sky[0] > sky[1] > sky[2]
    assert near[0] > 0.6
    assert near[2] == 0


def test_capsules_are_the_body_they_stand_for(body: BodyModel) -> None:
    shape = build_occluder(body, np.zeros(10))
    rest = body.rest_vertices(np.zeros(10))
    posed = shape.posed(np.tile(np.eye(4), (24, 1, 1)))
    ends = np.concatenate([posed[:, :3], posed[:, 3:6]])
    assert np.ptp(ends, axis=0)[:2] == pytest.approx(np.ptp(rest, axis=0)[:2], rel=0.15), "arms and height"
    gaps = body_proximity(rest, [posed], 0.05)
    assert np.mean(gaps > np.exp(-1)) > 0.9, "nine tenths of the surface lie within 5 cm of the capsules"
    broken = np.tile(np.eye(4), (24, 1, 1))
    broken[3, 0, 0] = np.nan
    assert len(shape.posed(broken)) == 0


@pytest.mark.parametrize(("case", "off_deg"), [("plain", 6), ("shadow in the plate", 6), ("half measured", 10)])
def test_a_planted_lamp_is_found_and_explains_pictures_it_was_not_fitted_to(
    planted: tuple, settings: render_light.LightSettings, case: str, off_deg: float
) -> None:
    points, ratio, bodies = planted
    if case == "shadow in the plate":
        in_plate = np.quantile(ratio, 0.3, axis=1, keepdims=True)
        assert in_plate.min() < 0.95
        ratio = ratio / in_plate
    if case == "half measured":
        gone = np.arange(MOMENTS) % 2 == 1
        ratio = np.where(gone & (ratio < 0.97), np.nan, ratio)
        bodies = [[np.zeros((0, 7))] if g else b for b, g in zip(bodies, gone)]
    light = render_light.estimate_light(
        [render_light.FloorObservations(points, ratio)], range(MOMENTS), bodies, ROOM_BOX, settings
    )
    assert light.accepted
    assert found_lamp_deg(light) < off_deg
    if case != "half measured":
        assert light.share.sum() == pytest.approx(LAMP_SHARE, abs=0.1)
    if case == "plain":
        assert light.figures["error_held_out"] < 0.6 * light.figures["error_held_out_without"]


def test_without_shadows_no_light_is_kept(planted: tuple, settings: render_light.LightSettings) -> None:
    points, ratio, bodies = planted
    flat = 1 + np.random.default_rng(2).normal(0, 0.02, ratio.shape)
    light = render_light.estimate_light(
        [render_light.FloorObservations(points, flat)], range(MOMENTS), bodies, ROOM_BOX, settings
    )
    assert not light.accepted
    assert "without" in light.reason
    unseen = render_light.estimate_light(
        [render_light.FloorObservations(points, np.full_like(ratio, np.nan))],
        range(MOMENTS),
        bodies,
        ROOM_BOX,
        settings,
    )
    assert not unseen.accepted
    assert "too little floor" in unseen.reason


def test_ratios_know_no_colour_change_and_nothing_beside_people_who_were_not_measured() -> None:
    points = np.zeros((40, 60, 3))
    points[..., 0], points[..., 1] = np.linspace(-3, 3, 60), np.linspace(-2, 2, 40)[:, None]
    plate = np.full((40, 60, 3), 0.5)
    picture = np.full((40, 60, 3), 140, np.uint8)  # the whole picture is a tenth brighter than the plate
    picture[20, 30] = 100
    picture[20, 32] = (140, 100, 140)
    free, nobody = np.ones((40, 60), bool), np.zeros((0, 2))
    free[20, 33] = False
    near = np.array([[0.0, 0.0]])
    ratio = render_light.brightness_ratios(picture, plate, free, points, near, nobody, 1.0)
    assert ratio[20, 30] == pytest.approx(100 / 140, rel=1e-3)
    assert np.isnan(ratio[20, [32, 33]]).all()
    assert ratio[0, 0] == pytest.approx(1, abs=1e-3)
    assert np.isnan(render_light.brightness_ratios(picture, plate, free, points, nobody, near, 1.0)[20, 30])


def test_frames_in_which_nobody_was_measured_have_no_bodies(body: BodyModel) -> None:
    one = walking(body)
    valid = one.valid.copy()
    valid[3] = False
    fit = fitted_person(
        "p0", body.identity, 15.0, MOMENTS, poses=one.poses, trans=one.trans, betas=one.betas, valid=valid
    )
    bodies = render_light.bodies_over_time([fit], body)
    assert [len(b[0]) for b in bodies] == [0 if t == 3 else len(bodies[0][0]) for t in range(MOMENTS)]
    with pytest.raises(UserError, match="another body"):
        render_light.bodies_over_time([replace(fit, body="another body")], body)


def test_nobody_stands_where_somebody_is_who_is_away(body: BodyModel) -> None:
    one, frames = walking(body), np.arange(MOMENTS)
    about = body.identity, 15.0, one.poses, one.trans, one.betas, np.zeros((MOMENTS, 24, 3)), frames < 4
    fit = Person("p0", *about, np.zeros((MOMENTS, 24)), True, frames < 6)
    for frame, counts in ((3, (1, 0)), (5, (0, 1)), (6, (0, 0))):
        places = render_light.people_positions([fit], frame)
        assert tuple(len(place) for place in places) == counts
        for place in places:
            np.testing.assert_array_equal(place, np.broadcast_to(one.trans[frame, :2], place.shape))


def test_the_step_finds_the_lamp_in_files_and_refuses_what_does_not_fit(
    tmp_path: Path, body: BodyModel, root: Path, default_settings: Callable
) -> None:
    one, cameras = walking(body), ring([20, 110], "cam", wh=(160, 100))
    disc = np.array([[*LAMP_M, 2 * LAMP_HALF_M / np.sqrt(np.pi)]])
    write_model(tmp_path / "cameras", cameras)
    # On a platform shadows are searched on its top, not on the floor below it.
    platform = Platform(ROOM_BOX.low_m[:2], ROOM_BOX.high_m[:2], 0.0)
    write_room(tmp_path / "room.json", replace(ROOM_BOX, low_m=np.array([-3.0, -3.0, -0.4]), platform=platform))
    for camera in cameras:
        rays = camera.rays()[1]
        depth = np.where(rays[..., 2] < -1e-3, camera.centre_m[2] / np.maximum(-rays[..., 2], 1e-3), 0.0)
        points = camera.centre_m + rays * depth[..., None]
        floor = (depth > 0) & (np.abs(points[..., :2]).max(axis=-1) < 3)
        depth = np.where(floor, depth, 0.0)
        plate = np.full((*camera.hw, 3), 150, np.uint8)
        pictures = []
        for capsule in capsules(one):
            left = np.ones(camera.hw)
            left[floor] -= LAMP_SHARE * hidden_shares(points[floor], disc, [capsule])[:, 0]
            pictures.append(np.rint(plate * left[..., None]).astype(np.uint8))
        write_lossless(tmp_path / f"{camera.name}.mkv", pictures, 15.0)
        write_lossless(tmp_path / f"{camera.name}.mask.mkv", np.zeros((MOMENTS, *camera.hw), np.uint8), 15.0)
        write_plate(tmp_path / f"{camera.name}.png", plate, np.ones(camera.hw, bool))
        write_depth(tmp_path / f"{camera.name}.exr", depth.astype(np.float32), floor.astype(np.float32))
    joints = body.joints(one.poses, one.betas, one.trans)
    poses = one.poses.copy()
    poses[5] = np.nan  # a frame that nobody could fit
    person = Person(
        "p0", body.identity, 15.0, poses, one.trans, one.betas, joints, one.valid, np.zeros((MOMENTS, 24)), True
    )
    write_person(tmp_path / "p0.npz", person)
    names = [camera.name for camera in cameras]
    files = {
        "model": tmp_path / "cameras/images.txt",
        "fits": [tmp_path / "p0.npz"],
        "body": root / "resources/body.npz",
        "videos": [tmp_path / f"{n}.mkv" for n in names],
        "masks": [tmp_path / f"{n}.mask.mkv" for n in names],
        "plates": [tmp_path / f"{n}.png" for n in names],
        "depths": [tmp_path / f"{n}.exr" for n in names],
        "room_box": tmp_path / "room.json",
        "light": tmp_path / "room.light.json",
    }
    settings = settings_module.load(render_light.Settings, default_settings("render"), "render")
    render_light.run(settings, **files)
    found = read_light(files["light"])
    assert found.accepted
    assert found_lamp_deg(found) < 8
    with pytest.raises(UserError, match="no person is there"):
        render_light.run(settings, **files | {"fits": []})
    with pytest.raises(UserError, match="1 masks"):
        render_light.run(settings, **files | {"masks": files["masks"][:1]})


def lit(kept: bool = True) -> Light:
    lamps = Lamps(LAMP_M[None], np.array([[0, 0, -1.0]]), np.array([LAMP_HALF_M]))
    return Light(
        kept, "made", lamps, np.array([0.6]), lamps.falloff(np.zeros((1, 3)))[0], 0.1, 0.1, 0.1, 0.0, {"error": 0.01}
    )


def test_a_light_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_light(tmp_path / "light.json", lit())
    again = read_light(tmp_path / "light.json")
    points, bodies = floor_grid(), [np.array([[0, 0, 0.2, 0, 0, 1.5, 0.2]])]
    np.testing.assert_array_equal(again.factor(points, bodies), lit().factor(points, bodies))
    assert again.factor(points, bodies).min() < 0.6
    (tmp_path / "light.json").write_text((tmp_path / "light.json").read_text().replace('"sky": 0.1', '"sky": null'))
    with pytest.raises(UserError, match="not finite"):
        read_light(tmp_path / "light.json")


def test_dimmed_colours_are_multiplied_from_every_side_and_the_others_left_alone() -> None:
    sh = np.concatenate([sh_from_rgb(np.array([[0.8, 0.4, 0.2]]))[:, None], np.full((1, 3, 3), 0.1)], axis=1)
    sh = np.repeat(sh, 20, axis=0).astype(np.float32)
    blocks = block(Gaussians(np.zeros((20, 3)), np.ones((20, 4)), np.zeros((20, 3)), np.zeros(20), sh)).parameters
    rows, before = blocks.reshape(2, -1, 16), blocks.copy().reshape(2, -1, 16)
    dim_gaussians(sh, np.array([1, 18]), np.float32([1, 0.5]), np.ones(2, np.float32), blocks)
    changed = np.argwhere((rows != before).any(axis=1)).tolist()
    assert changed == [[1, 2]], "the nineteenth Gaussian is the third of its block"
    half = rows[1, SH : SH + 12, 2].reshape(4, 3)
    np.testing.assert_allclose(0.5 + SH_C0 * half[0], [0.4, 0.2, 0.1], atol=1e-6)
    np.testing.assert_allclose(half[1:], 0.05, atol=1e-6)


def test_only_what_faces_up_is_shaded() -> None:
    static = room(np.random.default_rng(0), 0.3)
    facing = upward_share(static, 0.0)
    wall = (np.abs(static.means_m[:, :2]).max(axis=1) == 3.0) & (static.means_m[:, 2] > 0.1)
    assert wall.any()
    assert facing[wall].max() < 1e-6
    assert facing[static.means_m[:, 2] == 0].min() == 1


def test_what_most_moments_agree_on_is_what_a_plate_shows() -> None:
    left = np.array([[1.0, 0.7, 1.0], [0.99, 0.72, 0.6], [0.5, 0.71, 1.0], [1.0, 1.0, 0.6]])
    np.testing.assert_allclose(robust_mode(left), [(1 + 0.99 + 1) / 3, 0.71, 1.0], atol=1e-6)


def test_stand_ins_throw_their_own_shadow_and_broken_poses_none(body: BodyModel) -> None:
    static, filmed = room(np.random.default_rng(0)), walking(body)
    shade = build_shading(lit(), static, [filmed], [filmed])
    assert shade is not None
    small = replace(filmed, betas=np.array([-3.0, *np.zeros(9)]), trans=filmed.trans - [0, 0, 0.15])
    shorter = build_shading(lit(), static, [small], [filmed])
    assert shorter is not None
    own, others = ((s.factor(2.0) - 1).sum() for s in (shade, shorter))
    assert own < -1
    assert abs(others - own) > 0.02 * abs(own)
    poses = filmed.poses.copy()
    poses[2] = np.nan
    broken = build_shading(lit(), static, [replace(filmed, poses=poses)], [filmed])
    assert broken is not None
    assert np.isfinite(broken.factor(2.0)).all()
    assert broken.factor(2.0).min() > 1 - 1e-6, "nothing is darkened"
    assert build_shading(lit(), static, [], []) is None
    assert build_shading(lit(kept=False), static, [filmed], [filmed]) is None


def thing(centres_m: np.ndarray, half_m: tuple[float, float, float], turns: np.ndarray | None = None) -> RigidObject:
    """An ellipsoid of 400 discs that moves along ``centres_m`` (T, 3), turned by ``turns`` (T, 3, 3) if given."""
    k = np.arange(400) + 0.5
    level, turn = np.arccos(1 - k / 200), np.pi * (1 + np.sqrt(5)) * k
    normals = np.stack([np.cos(turn) * np.sin(level), np.sin(turn) * np.sin(level), np.cos(level)], axis=1)
    gaussians = make_discs(normals * half_m, normals, np.full((400, 3), 0.5), 0.02, 0.3, 0.95, 0)
    known = np.isfinite(centres_m).all(axis=1)
    about = () if turns is None else (turns, "measured")
    return RigidObject(
        "o0", gaussians, np.zeros(400, np.uint8), centres_m, known, known, float(np.mean(half_m)), *about
    )


def test_things_throw_shadows_and_those_of_a_board_turn_with_it() -> None:
    """Against the lamp's hidden share, ray-traced with true balls and capsules."""
    points, moments = floor_grid(0.1), np.linspace([-1.0, 0.2, 0.5], [1.0, 0.2, 0.5], 9)
    floor = Gaussians(
        points,
        np.tile([1.0, 0, 0, 0], (len(points), 1)),
        np.full((len(points), 3), -3.0),
        np.zeros(len(points)),
        np.zeros((len(points), 1, 3)),
    )
    light = replace(lit(), sky=0.0, contact=0.0, share=np.array([0.8]))
    part = 0.8 * light.lamps.falloff(points)[:, 0] / light.mean_falloff
    part /= 1 + part - 0.8

    def found(what: RigidObject, frame: float) -> np.ndarray:
        shade = build_shading(light, floor, [], [], [what])
        assert shade is not None
        darker = np.zeros(len(points))
        darker[shade.at] = 1 - shade.factor(frame)
        return darker

    def planted(ends_m: np.ndarray, radius_m: float) -> np.ndarray:
        return part * sampled_shade(points, np.array([[*ends_m.ravel(), radius_m]]))

    ball = found(thing(moments, (0.2, 0.2, 0.2)), 4)
    true = planted(np.tile(moments[4], (2, 1)), 0.2)
    assert true.max() > 0.4
    assert np.sqrt(np.mean((ball - true)[true > 0.02] ** 2)) < 0.08
    assert ball[true == 0].max() < 0.05
    gone = moments.copy()
    gone[4:] = np.nan
    assert found(thing(gone, (0.2, 0.2, 0.2)), 6).max() == 0, "what is nobody knows where throws none"
    across = exp(np.linspace(0, np.pi / 2, 9)[:, None] * [0, 0, 1.0])
    stick = thing(moments, (0.45, 0.06, 0.06), across)
    for frame, way in ((0, [1.0, 0, 0]), (8, [0, 1.0, 0])):
        ends = moments[frame] + 0.39 * np.array([[-1.0], [1.0]]) * way
        shadow, true = found(stick, frame), planted(ends, 0.06)
        assert (shadow * true).sum() / np.sqrt((shadow**2).sum() * (true**2).sum()) > 0.9
        shadow = shadow.clip(0)
        spread = np.sqrt(np.average((points - np.average(points, axis=0, weights=shadow)) ** 2, axis=0, weights=shadow))
        assert (spread[0] > 2 * spread[1]) == (frame == 0), "it lies as the stick does"


def test_films_show_the_shadow_on_the_floor_alone_and_the_same_truth(
    tmp_path: Path, root: Path, default_settings: Callable
) -> None:
    write_scene(tmp_path, root, filmed=False)
    section = default_settings("render")
    section["shots"] = {"heldout": {"kind": "heldout"}}
    options = render_options(tmp_path, "heldout")
    films, truths = {}, {}
    for name, light in (("none", None), ("off", lit(kept=False)), ("on", lit())):
        if light is not None:
            write_light(tmp_path / "light.json", light)
        given = [tmp_path / "light.json"] if light is not None else []
        call(render_shot.run, settings_module.load(render_shot.Settings, section, "render"), **options, light=given)
        films[name] = options["video"].read_bytes(), read_stack(options["video"]).astype(int)
        truths[name] = options["truth"].read_bytes()
    assert films["off"][0] == films["none"][0], "a light that was not kept changes no byte"
    assert truths["on"] == truths["none"]
    change = films["on"][1].mean(axis=-1) - films["none"][1].mean(axis=-1)
    assert change.min() < -10
    assert (change < -3).mean() > 0.005
    top = change[:, : change.shape[1] // 4]
    assert np.abs(top).max() <= 1, "walls stay as they are"


def test_patches_lie_on_the_box_and_face_into_it() -> None:
    lamps = lamp_patches(replace(ROOM_BOX, yaw_rad=0.3), 0.75, np.zeros(3))
    near = lamps.facing.any(axis=1)
    inward = lamps.positions_m[near] + 0.01 * lamps.facing[near]
    assert replace(ROOM_BOX, yaw_rad=0.3).contains(inward).all()
    assert not replace(ROOM_BOX, yaw_rad=0.3).contains(inward - 0.02 * lamps.facing[near]).any()
    assert (lamps.positions_m[~near][:, 2] > 0).all()


def test_a_hall_has_hardly_more_patches_than_a_room_and_as_much_ceiling() -> None:
    """Distant patches are merged: at most as wide as seen from people, and as large as the patches that they
    replace.
    """
    hall = replace(ROOM_BOX, low_m=np.array([-16.0, -17.0, 0.0]), high_m=np.array([16.0, 17.0, 3.2]), yaw_rad=0.3)
    room_lamps, lamps = (lamp_patches(room_box, 0.75, np.zeros(3)) for room_box in (ROOM_BOX, hall))
    assert len(lamps.radius_m) < 4 * len(room_lamps.radius_m)
    down = lamps.facing[:, 2] < -0.5
    area = np.pi * lamps.radius_m[down] ** 2
    assert area.sum() == pytest.approx(32 * 34, rel=0.05)
    far = np.linalg.norm(lamps.positions_m[down], axis=1)
    assert (np.sqrt(area) <= np.maximum(0.76, far / 3.9)).all()
    assert np.sqrt(area)[far < 5].max() < 0.76
    assert hall.contains(lamps.positions_m[down] - [0, 0, 0.01]).all()
