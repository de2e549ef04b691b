# SPDX-License-Identifier: Apache-2.0
"""The decisions of a plan before the first job, and refused configurations."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.plan.decisions import camera_pattern
from studiorecon.plan.make import make_plan
from studiorecon.plan.networks import read_images

CAMERAS = ["back", "left", "right"]


def plates(capture: Path, cameras: list[str]) -> None:
    (capture / "plates").mkdir()
    for camera in cameras:
        (capture / "plates" / f"{camera}.png").touch()


def test_a_capture_with_everything_needs_no_detector_and_no_network(configured, home):
    plan = make_plan(configured(), home)
    assert (plan.scene, plan.studio, plan.description) == ("capture", "", "")
    assert plan.cameras == plan.training == plan.person_sources.cameras == plan.person_sources.clock_cameras == CAMERAS
    assert not plan.person_sources.detector_cameras
    assert not plan.held_out
    assert not plan.from_people
    assert [Path(f).name for f in plan.calibration] == ["intri.yml", "extri.yml"]
    assert plan.networks.selected == []
    assert plan.networks.images == ["core"]
    assert plan.films == [f for f in configured()["render"]["shots"] if f != "heldout"], "nobody is held out"


def test_a_studio_is_planned_before_it_is_filmed(configured, home):
    plan = make_plan(configured(dataset="resources/studio/tiny.yaml"), home)
    assert plan.scene == plan.studio == "tiny"
    assert Path(plan.description).is_file()
    assert plan.held_out
    assert all(file.startswith("results/studio/tiny/") for file in plan.calibration)


def test_held_out_cameras_are_not_trained_on(configured, capture, home):
    (capture / "capture.yaml").write_text("held_out: [left]\n")
    plan = make_plan(configured(), home)
    assert (plan.training, plan.held_out) == (["back", "right"], ["left"])
    assert plan.segments == ["00", "01"]
    assert plan.shots == ["train", *plan.films]
    assert "heldout" in plan.films


def test_the_detector_looks_where_no_keypoints_are_or_everywhere(configured, capture, home):
    (capture / "keypoints/back").rmdir()
    assert make_plan(configured(), home).person_sources.detector_cameras == ["back"]
    assert make_plan(configured(detect={"source": "detector"}), home).person_sources.detector_cameras == CAMERAS
    with pytest.raises(UserError, match=r"camera back of dataset .* has no keypoints"):
        make_plan(configured(detect={"source": "keypoints"}), home)


def test_nobody_is_looked_for_in_held_out_pictures_for_the_doctors_sake(configured, capture, home):
    (capture / "capture.yaml").write_text("held_out: [back]\n")
    assert make_plan(configured(), home).person_sources.doctor_cameras == CAMERAS, "recorded keypoints cost nothing"
    assert make_plan(configured(detect={"source": "detector"}), home).person_sources.doctor_cameras == ["left", "right"]


def test_people_do_not_time_what_the_detector_sees_only_after_the_clocks(configured, capture, home):
    (capture / "keypoints/back").rmdir()
    assert make_plan(configured(), home).person_sources.clock_cameras == CAMERAS
    (capture / "capture.yaml").write_text("frames: {first: 4, count: 20}\n")
    assert make_plan(configured(), home).person_sources.clock_cameras == ["left", "right"]
    assert make_plan(configured(clocks={"sync": "never"}), home).person_sources.clock_cameras == []


def test_without_a_calibration_cameras_are_found_from_people(configured, capture, home):
    (capture / "intri.yml").unlink()
    assert make_plan(configured(), home).from_people
    with pytest.raises(UserError, match=r"has no calibration: put "):
        make_plan(configured(calibration={"source": "files"}), home)
    (capture / "keypoints/back").rmdir()
    (capture / "capture.yaml").write_text("held_out: [back]\n")
    with pytest.raises(UserError, match="people's keypoints must give the cameras, but camera back"):
        make_plan(configured(detect={"source": "keypoints"}), home)


def test_clean_plates_alone_show_nobody(configured, capture, home):
    for camera in CAMERAS:
        (capture / "keypoints" / camera).rmdir()
    plates(capture, CAMERAS)
    with pytest.raises(UserError, match=r"no 2D keypoints .* set it to auto"):
        make_plan(configured(detect={"source": "keypoints"}), home)
    assert make_plan(configured(), home).person_sources.detector_cameras == CAMERAS


def test_forced_away_people_are_not_looked_for(configured, home):
    plan = make_plan(configured(survey={"force": {"people": "off"}}, detect={"source": "detector"}), home)
    assert not plan.people
    assert not plan.person_sources.detector_cameras
    assert not plan.person_sources.clock_cameras


def test_people_who_are_forced_are_looked_for_in_a_room_that_is_said_to_be_empty(configured, capture, home):
    (capture / "capture.yaml").write_text("people: 0\n")
    assert not make_plan(configured(), home).people
    assert make_plan(configured(survey={"force": {"people": "on"}}), home).people


def test_a_correction_in_the_configuration_counts_before_the_datasets(configured, capture, home):
    own = capture / "identities.tsv"
    own.touch()
    assert make_plan(configured(), home).identities == str(own)
    named = {"identities": str(capture / "mine.tsv")}
    with pytest.raises(UserError, match=r"people.identities names .*mine.tsv"):
        make_plan(configured(people=named), home)
    (capture / "mine.tsv").touch()
    assert make_plan(configured(people=named), home).identities == str(capture / "mine.tsv")


def test_networks_bring_their_image_and_their_gpu(configured, home):
    requested = {"depth": {"source": "moge"}, "calibration": {"source": "pi3"}}
    plan, images = make_plan(configured(**requested), home), read_images(configured(**requested), home)
    assert (plan.networks.depth, plan.networks.cameras, plan.networks.masks) == ("moge", "pi3", "")
    assert plan.calibration == [f"results/capture/calibration/network/{n}.txt" for n in ("cameras", "images")]
    assert set(plan.networks.images) == {"core", "moge", "pi3", "vision"}
    assert images.of_network("moge") == "docker://studiorecon/moge:0.1.0"
    assert images.of_network("precomputed") == images.of_network("") == images.named("core")
    assert (images.gpus("moge"), images.gpus("precomputed")) == (1, 0)
    assert read_images(configured(device="cpu"), home).gpus("moge") == 0


def test_an_image_is_named_by_digest_or_by_what_was_built(configured, home, tmp_path):
    made = read_images(configured(images=str(tmp_path)), home)
    (tmp_path / "core-0.1.0.sif").touch()
    assert made.named("core") == str(tmp_path / "core-0.1.0.sif")
    assert made.to_build(["core"]) == ["core=studiorecon/core:0.1.0"]
    exact = type(made)({"core": {"image": "x/core", "version": "1", "digest": "sha256:ab"}}, tmp_path, on_cpu=True)
    assert exact.named("core") == "docker://x/core@sha256:ab"


def test_smpls_own_pickle_becomes_arrays_first(configured, home, tmp_path):
    (tmp_path / "SMPL_NEUTRAL.pkl").touch()
    plan = make_plan(configured(body=str(tmp_path / "SMPL_NEUTRAL.pkl")), home)
    assert plan.given_body == str(tmp_path / "SMPL_NEUTRAL.pkl")
    assert plan.body == "results/body/SMPL_NEUTRAL.npz"
    assert make_plan(configured(), home).body == make_plan(configured(), home).given_body


def test_a_constraint_matches_these_names_and_none_where_there_are_none():
    assert [bool(re.fullmatch(camera_pattern(["a.b", "c"]), name)) for name in ("a.b", "c", "axb", "")] == [1, 1, 0, 0]
    assert not re.fullmatch(camera_pattern([]), "")
    assert not re.fullmatch(camera_pattern([]), "a")
