# SPDX-License-Identifier: Apache-2.0
"""The input files of rules: from the dataset, by the people detected, by the survey's decisions."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace as Wildcards
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.catalogue.selection import select_networks
from studiorecon.plan.make import make_plan
from studiorecon.plan.rule_files import Files
from studiorecon.plan.step_config import report_settings, shot_settings, step_section, step_settings
from studiorecon.scene.camera import Lens
from studiorecon.scene.decisions import Decision, write_decisions
from studiorecon.scene.files import write_json
from studiorecon.scene.people import write_people

SCENE = Wildcards(scene="capture")


class Asked:
    """Snakemake's checkpoints of a run in which ``finished`` have run; requests are counted."""

    def __init__(self, folder: Path, **finished: Any) -> None:
        self.requested: list[str] = []
        for name in ("calibration_from_people", "people_associate", "survey_decide"):
            setattr(self, name, Wildcards(get=self._get(name, finished.get(name))))

    def _get(self, name: str, output: Any) -> Any:
        def get(scene: str) -> Any:
            self.requested.append(name)
            assert scene == "capture"
            if output is None:
                raise LookupError(f"{name} has not run")
            return Wildcards(output=Wildcards(**output))

        return get


@pytest.fixture
def found(tmp_path: Path) -> dict[str, Any]:
    """Two people, one rejected; views and exposures called for."""
    rows = [(name, 9, "left,right", 0.9, "keypoints") for name in ("p0", "p1")]
    write_people(tmp_path / "with.tsv", rows, [("x0", 1, "left", 0.1, "keypoints", "rejected", "no depth")])
    verdicts = {"exposure": "on", "moving_shadows": "on", "dynamic_objects": "undetermined"}
    parts = {name: {"value": 0.5, "verdict": verdict} for name, verdict in (("00", "on"), ("01", "off"), ("02", "on"))}
    details = {"view_synthesis": {"parts": parts}, "closed_path": {"widest": "02"}}
    decided = verdicts | {"view_synthesis": "on", "closed_path": "off"}
    write_decisions(
        tmp_path / "decisions.json",
        [Decision(e, "", None, None, None, v, "", detail=details.get(e, {})) for e, v in decided.items()],
    )
    return {
        "people_associate": {"people": str(tmp_path / "with.tsv"), "who": "who"},
        "survey_decide": {"decisions": str(tmp_path / "decisions.json")},
    }


def write_lenses(path: Path, *names: str) -> None:
    intrinsics = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    lenses = [Lens(n, (640, 480), intrinsics, "opencv", np.zeros(4), np.eye(4), np.eye(2, 3)) for n in names]
    write_json(path, {"lenses": [lens.as_json() for lens in lenses]})


def files_of(config: dict[str, Any], home: Path, checkpoints: Any = None) -> Files:
    return Files(make_plan(config, home), config, home, lambda path: f"local:{path}", checkpoints)


def test_a_users_files_lie_where_they_lie_and_a_studios_are_results(configured, capture, home):
    own, left = files_of(configured(), home), Wildcards(scene="capture", camera="left")
    assert own.footage(left) == f"local:{capture}/videos/left.mp4"
    assert own.keypoints(left) == [f"local:{capture}/keypoints/left"]
    assert own.calibration == [f"local:{capture}/{name}.yml" for name in ("intri", "extri")]
    assert own.body == own.given_body == "local:resources/body.npz", "as given where it is a file from here"
    made = files_of(configured(dataset="resources/studio/tiny.yaml"), home)
    assert made.footage(Wildcards(camera="cam1")) == "results/studio/tiny/dataset/videos/cam1.mp4"
    assert made.truth(SCENE) == ["results/studio/tiny/truth"]


def test_what_was_made_elsewhere_is_found_by_its_name(configured, home, tmp_path):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth/left.npy").touch()
    config = configured(depth={"source": "precomputed", "precomputed": str(tmp_path / "depth")})
    with pytest.raises(UserError, match=r"depth.precomputed is .* has no \w+\.exr or \w+\.npy .*: bring that file"):
        files_of(config, home)
    for camera in ("left", "right", "back"):
        (tmp_path / f"depth/{camera}.npy").touch()
    assert files_of(config, home).estimated_depth(Wildcards(camera="left")) == [f"local:{tmp_path}/depth/left.npy"]
    with pytest.raises(UserError, match=r"masks.precomputed is 'mine', but masks.source is embedded"):
        files_of(configured(masks={"precomputed": "mine"}), home)
    own = files_of(configured(depth={"source": "moge"}), home)
    assert own.estimated_depth(Wildcards(scene="s", camera="right")) == ["results/s/depth/right.estimate.exr"]


def test_the_detectors_cameras_are_looked_at_twice(configured, capture, home):
    (capture / "keypoints/back").rmdir()
    files = files_of(configured(), home)
    tracks = [f"results/capture/tracks/{camera}.npz" for camera in ("back", "left", "right")]
    assert files.first_detections(SCENE) == tracks
    assert files.detections(SCENE) == ["results/capture/people/detections/back.npz", *tracks[1:]]
    assert files.detector_masks(Wildcards(scene="capture", camera="left")) == []
    assert len(files.detector_masks(Wildcards(scene="capture", camera="back"))) == 3
    assert files.keypoints(Wildcards(scene="capture", camera="back")) == ["results/capture/clocks/people/back.npz"]


def test_cameras_that_people_do_not_place_take_no_part(configured, capture, home, tmp_path):
    """Everything after a calibration from people depends on the calibrated cameras; a user's own calibration waits for
    no checkpoint.
    """
    (capture / "capture.yaml").write_text("held_out: [left]\n")
    requested = Asked(tmp_path)
    own = files_of(configured(), home, requested)
    assert (own.training(SCENE), own.held_out(SCENE)) == (["back", "right"], ["left"])
    assert requested.requested == []
    (capture / "intri.yml").unlink()
    with pytest.raises(LookupError, match="calibration_from_people"):
        files_of(configured(), home, Asked(tmp_path)).detections(SCENE)
    written = tmp_path / "calibration.json"
    write_lenses(written, "right", "back")
    files = files_of(configured(), home, Asked(tmp_path, calibration_from_people={"calibration": str(written)}))
    assert files.cameras(SCENE) == files.training(SCENE) == files.evaluated_cameras(SCENE) == ["back", "right"]
    assert files.held_out(SCENE) == files.heldout_film(SCENE) == []
    assert files.evaluated_film(SCENE) == ["train"]
    assert files.renders(SCENE) == ["train", *(f for f in files.plan.films if f != "heldout")]
    assert [Path(path).stem for path in files.detections(SCENE)] == ["back", "right"]
    write_lenses(written, "right", "left")
    assert files.evaluated_cameras(SCENE) == ["left"]
    assert files.evaluated_film(SCENE) == files.heldout_film(SCENE) == ["heldout"]
    closed = configured(survey={"force": {"view_synthesis": "on", "closed_path": "on"}})
    fewer = files_of(closed, home, Asked(tmp_path, calibration_from_people={"calibration": str(written)}))
    assert len(fewer.segments(SCENE)) == len(fewer.plan.segments) - 1


def test_association_says_who_is_there(configured, home, tmp_path, found):
    requested = Asked(tmp_path, people_associate=found["people_associate"])
    files = files_of(configured(), home, requested)
    assert files.fits(SCENE) == [f"results/capture/people/p{k}.npz" for k in (0, 1)], "the rejected is nobody"
    assert files.people(Wildcards()) == files.people(SCENE), "a target without wildcards is of the run's own scene"
    person = Wildcards(scene="capture", person="p1")
    assert files.person_tracks(person) == ["results/capture/people/who/p1.tsv"], "not where a bucket's copy is"
    assert set(requested.requested) == {"people_associate"}


def test_what_only_a_bucket_has_is_fetched_before_it_is_read(configured, home, tmp_path):
    class Stored(str):
        is_storage = True

        def open(self) -> None:
            raise LookupError(self)

    output = Wildcards(people=Stored(tmp_path / "nowhere/people.tsv"))
    checkpoint = Wildcards(get=lambda scene: Wildcards(output=output))
    files = files_of(configured(), home, Wildcards(people_associate=checkpoint))
    with pytest.raises(LookupError, match="nowhere"):
        files.people(SCENE)


def test_an_empty_room_asks_nobody(configured, capture, home, tmp_path):
    (capture / "capture.yaml").write_text("people: 0\n")
    requested = Asked(tmp_path)
    files = files_of(configured(), home, requested)
    for nothing in (
        files.people,
        files.fits,
        files.masks,
        files.identities,
        files.room_light,
        files.room_shade,
        files.detections,
        files.recognition,
    ):
        assert nothing(SCENE) == []
    assert requested.requested == []


def test_verdicts_call_for_files_and_what_is_forced_asks_nobody(configured, home, tmp_path, found):
    files = files_of(configured(), home, Asked(tmp_path, **found))
    assert files.gains(SCENE) == ["results/capture/survey/gains.json"]
    assert [Path(path).name for path in files.views(SCENE)] == ["00.mkv"], "01 needs none, 02 is where nobody stands"
    assert files.loose_objects(SCENE) == [], "undetermined is not on"
    assert files.room_light(SCENE) == ["results/capture/render/room.light.json"]
    assert files.room_shade(SCENE) == ["results/capture/render/room.shade.npz"]
    requested = Asked(tmp_path)
    force = {"exposure": "off", "view_synthesis": "on", "closed_path": "on"}
    off = files_of(configured(survey={"force": force}), home, requested)
    assert off.gains(SCENE) == []
    assert off.segments(SCENE) == off.plan.segments
    assert requested.requested == []


@pytest.mark.parametrize(
    ("force", "segments"),
    [
        ({"closed_path": "on"}, ["00", "02"]),
        ({"closed_path": "off", "view_synthesis": "on"}, ["00", "01"]),
        ({"closed_path": "on", "view_synthesis": "on"}, ["00", "01", "02"]),
        ({"view_synthesis": "on"}, ["00", "01"]),
        ({"closed_path": "off"}, ["00"]),
        ({"view_synthesis": "off"}, []),
    ],
)
def test_views_are_made_between_those_neighbours_that_need_them(configured, home, tmp_path, found, force, segments):
    config = configured(survey={"force": force})
    assert files_of(config, home, Asked(tmp_path, **found)).segments(SCENE) == segments
    unused = configured(survey={"force": force}, background={"views_share": 0.0})
    assert files_of(unused, home, Asked(tmp_path)).segments(SCENE) == [], "nothing is made that nobody learns from"


def test_photos_are_compared_where_something_may_be_added_to_films(configured, home):
    plain = {"enhancer": "none", "injection": {**configured()["enhance"]["injection"], "history": 0}}
    assert files_of(configured(enhance=plain), home).training_renders(SCENE) == []
    off = {"force": {"enhancement": "off", "injection": "off"}}
    assert files_of(configured(survey=off), home).training_renders(SCENE) == []
    names = [Path(p).name for p in files_of(configured(), home).training_renders(SCENE)]
    assert names == ["train.mkv", "train.json", "train.depth.mkv"]


def test_a_shot_names_its_path_its_stand_ins_and_its_reference(configured, home, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("her.ply", "her.npz", "path.json", "edited.png"):
        (tmp_path / name).write_text("{}")
    shots = {
        "far": {"kind": "file", "file": "path.json", "reference": "edited.png"},
        "swapped": {"kind": "orbit", "replace": {"p0": str(tmp_path / "her.ply"), "p1": "p0", "p2": "nobody"}},
    }
    files = files_of(configured(render={"shots": shots}), home)
    far, swapped = (Wildcards(scene="capture", shot=shot) for shot in shots)
    assert (files.shot_path(far), files.shot_path(swapped)) == (["local:path.json"], [])
    assert files.edited_reference(far) == ["local:edited.png"]
    assert files.replacement_people(swapped) == [str(tmp_path / name) for name in ("her.ply", "her.npz")]
    assert files.replacement_truth(swapped) == ["results/capture/render/swapped.truth.mkv"]
    assert files.replacement_truth(far) == []


def test_a_network_is_shown_people_only_where_it_is_set_to(configured, home, tmp_path):
    write_people(tmp_path / "people.tsv", [("p0", 11, "a,b", 1.0, "keypoints")])
    run = Asked(tmp_path, people_associate={"people": str(tmp_path / "people.tsv")})
    shown = configured(views={"synthesizer": "gen3c", "key_frames": "first_frames"})
    files = files_of(shown, home, run)
    assert [Path(p).parent.name for p in files.key_frames(SCENE)] == ["capture"] * len(files.plan.training)
    assert len(files.key_masks(SCENE)) == len(files.plan.training)
    assert files.key_people(SCENE) == ["results/capture/people/p0.npz"]
    for views in ({"synthesizer": "gen3c"}, {"key_frames": "first_frames"}):
        without = files_of(configured(views=views), home, run)
        assert [without.key_frames(SCENE), without.key_masks(SCENE), without.key_people(SCENE)] == [[], [], []]


def test_a_photo_of_a_stranger_is_made_into_a_person_and_asks_for_its_network(configured, home, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("photos/anna.JPG", "more/anna.png", "anna b.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("a picture")
    films = {
        "guest": {"kind": "orbit", "replace": {"p0": "photos/anna.JPG", "p1": "nobody"}},
        "again": {"kind": "orbit", "replace": {"p1": "photos/anna.JPG"}},
    }
    config = configured(render={"shots": films})
    files = files_of(config, home)
    for shot in films:
        assert files.replacement_people(Wildcards(scene="capture", shot=shot)) == [
            "results/capture/humans/stranger_anna.canonical.ply"
        ]
    assert files.replacement_photo(Wildcards(scene="capture", stranger="stranger_anna")) == "local:photos/anna.JPG"
    assert ("render.shots.guest.replace", "lhm") in select_networks(config)
    with pytest.raises(UserError, match="no film's replace names a photo of otto"):
        files.replacement_photo(Wildcards(scene="capture", stranger="stranger_otto"))
    for other, messages in (("more/anna.png", "rename one"), ("anna b.png", "letters, digits")):
        both = configured(render={"shots": {**films, "c": {"kind": "orbit", "replace": {"p0": other}}}})
        with pytest.raises(UserError, match=messages):
            files_of(both, home).replacement_photo(Wildcards(scene="capture", stranger="stranger_anna"))
    with pytest.raises(
        UserError, match=r"render\.shots\.guest\.replace is lhm, and LHM-1B may not be used commercially"
    ):
        files_of(configured(render={"shots": films}, licences="commercial"), home)


def test_a_step_gets_the_settings_it_reads_and_what_the_survey_is_forced_to(configured):
    config = configured(survey={"force": {"temporal_appearance": "on", "enhancement": "off", "injection": "off"}})
    assert step_section("humans.train", config)["temporal"]["use"] == "always"
    assert step_section("enhance.shot", config)["enhancer"] == "none"
    assert step_section("enhance.shot", config)["injection"]["history"] == 0
    assert "association" not in json.loads(step_settings("people.fit", config))
    moved = configured(survey={"thresholds": {"temporal_appearance": 0.3, "exposure": 0.2}})
    assert json.loads(step_settings("humans.train", moved))["thresholds"] == {"temporal_appearance": 0.3}


def test_readouts_move_keypoints_unless_they_are_switched_off(configured, home, tmp_path, found):
    person, run = Wildcards(scene="capture", person="p1"), {"people_associate": found["people_associate"]}
    for use, files in ((True, ["readouts.json"]), (False, [])):
        config = configured(people={"fit": {"rolling_shutter": use}})
        requested = files_of(config, home, Asked(tmp_path, **run)).readouts_for(person)
        assert [Path(path).name for path in requested] == files


def test_a_films_settings_are_of_that_film_and_a_reference_renders_nothing_again(configured):
    shots = {"a": {"kind": "orbit", "reference": "x.png"}, "b": {"kind": "train", "replace": {"p0": "p1"}}}
    config = configured(render={"shots": shots})
    film, layers = shot_settings("render.shot", config), shot_settings("render.layers", config, ("replace",))
    assert json.loads(film(Wildcards(shot="a")))["shots"] == {"a": {"kind": "orbit"}}
    assert json.loads(layers(Wildcards(shot="b")))["shots"] == {"b": {"replace": {"p0": "p1"}}}
    assert json.loads(film(Wildcards(shot="train")))["shots"] == {}


def test_the_page_shows_what_makes_the_result(configured):
    shown = json.loads(report_settings(configured()))
    assert not {"sweep", "sweep_minutes", "images"} & set(shown)
    assert "dataset" in shown
