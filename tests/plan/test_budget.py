# SPDX-License-Identifier: Apache-2.0
"""A budget of minutes: work follows footage and settings, prices predict, the best that fits is chosen."""

from __future__ import annotations

import copy
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from studiorecon.errors import UserError
from studiorecon.plan import prices as price_list
from studiorecon.plan.budget import UserChoices, choose_offer, choose_preset, overlay_settings, read_preset
from studiorecon.plan.make import make_plan
from studiorecon.plan.prices import Point, Price, PriceList, machine_pace, predict, read_prices
from studiorecon.plan.workload import ON_DEMAND, Footage, Work, measure_footage, segments_with_views, workload
from studiorecon.sweep.table import merge

from tests.made.footage import smooth_pictures, write_video

ROOT = Path(__file__).resolve().parents[2]
DEFAULTS = yaml.safe_load((ROOT / "config/config.yaml").read_text(encoding="utf-8"))
SCHEMA = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text(encoding="utf-8"))
NOBODY = UserChoices({}, SCHEMA)
USUAL = 4  # gaps between the cameras of a ring of four
EVERYTHING = dict.fromkeys(ON_DEMAND.values(), "on")
DEMO = Footage(training=4, held_out=4, detector_cameras=4, frames=60, wh=(480, 272), people=2)


def minutes_of(name: str, footage: Footage = DEMO, cores: int = 2) -> float:
    config = overlay_settings(DEFAULTS, NOBODY, read_preset(name))
    return predict(workload(footage, config, USUAL), read_prices(), cores, 1.0).seconds / 60


def test_every_rule_with_work_is_a_rule_and_has_a_price() -> None:
    text = "\n".join(path.read_text() for path in (ROOT / "workflow/rules").glob("*.smk"))
    rules = set(re.findall(r"(?:rule|checkpoint) (\w+):", text)) | set(re.findall(r"use rule \w+ as (\w+) with", text))
    work = workload(replace(DEMO, synthetic=True), DEFAULTS, USUAL, EVERYTHING)
    assert set(work) <= rules
    assert set(work) == set(read_prices().rules)
    assert all(price.job_s + price.unit_s > 0 for price in read_prices().rules.values())


def test_a_longer_film_costs_more_at_every_rule_that_looks_at_all_of_it() -> None:
    short, long = (workload(replace(DEMO, synthetic=True, frames=n), DEFAULTS, USUAL, EVERYTHING) for n in (60, 600))
    grown = {rule for rule in short if long[rule].units > 5 * short[rule].units}
    assert {"people_fit", "cameras_held_out", "render_light"} <= grown
    assert not {rule for rule in grown if read_prices().rules[rule].unit_s == 0}


@pytest.mark.parametrize(
    ("more", "rule"),
    [
        ({"frames": 600}, "masks_segment"),
        ({"frames": 600}, "cameras_refine"),
        ({"training": 8, "detector_cameras": 8}, "depth_room"),
        ({"people": 4}, "people_second_look"),
        ({"wh": (1920, 1080)}, "capture_frames"),
    ],
)
def test_more_footage_is_more_work(more: dict, rule: str) -> None:
    config = copy.deepcopy(DEFAULTS)
    less, greater = workload(DEMO, config, USUAL)[rule], workload(replace(DEMO, **more), config, USUAL)[rule]
    assert greater.jobs * greater.units > 1.5 * less.jobs * less.units


def test_larger_footage_is_only_decoded_longer_where_frames_keep_their_size() -> None:
    small, large = (workload(replace(DEMO, wh=wh), DEFAULTS, USUAL) for wh in (DEMO.wh, (1920, 1088)))
    assert {rule for rule in small if small[rule] != large[rule]} == {"capture_frames"}


def test_an_empty_room_and_recorded_keypoints_ask_for_less() -> None:
    empty = workload(replace(DEMO, people=0), DEFAULTS, USUAL)
    assert not {"humans_train", "masks_segment", "people_fit", "report_recognition"} & set(empty)
    assert "detect_people" not in workload(replace(DEMO, detector_cameras=0), DEFAULTS, USUAL)


def test_presets_stand_in_the_order_of_their_cost_from_a_first_look_on() -> None:
    points = [point.preset for point in read_prices().points]
    took = [minutes_of(name) for name in points]
    assert took == sorted(took)
    assert points[0] == "look"
    assert "" in points
    assert took[-1] > 3 * took[0]


def test_a_prediction_takes_rule_after_rule_and_their_jobs_side_by_side() -> None:
    held = PriceList(1.0, 5.0, 1.2, (0.8, 1.5), {"plates_clean": Price(1.0, 2.0), "depth_room": Price(0.0, 1.0)}, ())
    work = {"plates_clean": Work(3, 3.0), "depth_room": Work(1, 10.0)}
    # Three of 7 s, then one of 10 s.
    for cores, jobs_s in ((1, 31), (2, 20.5), (3, 17), (64, 17)):
        assert predict(work, held, cores, 1.0).seconds == pytest.approx(5 + 1.2 * jobs_s)
    twice = predict(work, held, 1, 2.0)
    assert twice.seconds == pytest.approx(5 + 1.2 * 15.5)
    assert (twice.low_s, twice.high_s) == pytest.approx((0.8 * 23.6, 1.5 * 23.6))


class Planned:
    """The attributes of a plan that a prediction needs."""

    def __init__(self, forced: dict[str, str] | None = None, cameras: int = 4) -> None:
        self.scene, self.people, self.forced_effects = "there", True, forced or {}
        self.training = [f"cam{k}" for k in range(cameras)]
        self.segments = [f"{k:02d}" for k in range(cameras)]


def points(**scores: float) -> tuple[Point, ...]:
    """Points by their scores on one scene; ``defaults`` are the defaults."""
    return tuple(Point("" if name == "defaults" else name, {"demo": db}) for name, db in scores.items())


def bought_for(
    minutes: float,
    of: tuple[Point, ...],
    config: dict | None = None,
    stated: UserChoices = NOBODY,
    footage: Footage = DEMO,
) -> Any:
    held = replace(read_prices(), points=of)
    return choose_offer(minutes, config or DEFAULTS, stated, footage, Planned(), held, 2, 1.0)


def test_a_number_of_people_that_is_assumed_is_said() -> None:
    choice = bought_for(600, points(look=22.0, defaults=23.0), footage=replace(DEMO, people_known=False))
    assert "2 people assumed" in choice.sentence()


def test_the_best_score_that_fits_is_chosen_not_the_dearest() -> None:
    three = points(look=22.0, defaults=23.0, standard=22.5)
    whole_night = bought_for(600, three)
    assert whole_night.chosen.name == "the defaults"
    assert "no measured preset scores higher, not even standard" in whole_night.sentence()
    assert "with 2 people" in whole_night.sentence()
    between = bought_for((minutes_of("look") + minutes_of("")) / 2, three)
    assert between.chosen.name == "look"
    assert "the defaults would take" in between.sentence()
    assert "1.0 dB more" in between.sentence()


def test_scores_are_compared_where_both_were_measured() -> None:
    demo, second = {"demo": 23.0, "annex": 20.0}, {"demo": 23.4, "annex": 19.8, "take": 30.0}
    choice = bought_for(1.2 * minutes_of(""), (Point("", demo), Point("standard", second)))
    assert "standard would take" in choice.sentence()
    assert "for 0.1 dB more (-0.2 to +0.4 on 2 scenes)" in choice.sentence()
    assert bought_for(6000, (Point("", demo), Point("max", {"take": 40.0}))).chosen.name == "the defaults"


def test_too_little_time_takes_the_quickest_and_says_so() -> None:
    choice = bought_for(0.01, points(look=22.0, defaults=23.0))
    assert choice.chosen.name == "look"
    assert not choice.fits
    assert "no preset is quicker" in choice.sentence()
    reported = choice.as_json()
    assert reported["more"] in choice.sentence()
    assert reported["low_s"] < reported["predicted_s"] < reported["high_s"]


def test_settings_of_the_user_stay() -> None:
    own = copy.deepcopy(DEFAULTS)
    own["capture"]["width"] = 360
    made = bought_for(0.01, points(look=22.0, defaults=23.0), own).chosen.config
    look = read_preset("look")
    assert made["capture"]["width"] == 360
    assert made["depth"]["primitives"] == look["depth"]["primitives"]
    assert made["background"]["training"]["iterations"] == look["background"]["training"]["iterations"]
    assert made["background"]["training"]["sh_degree"] == DEFAULTS["background"]["training"]["sh_degree"]


def test_a_default_that_the_user_says_stays_too() -> None:
    messages = {"capture": {"width": DEFAULTS["capture"]["width"]}, "background": {"training": {"iterations": 1500}}}
    made = bought_for(0.01, points(look=22.0, defaults=23.0), stated=UserChoices(messages, SCHEMA)).chosen.config
    assert made["capture"]["width"] == DEFAULTS["capture"]["width"]
    assert made["background"]["training"]["iterations"] == 1500
    assert made["humans"]["iterations"] == read_preset("look")["humans"]["iterations"]


def test_the_schema_names_the_defaults_that_the_configuration_holds() -> None:
    assert not [name for name, value in leaves(DEFAULTS) if NOBODY.is_user_value(name, value)], (
        "written by studiorecon.configuration.generate"
    )


def leaves(values: dict[str, Any], above: str = "") -> list[tuple[str, Any]]:
    found = []
    for name, value in values.items():
        inner = isinstance(value, dict) and value and f"{above}{name}" != "render.shots"
        found += leaves(value, f"{above}{name}.") if inner else [(f"{above}{name}", value)]
    return found


@pytest.mark.parametrize(
    ("plan", "segments"),
    [
        (Planned(), 4),
        (Planned({"view_synthesis": "off"}), 0),
        (Planned(cameras=16), 0),  # a dense ring needs no views
        (Planned({"view_synthesis": "on"}, cameras=16), 16),
        (Planned({"closed_path": "off"}), 3),  # the widest gap of an arc is not filled
    ],
)
def test_views_are_expected_where_cameras_stand_far_apart_unless_it_is_forced(plan: Any, segments: int) -> None:
    assert segments_with_views(plan, DEFAULTS) == segments
    assert segments_with_views(plan, DEFAULTS | {"background": {"views_share": 0.0}}) == 0


def test_loose_things_and_shadows_count_where_they_are_forced() -> None:
    plain = set(workload(DEMO, DEFAULTS, USUAL))
    shadows = workload(DEMO, DEFAULTS, USUAL, {"moving_shadows": "on", "dynamic_objects": "off"})
    assert set(shadows) - plain == {"render_light", "render_shade"}
    assert set(workload(DEMO, DEFAULTS, 0)) == plain - {"views_synthesize"}


def test_the_pace_is_probed_once_and_then_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held, remembered = replace(read_prices(), probe_s=1.0), tmp_path / "pace.json"
    monkeypatch.setattr(price_list, "probe_s", lambda: 0.5)
    assert machine_pace(held, remembered) == pytest.approx(2.0)
    monkeypatch.setattr(price_list, "probe_s", lambda: 5.0)
    assert machine_pace(held, remembered) == pytest.approx(2.0)
    remembered.unlink()
    assert machine_pace(held, remembered) == pytest.approx(0.2)


def test_a_studio_is_planned_from_its_description_and_made_first(configured: Callable[..., dict], home: Path) -> None:
    config = configured(dataset="resources/studio/demo.yaml")
    footage = measure_footage(make_plan(config, home), 30.0)
    assert footage == replace(DEMO, synthetic=True)
    assert workload(footage, DEFAULTS, USUAL)["studio_capture"].jobs == 1
    assert "studio_capture" not in workload(DEMO, DEFAULTS, USUAL)


@pytest.mark.parametrize(("shown", "people", "counted"), [((), 2, False), ((0, 3), 1, True), ((2, 3, 3), 3, True)])
def test_keypoints_say_how_many_people_two_cameras_see(
    shown: tuple[int, ...], people: int, counted: bool, configured: Callable[..., dict], capture: Path, home: Path
) -> None:
    for seed, film in enumerate((capture / "videos").glob("*.mp4")):
        write_video(film, smooth_pictures(6, seed=seed))
    shutil.rmtree(capture / "keypoints", ignore_errors=True)
    for camera, count in zip(("left", "right", "back"), shown):
        folder = capture / "keypoints" / camera
        folder.mkdir(parents=True)
        person = {"pose_keypoints_2d": [10.0, 20.0, 0.9] * 25}
        for frame in range(6):
            (folder / f"{frame:06d}_keypoints.json").write_text(json.dumps({"people": [person] * count}))
    footage = measure_footage(make_plan(configured(), home), 30.0)
    assert (footage.people, footage.people_known, footage.frames) == (people, counted, 6)


def test_footage_that_cannot_be_read_is_named(configured: Callable[..., dict], home: Path) -> None:
    with pytest.raises(UserError, match=r"left\.mp4|right\.mp4|back\.mp4"):
        measure_footage(make_plan(configured(), home), 30.0)


def test_networks_have_the_papers_price(configured: Callable[..., dict], home: Path) -> None:
    presets: dict = {}
    for name in ("paper", "networks"):
        presets = merge(presets, read_preset(name))
    own = {"body": configured()["body"]}
    config = merge(configured(dataset="resources/studio/demo.yaml", budget_min=5.0), presets | own)
    with pytest.raises(UserError, match=r"about [\d.]+ h of one GPU.*views 50 min, the room 30 min, people 43 min"):
        choose_preset(config, {}, SCHEMA, make_plan(config, home), 2)


def test_a_network_without_a_price_is_refused(configured: Callable[..., dict], home: Path) -> None:
    config = configured(dataset="resources/studio/demo.yaml", budget_min=5.0, depth={"source": "moge"})
    with pytest.raises(UserError, match="not moge; choose a preset"):
        choose_preset(config, {}, SCHEMA, make_plan(config, home), 2)
    instead = merge(configured(dataset="resources/studio/demo.yaml", depth={"source": "moge"}), read_preset("look"))
    assert make_plan(instead, home).networks.selected
