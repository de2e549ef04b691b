# SPDX-License-Identifier: Apache-2.0
"""What looks like somebody and is nobody: posters, screens, mirrors, one person found twice; and who only seems to be
one of these."""

from __future__ import annotations

import io
from contextlib import redirect_stdout

import numpy as np
import pytest
from studiorecon.body.fitting import prior
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people import associate
from studiorecon.people.association.acceptance import identities_from_keypoints
from studiorecon.scene.people import Detections

from tests.made.cameras import ring

FPS, FRAMES = 30.0, 60
NAMES = LAYOUTS["body_25"].keypoints
LEGS = [k for k, n in enumerate(NAMES) if any(j in n for j in ("hip", "knee", "ankle", "toe", "heel"))]
SIDES = [NAMES.index(n.replace(*("left", "right") if "left" in n else ("right", "left"))) for n in NAMES]


@pytest.fixture(scope="module")
def figure(root) -> np.ndarray:
    """(25, 3) somebody with hanging arms at the origin, z up, facing y."""
    body = BodyModel.load(root / "resources" / "body.npz")
    points = body.keypoints(
        list(NAMES), rotations.log(prior.mean_pose()).reshape(1, 72), np.zeros(10), np.zeros((1, 3))
    )[0]
    points = points[:, [0, 2, 1]] * [-1, 1, 1]
    return points - [0, 0, points[:, 2].min()]


def walking(figure: np.ndarray, start: tuple[float, float], speed_m_s: tuple[float, float]) -> np.ndarray:
    """(T, 25, 3) the figure on its way, hands and feet swinging."""
    t = np.arange(FRAMES)[:, None, None] / FPS
    swing = np.array(
        [0.25 * ("wrist" in n or "ankle" in n or "toe" in n or "heel" in n) * (1 if "left" in n else -1) for n in NAMES]
    )
    moved = figure + [*start, 0] + t * [*speed_m_s, 0]
    moved[..., 1] += swing * np.sin(2 * np.pi * t[..., 0])
    return moved


def found(
    scene: list[np.ndarray], missing: frozenset[tuple[int, int]] = frozenset(), seed: int = 0
) -> tuple[list, list[Detections]]:
    cameras, rng = ring(), np.random.default_rng(seed)
    out = []
    for v, camera in enumerate(cameras):
        frame, track, keypoints = [], [], []
        for p, points in enumerate(scene):
            pixels = camera.project(points)[0] + rng.normal(0, 2.0, (*points.shape[:2], 2))
            if (v, p) not in missing:
                frame.append(np.arange(FRAMES))
                track.append(np.full(FRAMES, p))
                keypoints.append(np.concatenate([pixels, np.where(np.isfinite(pixels[..., :1]), 0.9, 0.0)], axis=-1))
        out.append(
            Detections(camera.name, "body_25", np.concatenate(frame), np.concatenate(track), np.concatenate(keypoints))
        )
    return cameras, out


@pytest.fixture
def who(default_settings):
    options = settings_module.load(associate.Settings, default_settings("people"), "people")

    def run(scene: list[np.ndarray], missing: frozenset[tuple[int, int]] = frozenset()) -> tuple[list[str], list[str]]:
        """Per figure of the scene whose it is in the first camera that sees it, and the reasons of those left out."""
        cameras, detections = found(scene, missing)
        limits = options.association, options.triangulation
        with redirect_stdout(io.StringIO()):
            table, _, out = identities_from_keypoints(*limits, cameras, detections, [], FRAMES, FPS)
        view = [next(v for v in range(4) if (v, p) not in missing) for p in range(len(scene))]
        return [table[cameras[v].name, p].person for p, v in enumerate(view)], [one.reason for one in out]

    return run


def test_a_poster_and_a_screen_have_no_depth(figure, who):
    poster = np.tile(figure, (FRAMES, 1, 1)) * [1, 0, 1] + [-0.8, 1.5, 0.3]
    screen = walking(figure, (0.6, 0), (0.3, 0)) * [1, 0, 1] + [0, 1.5, 0.2]
    screen[..., 2] += 0.2 * np.sin(np.arange(FRAMES))[:, None] * ["wrist" in n for n in NAMES]
    people, reasons = who([walking(figure, (0, -1), (0.3, 0.2)), poster, screen])
    assert people == ["p0", "", ""]
    assert len([r for r in reasons if "it is flat" in r]) == 2


def test_a_person_who_stands_with_arms_hanging_or_spread_has_depth(figure, who, root):
    body = BodyModel.load(root / "resources" / "body.npz")
    spread = body.keypoints(list(NAMES), np.zeros((1, 72)), np.zeros(10), np.zeros((1, 3)))[0][:, [0, 2, 1]] * [
        -1,
        1,
        1,
    ]
    spread = np.tile(spread - [0, 0, spread[:, 2].min()] + [1.0, 0.5, 0], (FRAMES, 1, 1))
    still = np.tile(figure + np.array([-0.5, 0.8, 0]), (FRAMES, 1, 1))
    people, reasons = who([walking(figure, (0, -1), (0.3, 0.2)), still, spread])
    assert sorted(people) == ["p0", "p1", "p2"]
    assert reasons == []


def test_a_mirror_shows_nobody_new_and_two_who_dance_opposite_each_other_are_two(figure, who):
    walker = walking(figure, (-0.5, 0.3), (0.4, 0.1))
    image = walker[:, SIDES] * [1, -1, 1] + [0, 2 * 4.5, 0]  # a mirror at y = 4.5, behind all cameras
    people, reasons = who([walker, image])
    assert people == ["p0", ""]
    assert "mirror" in reasons[0]
    partner = walker[:, SIDES] * [1, -1, 1] + [0, 1.6, 0]  # the plane between them has cameras on both sides
    people, reasons = who([walker, partner])
    assert sorted(people) == ["p0", "p1"]


def test_a_person_found_twice_in_every_camera_is_one_and_nobody_is_left_out(figure, who):
    walker = walking(figure, (-0.5, 0.3), (0.4, 0.1))
    people, reasons = who([walker, walker + np.array([0.03, 0.0, 0.04])])
    assert sorted(people) == ["", "p0"]
    assert reasons == []


def test_seven_people_one_who_stands_one_hidden_from_a_camera_one_behind_a_table_and_one_who_comes_late(figure, who):
    scene = [
        walking(figure, (x, y), v)
        for x, y, v in ((-1.5, -1.2, (0.3, 0.2)), (0, -1.4, (0.2, 0.4)), (1.5, -1, (-0.2, 0.3)))
    ]
    scene += [np.tile(figure + np.array([x, y, 0]), (FRAMES, 1, 1)) for x, y in ((-1.2, 1.2), (1.3, 1.2))]
    sitting = np.tile(figure + np.array([0.0, 0.6, -0.35]), (FRAMES, 1, 1))
    sitting[:, LEGS] = np.nan
    late = walking(figure, (0.2, 1.8), (0.4, 0))
    late[: FRAMES // 3] = late[-FRAMES // 4 :] = np.nan
    people, reasons = who([*scene, sitting, late], frozenset({(0, 3), (1, 0), (2, 5)}))
    assert sorted(people) == [f"p{n}" for n in range(7)]
    assert reasons == []


def test_somebody_still_at_a_desk_whom_two_of_four_cameras_see_is_a_person(figure, who):
    sitting = np.tile(figure + np.array([0.0, 0.6, -0.35]), (FRAMES, 1, 1))
    sitting[:, LEGS] = np.nan
    people, reasons = who([walking(figure, (0, -1), (0.3, 0.2)), sitting], frozenset({(2, 1), (3, 1)}))
    assert sorted(people) == ["p0", "p1"]
    assert reasons == []
