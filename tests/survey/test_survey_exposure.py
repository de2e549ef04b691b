# SPDX-License-Identifier: Apache-2.0
"""survey: the files of factors that divide exposure and light out of the pictures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.footage.video import write_lossless
from studiorecon.images.plate import write_plate
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.people import Detections
from studiorecon.survey import decide as step
from studiorecon.survey.effects import EXPOSURE
from studiorecon.survey.effects.changing_light import brightness_over_time
from studiorecon.survey.effects.exposure import active_gains

from tests.made.survey import decided, files, floor_view, ring, settings  # noqa: F401  (fixtures)

GAINS = np.array([[1.12, 1.05, 1.0], [0.88, 0.92, 0.97], [1.0, 1.0, 1.0]])


def written(path: Path) -> dict[str, np.ndarray]:
    return {name: np.array(own) for name, own in json.loads(path.read_text())["factors"].items()}


def artefact(files: dict, name: str) -> Path:
    """A file that the step writes next to its decisions."""
    return next(path for path in files["artefacts"] if path.stem == name)


@pytest.fixture
def gained(files: dict) -> dict:
    """The step's files with plates of three exposures."""
    for path, camera, gain in zip(files["plates"], ring([0, 120, 240]), GAINS):
        view = floor_view(camera, tuple(gain))
        write_plate(path, np.rint(view.rgb * 255).astype(np.uint8), view.measured)
    return files


def test_planted_gains_are_measured_and_written(gained: dict, settings: step.Settings) -> None:
    step.run(settings, **gained)
    decision = read_decisions(gained["decisions"])["exposure"]
    assert (decision.verdict, decision.detail["alone"]) == ("on", [])
    assert "humans.train" in decision.used_by
    found = np.concatenate([written(artefact(gained, "gains"))[f"c{k}"] for k in range(3)])
    np.testing.assert_allclose(found, GAINS / np.exp(np.log(GAINS).mean(axis=0)), atol=0.005)


def test_off_measured_or_forced_writes_no_factor_and_the_same_bytes(
    files: dict, gained: dict, settings: step.Settings
) -> None:
    step.run(replace(settings, force={"exposure": "off"}), **gained)
    assert read_decisions(gained["decisions"])["exposure"].value > 0.1, "it is measured all the same"
    forced = artefact(gained, "gains").read_bytes(), artefact(gained, "brightness").read_bytes()
    assert written(artefact(gained, "gains")) == written(artefact(gained, "brightness")) == {}
    for path, camera in zip(files["plates"], ring([0, 120, 240])):
        view = floor_view(camera)
        write_plate(path, np.rint(view.rgb * 255).astype(np.uint8), view.measured)
    step.run(settings, **files)
    assert read_decisions(files["decisions"])["exposure"].verdict == "off"
    assert (artefact(files, "gains").read_bytes(), artefact(files, "brightness").read_bytes()) == forced


def test_forced_on_uses_what_was_measured_and_cannot_invent_what_was_not(
    gained: dict, settings: step.Settings, capsys: pytest.CaptureFixture
) -> None:
    high = replace(settings, thresholds={**settings.thresholds, "exposure": 0.5})
    step.run(replace(high, force={"exposure": "on"}), **gained)
    assert written(artefact(gained, "gains"))["c1"].min() < 0.95
    assert written(artefact(gained, "gains"))["c1"].shape == (1, 3)
    step.run(replace(high, force={"exposure": "on"}, depth_tolerance=1e-9), **gained)
    assert read_decisions(gained["decisions"])["exposure"].value is None
    assert written(artefact(gained, "gains")) == {}
    assert "every camera keeps its exposure" in "".join(capsys.readouterr())


def test_a_camera_that_shares_nothing_is_named_and_kept(settings: step.Settings) -> None:
    views = [floor_view(c, g) for c, g in zip(ring([0, 60, 120, 240]), (1.12, 0.9, 1.0, 1.3))]
    blind = [*views[:3], replace(views[3], depth_m=np.zeros_like(views[3].depth_m))]
    decision = decided(EXPOSURE, settings, blind)
    assert decision.detail["alone"] == ["c3"]
    assert "c3 shares too little" in decision.reason
    assert set(active_gains(decision)) == {"c0", "c1", "c2"}
    np.testing.assert_allclose(decision.detail["gains"]["c3"], 1)


def film(path: Path, course: np.ndarray, hidden: slice = slice(0)) -> tuple:
    """A film of the floor under light of that course, with 1 level of noise, and a dark person over part of the
    picture.
    """
    view, rng = floor_view(ring([0], wh=(96, 72), focal_px=60.0)[0]), np.random.default_rng(3)
    frames = []
    for t, level in enumerate(course):
        picture = view.rgb * 255 * level + rng.normal(0, 1, view.rgb.shape)
        picture[:, 10 + 2 * t : 30 + 2 * t] = 20
        picture[hidden] = 5
        frames.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    write_lossless(path, frames, 30.0)
    return view, frames


def test_the_course_of_the_light_is_followed_past_who_walks_through(tmp_path: Path) -> None:
    course = 1 + 0.2 * np.sin(np.linspace(0, 6, 20))
    view, _ = film(tmp_path / "a.mkv", course)
    found = brightness_over_time(tmp_path / "a.mkv", view.camera, 20, None, view, 480)
    assert found.shape == (20, 3)
    np.testing.assert_allclose(found[:, 0], course, rtol=0.006)
    np.testing.assert_array_equal(found[:, 0], found[:, 2])


def test_frames_that_tell_nothing_take_the_light_between_their_neighbours(tmp_path: Path) -> None:
    course = np.linspace(0.9, 1.1, 9)
    view, frames = film(tmp_path / "a.mkv", course)
    for t in (0, 4):
        frames[t][:] = 0
    write_lossless(tmp_path / "b.mkv", frames, 30.0)
    found = brightness_over_time(tmp_path / "b.mkv", view.camera, 9, None, view, 480)[:, 0]
    np.testing.assert_allclose(found[1:], course[1:], rtol=0.01)
    assert found[0] == found[1]


def test_a_film_without_room_tells_no_course(tmp_path: Path) -> None:
    view, _ = film(tmp_path / "a.mkv", np.ones(3), hidden=slice(None))
    assert brightness_over_time(tmp_path / "a.mkv", view.camera, 3, None, view, 480) is None


def test_changing_light_turns_on_and_its_course_is_written(files: dict, settings: step.Settings) -> None:
    course = 1 + 0.15 * np.sin(np.linspace(0, 5, 12))
    rng = np.random.default_rng(0)
    for path, camera in zip(files["videos"], ring([0, 120, 240])):
        rgb = floor_view(camera).rgb * 255
        frames = [
            np.clip(np.rint(rgb * level + rng.normal(0, 1, rgb.shape)), 0, 255).astype(np.uint8) for level in course
        ]
        write_lossless(path, frames, 30.0)
    step.run(settings, **files)
    decision = read_decisions(files["decisions"])["changing_light"]
    assert decision.verdict == "on"
    assert written(artefact(files, "gains")) == {}
    found = written(artefact(files, "brightness"))
    assert set(found) == {"c0", "c1", "c2"}
    np.testing.assert_allclose(found["c1"][:, 1], course, rtol=0.01)
    again = artefact(files, "brightness").read_bytes()
    step.run(settings, **files)
    assert artefact(files, "brightness").read_bytes() == again


def test_people_seen_by_keypoints_are_left_out(tmp_path: Path) -> None:
    """A person in white fills most of the picture: without the outline the light would seem to rise."""
    view = floor_view(ring([0], wh=(96, 72), focal_px=60.0)[0])
    frames = [np.rint(view.rgb * 255).astype(np.uint8) for _ in range(3)]
    for frame in frames:
        frame[10:, 12:84] = 200
    write_lossless(tmp_path / "a.mkv", frames, 30.0)
    body = np.zeros((3, 25, 3))
    body[:, :, 0], body[:, :, 1], body[:, :, 2] = np.linspace(14, 82, 25), np.tile([12, 70], 13)[:25], 0.9
    found = Detections("c0", "body_25", np.arange(3), np.zeros(3, int), body)
    blind, reported = (
        brightness_over_time(tmp_path / "a.mkv", view.camera, 3, who, view, 480) for who in (None, found)
    )
    assert blind is not None
    assert abs(blind - 1).max() > 0.1
    assert reported is None or abs(reported - 1).max() < 0.02
