# SPDX-License-Identifier: Apache-2.0
"""A budget of minutes: work follows footage and settings, prices predict, the best that fits is chosen."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from studiorecon.errors import UserError
from studiorecon.plan import prices as price_list
from studiorecon.plan.budget import bought, choose, laid_over, preset
from studiorecon.plan.make import make_plan
from studiorecon.plan.prices import Point, Price, PriceList, pace_here, predict, read_prices
from studiorecon.plan.workload import Footage, Work, footage_of, workload

ROOT = Path(__file__).resolve().parents[2]
DEFAULTS = yaml.safe_load((ROOT / "config/config.yaml").read_text(encoding="utf-8"))
DEMO = Footage(training=4, held_out=4, detected=4, frames=60, wh=(480, 272), people=2)


def minutes_of(name: str, footage: Footage = DEMO, cores: int = 2) -> float:
    config = laid_over(DEFAULTS, DEFAULTS, preset(name))
    return predict(workload(footage, config), read_prices(), cores, 1.0).seconds / 60


def test_every_rule_with_work_is_a_rule_and_has_a_price() -> None:
    text = "\n".join(path.read_text() for path in (ROOT / "workflow/rules").glob("*.smk"))
    rules = set(re.findall(r"(?:rule|checkpoint) (\w+):", text)) | set(re.findall(r"use rule \w+ as (\w+) with", text))
    work = workload(DEMO, DEFAULTS)
    assert set(work) <= rules
    assert set(work) == set(read_prices().rules)
    assert all(price.job_s + price.unit_s > 0 for price in read_prices().rules.values())


@pytest.mark.parametrize(
    ("more", "rule"),
    [
        ({"frames": 600}, "masks_segment"),
        ({"frames": 600}, "cameras_refine"),
        ({"training": 8, "detected": 8}, "depth_room"),
        ({"people": 4}, "people_second_look"),
        ({"wh": (1920, 1080)}, "capture_frames"),
    ],
)
def test_more_footage_is_more_work(more: dict, rule: str) -> None:
    config = copy.deepcopy(DEFAULTS)
    less, greater = workload(DEMO, config)[rule], workload(replace(DEMO, **more), config)[rule]
    assert greater.jobs * greater.units > 1.5 * less.jobs * less.units


def test_larger_footage_is_only_decoded_longer_where_frames_keep_their_size() -> None:
    small, large = workload(DEMO, DEFAULTS), workload(replace(DEMO, wh=(1920, 1088)), DEFAULTS)
    assert {rule for rule in small if small[rule] != large[rule]} == {"capture_frames"}


def test_an_empty_room_and_recorded_keypoints_ask_for_less() -> None:
    empty = workload(replace(DEMO, people=0), DEFAULTS)
    assert not {"humans_train", "masks_segment", "people_fit"} & set(empty)
    assert "detect_people" not in workload(replace(DEMO, detected=0), DEFAULTS)


def test_presets_stand_in_the_order_of_their_cost_from_a_first_look_on() -> None:
    points = [point.preset for point in read_prices().points]
    took = [minutes_of(name) for name in points]
    assert took == sorted(took)
    assert points[0] == "look"
    assert "" in points
    assert took[-1] > 3 * took[0]


def test_a_prediction_is_work_over_cores_and_the_chain_that_cannot_be_shared() -> None:
    held = PriceList(1.0, 5.0, (0.8, 1.5), {"plates_clean": Price(1.0, 2.0), "depth_room": Price(0.0, 1.0)}, ())
    work = {"plates_clean": Work(4, 3.0), "depth_room": Work(1, 10.0)}
    # 4 × 7 s and 10 s: 38 s of work; the chain is one plate and the room.
    assert predict(work, held, 1, 1.0).seconds == pytest.approx(5 + 38)
    assert predict(work, held, 2, 1.0).seconds == pytest.approx(5 + 38 / 2 + 17 / 2)
    assert predict(work, held, 10**6, 1.0).seconds == pytest.approx(5 + 17, abs=0.01)
    twice = predict(work, held, 2, 2.0)
    assert twice.seconds == pytest.approx(5 + 13.75)
    assert (twice.low_s, twice.high_s) == pytest.approx((0.8 * 18.75, 1.5 * 18.75))


def bought_for(minutes: float, points: tuple[Point, ...], config: dict | None = None) -> Any:
    held = replace(read_prices(), points=points)
    return choose(minutes, config or DEFAULTS, DEFAULTS, DEMO, held, 2, 1.0)


def test_the_best_score_that_fits_is_chosen_not_the_dearest() -> None:
    points = (Point("look", 22.0), Point("", 23.0), Point("standard", 22.5))
    whole_night = bought_for(600, points)
    assert whole_night.chosen.preset == ""
    assert "more time would buy nothing" in whole_night.sentence()
    between = bought_for((minutes_of("look") + minutes_of("")) / 2, points)
    assert between.chosen.preset == "look"
    assert "the defaults would take" in between.sentence()
    assert "1.0 dB more" in between.sentence()


def test_too_little_time_takes_the_quickest_and_says_so() -> None:
    choice = bought_for(0.01, (Point("look", 22.0), Point("", 23.0)))
    assert choice.chosen.preset == "look"
    assert not choice.fits
    assert "the quickest there is" in choice.sentence()


def test_settings_of_the_user_stay() -> None:
    own = laid_over(DEFAULTS, DEFAULTS, {})
    own["capture"]["width"] = 360
    made = bought_for(0.01, (Point("look", 22.0),), own).chosen.config
    assert made["capture"]["width"] == 360
    assert made["depth"]["solids"] == preset("look")["depth"]["solids"]
    assert made["background"]["training"]["iterations"] == preset("look")["background"]["training"]["iterations"]
    assert made["background"]["training"]["sh_degree"] == DEFAULTS["background"]["training"]["sh_degree"]


def test_the_pace_is_probed_once_and_then_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = replace(read_prices(), probe_s=1.0)
    monkeypatch.setattr(price_list, "probe_s", lambda: 0.5)
    assert pace_here(held, tmp_path / "pace.json") == pytest.approx(2.0)
    monkeypatch.setattr(price_list, "probe_s", lambda: 5.0)
    assert pace_here(held, tmp_path / "pace.json") == pytest.approx(2.0)
    (tmp_path / "pace.json").write_text(json.dumps({}))
    assert pace_here(held, tmp_path / "pace.json") == pytest.approx(0.2)


def test_the_probe_takes_a_moment_of_real_work() -> None:
    assert 0.005 < price_list.probe_s() < 10


def test_a_studio_is_planned_from_its_description(configured: Callable[..., dict], home: Path) -> None:
    config = configured(dataset="resources/studio/demo.yaml")
    assert footage_of(make_plan(config, home), 30.0) == DEMO


def test_footage_that_cannot_be_read_is_named(configured: Callable[..., dict], home: Path) -> None:
    with pytest.raises(UserError, match=r"left\.mp4|right\.mp4|back\.mp4"):
        footage_of(make_plan(configured(), home), 30.0)


def test_networks_have_no_price(configured: Callable[..., dict], home: Path) -> None:
    config = configured(dataset="resources/studio/demo.yaml", budget_min=5.0, depth={"source": "moge"})
    with pytest.raises(UserError, match="moge"):
        bought(config, home, make_plan(config, home), 2)
