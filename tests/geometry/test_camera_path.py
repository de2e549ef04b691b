# SPDX-License-Identifier: Apache-2.0
"""Paths between cameras that stand opposite, unlike or alone (rows R05, R07, R08, C07)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from studiorecon.geometry.camera_path import (
    axis_miss_rad,
    azimuths_rad,
    clearance_share,
    interpolate_cameras,
    look_at,
    order_around,
    scene_centre,
    with_pose,
)
from studiorecon.geometry.rotations import project_to_so3
from studiorecon.scene.camera import Camera

LENS = Camera("a", (64, 48), np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4))
TARGET = np.array([0.3, -0.2, 1.0])


def at(azimuth_deg: float, radius_m: float = 3.0, height_m: float = 1.6, target: np.ndarray = TARGET) -> Camera:
    a = np.radians(azimuth_deg)
    eye = np.array([TARGET[0] + radius_m * np.cos(a), TARGET[1] + radius_m * np.sin(a), height_m])
    return with_pose(LENS, look_at(eye, target), eye)


def way(start: Camera, end: Camera, **changed: object) -> tuple[list[Camera], bool]:
    return interpolate_cameras(start, end, 25, TARGET, **{"rotations": "slerp", "clearance": 0.6, **changed})


@pytest.mark.parametrize(
    ("apart", "chord"), [(70, 0.82), (90, 0.71), (117, 0.52), (180, 0.0)], ids=lambda v: f"R07-{v}"
)
def test_the_way_keeps_clear_of_the_middle(apart: float, chord: float) -> None:
    # The straight line passes the middle at 0.82, 0.71, 0.52 and 0.00 of the ring's radius: the last goes through the
    # people.
    start, end = at(10), at(10 + apart)
    views, bent = way(start, end)
    centres = np.stack([v.centre_m for v in views])
    straight, _ = way(start, end, clearance=0.0)
    assert clearance_share(np.stack([v.centre_m for v in straight]), TARGET) == pytest.approx(chord, abs=0.01)
    assert bent == (chord < 0.6)
    assert clearance_share(centres, TARGET) >= 0.6
    if bent:
        assert np.hypot(*(centres - TARGET)[:, :2].T) == pytest.approx(np.full(25, 3.0))


@pytest.mark.parametrize("noise", [1e-9, -1e-9], ids=lambda v: f"R05-{v:g}")
def test_opposite_cameras_fly_the_same_way_whatever_the_rounding(noise: float) -> None:
    # Slerp's midpoint was at -90° or +90° by the sign of the noise.
    views, _ = way(at(10), at(190 + np.degrees(noise)))
    middle = views[12]
    assert azimuths_rad([middle], TARGET)[0] == pytest.approx(np.radians(100), abs=1e-6)
    assert axis_miss_rad(middle, TARGET) < np.radians(12)


@pytest.mark.parametrize("noise", [0.0, 1e-9, -1e-9], ids=lambda v: f"R05-warned-{v:g}")
def test_the_choice_between_two_ways_is_said(noise: float, capsys: pytest.CaptureFixture[str]) -> None:
    way(at(10), at(190 + np.degrees(noise)))
    messages = capsys.readouterr().out
    assert "exactly opposite directions" in messages
    assert messages.count("\n") == 1
    # Where nothing was chosen nothing is said: neighbours of a ring, and looks that do not go by slerp.
    way(at(10), at(100))
    way(at(10), at(185))
    way(at(10), at(190), rotations="look_at")
    assert not capsys.readouterr().out


@pytest.mark.parametrize(
    ("start", "end"),
    [(at(0, 3.0), at(90, 6.0)), (at(0, 3, 0.5), at(117, 3, 2.5)), (at(0), at(175))],
    ids=["R08-radii", "R08-heights", "R08-gap"],
)
def test_look_at_keeps_the_centre_where_slerp_loses_it(start: Camera, end: Camera) -> None:
    # Slerp along the chord: the optical axis leaves the centre by up to 17.5, 30 and 66°.
    lost = max(axis_miss_rad(v, TARGET) for v in way(start, end, clearance=0.0)[0])
    kept = max(axis_miss_rad(v, TARGET) for v in way(start, end, clearance=0.0, rotations="look_at")[0])
    assert lost > np.radians(5)
    assert kept < np.radians(0.01)


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 360), st.floats(5, 180), st.floats(1, 6), st.floats(0.4, 3), st.sampled_from(["slerp", "look_at"]))
def test_every_way_starts_and_ends_at_its_cameras(
    azimuth: float, apart: float, radius: float, height: float, rotations: str
) -> None:
    off_centre = TARGET + np.array([0.4, 0.1, -0.2])
    start, end = at(azimuth, 3.0, 1.6, off_centre), at(azimuth + apart, radius, height)
    views, _ = way(start, end, rotations=rotations)
    for view, camera in ((views[0], start), (views[-1], end)):
        assert np.abs(view.camera_from_world - camera.camera_from_world).max() < 1e-8
    for view in views:
        assert np.abs(project_to_so3(view.rotation_camera_from_world) - view.rotation_camera_from_world).max() < 1e-9


def test_lens_changes_evenly_between_unlike_cameras() -> None:
    other = at(60)
    other = Camera("b", (128, 96), np.array([[180.0, 0, 66], [0, 180, 48], [0, 0, 1]]), other.camera_from_world)
    views, _ = way(at(0), other)
    assert all(v.wh == (64, 48) for v in views)
    # C07: with centres at +0.5 the principal point scales with the picture and nothing else.
    assert views[-1].intrinsics == pytest.approx(np.array([[90.0, 0, 33], [0, 90, 24], [0, 0, 1]]))
    assert views[12].focal_px[0] == pytest.approx(75.0)


def test_centre_is_where_the_axes_meet_and_stated_when_they_do_not() -> None:
    assert scene_centre([at(0), at(80, 4), at(200)]) == pytest.approx(TARGET, abs=0.01)
    alone = scene_centre([at(0)])
    assert np.isfinite(alone).all()
    assert axis_miss_rad(at(0), alone) < 1e-6
    parallel = [
        with_pose(LENS, look_at(np.array([0, y, 1.0]), np.array([9, y, 1.0])), np.array([0, y, 1.0]))
        for y in (-1.0, 1.0)
    ]
    assert scene_centre(parallel) == pytest.approx([3, 0, 1], abs=1e-6)


def test_open_arcs_do_not_fly_through_their_gap() -> None:
    cameras = [at(a) for a in (350, 100, 40)]
    order, gap = order_around(cameras, TARGET, closed=False)
    assert order == [0, 2, 1]
    assert gap == pytest.approx(np.radians(250))
    assert order_around(cameras, TARGET, closed=True)[0] == [0, 2, 1]
