# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs: fronts, records, sections; everything planted, so that the right answer is known."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from studiorecon.errors import UserError
from studiorecon.report.sections.solvers import COLUMNS
from studiorecon.report.sections.solvers import section as solvers_section
from studiorecon.sweep import page as sweep_page
from studiorecon.sweep.pareto import best_within, cheapest_reaching, front, kendall_tau
from studiorecon.sweep.records import FAILED, OK, Record, read_records, write_records
from studiorecon.sweep.runs_csv import as_csv
from studiorecon.sweep.section import scenes_section, section
from studiorecon.sweep.tradeoff import (
    across,
    budgets,
    changes,
    idle_parameters,
    on_front,
    spread_over_seeds,
    steps,
    times_to_gain,
)

ROOT = Path(__file__).resolve().parents[2]


def record(name: str, seconds: float | None, psnr: float | None, **more: object) -> Record:
    """A run with this time and this PSNR at two cameras of 36 frames, 0.5 dB above and below it."""
    rng = np.random.default_rng(5)
    frames = (
        {}
        if psnr is None
        else {
            c: [psnr + off + float(n) for n in rng.normal(0, 0.3, 36)] for c, off in (("view1", 0.5), ("view2", -0.5))
        }
    )
    stages = {} if seconds is None else {"people": 0.25 * seconds, "humans": 0.75 * seconds}
    made = Record(
        scene="made",
        name=name,
        parameter="",
        preset="",
        settings={"humans.iterations": 300},
        verdict=OK if psnr is not None else FAILED,
        sentence="" if psnr is not None else "humans_train: planted",
        metrics={} if psnr is None else {"psnr": psnr, "ssim": psnr / 40, "warp_rms": 0.5 / psnr, "lpips": None},
        intervals={} if psnr is None else {"psnr": [psnr - 0.1, psnr + 0.1]},
        frames=frames,
        worst={}
        if psnr is None
        else {
            "camera": "view2",
            "camera_psnr": psnr - 0.5,
            "frame_camera": "view2",
            "frame": 7,
            "frame_psnr": psnr - 2,
        },
        seconds={
            "from_nothing": seconds,
            "marginal": seconds,
            "ran": seconds,
            "cpu": seconds,
            "wall": seconds,
            "scoring": 1.0,
        },
        stages=stages,
        ran_stages=stages,
        peak_memory_mb=100.0,
        seeds={"humans.seed": 0},
        others_cores=0.05,
        machine={"processor": "made", "cores": 2, "memory_gb": 8.0, "system": "Linux"},
        versions={"python": "3"},
        scored=None if psnr is None else {"code": "x"},
    )
    return replace(made, **more)


def brute_force_front(points: list[tuple[float, float]]) -> set[int]:
    def dominates(a: tuple[float, float], b: tuple[float, float]) -> bool:
        return a[0] <= b[0] and a[1] >= b[1] and a != b

    kept = [i for i, p in enumerate(points) if all(map(math.isfinite, p))]
    return {i for i in kept if not any(dominates(points[j], points[i]) for j in kept)}


def test_a_dominated_a_tied_and_a_nan_point_and_one_that_is_zero() -> None:
    seconds = [10.0, 20.0, 20.0, 30.0, 5.0, 40.0, 20.0]
    quality = [0.0, 3.0, 3.0, 2.0, math.nan, None, 1.0]
    # Zero is a quality like any other (a loop that skips falsy values loses it); both of the tied points stay; NaN and
    # None never count.
    assert front(seconds, quality) == [0, 1, 2]


def test_one_point_is_a_front_and_nothing_is_none() -> None:
    assert front([3.0], [1.0]) == [0]
    assert front([], []) == []
    assert front([math.inf, 1.0], [1.0, math.nan]) == []


def test_the_front_is_brute_forces_whatever_the_order() -> None:
    rng = np.random.default_rng(0)
    for _ in range(1000):
        count = int(rng.integers(1, 12))
        points = [tuple(map(float, p)) for p in rng.integers(0, 6, (count, 2))]  # few values: many ties
        if rng.random() < 0.3:
            points[0] = (points[0][0], math.nan)
        order = rng.permutation(count)
        shuffled = [points[i] for i in order]
        found = {int(order[i]) for i in front([p[0] for p in shuffled], [p[1] for p in shuffled])}
        assert found == brute_force_front(points) == set(front([p[0] for p in points], [p[1] for p in points]))


def test_budgets_and_wanted_qualities() -> None:
    seconds, quality = [10.0, 60.0, 100.0, 50.0], [1.0, 5.0, 6.0, 0.5]
    assert best_within(seconds, quality, 9.0) is None
    assert best_within(seconds, quality, 60.0) == 1
    assert best_within(seconds, quality, 1e9) == 2
    assert cheapest_reaching(seconds, quality, 5.0) == 1
    assert cheapest_reaching(seconds, quality, 6.1) is None


def test_kendalls_tau_is_scipys() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b = rng.integers(0, 5, (2, 9)).astype(float)
        assert kendall_tau(a, b) == pytest.approx(scipy.stats.kendalltau(a, b).statistic, abs=1e-12)
    assert kendall_tau([1.0], [2.0]) is None
    assert kendall_tau([1.0, 1.0], [1.0, 2.0]) is None


def sweep() -> list[Record]:
    return [
        record("base", 100.0, 20.0),
        record("seed-1", 101.0, 20.02, settings={"humans.iterations": 300, "humans.seed": 1}, seeds={"humans.seed": 1}),
        record("seed-2", 99.5, 19.98, settings={"humans.iterations": 300, "humans.seed": 2}, seeds={"humans.seed": 2}),
        record("human-100", 60.0, 19.0, parameter="human steps", settings={"humans.iterations": 100}),
        record("human-900", 300.0, 20.5, parameter="human steps", settings={"humans.iterations": 900}),
        record("slow-and-bad", 400.0, 18.0, parameter="other", settings={"humans.iterations": 300, "render.near_m": 9}),
        record("nothing", 110.0, 20.001, parameter="idle", settings={"humans.iterations": 300, "humans.seed": 3}),
        record("broken", 12.0, None, parameter="other"),
    ]


def test_price_list_budget_and_time_to_gain() -> None:
    runs = sweep()
    assert [r.name for r in on_front(runs, "psnr")] == ["human-100", "seed-2", "base", "seed-1", "human-900"]
    price = steps(runs, "psnr")[-1]
    assert price.gain == pytest.approx(0.48)
    assert price.seconds == pytest.approx(199.0)
    assert "humans.iterations: 300 → 900" in price.changed
    chosen = {minutes: run.name if run else None for minutes, run in budgets(runs, "psnr")}
    assert chosen[1] == "human-100"
    assert chosen[2] == "seed-1"
    assert chosen[5] == chosen[240] == "human-900"
    assert [run.name for _, run in times_to_gain(runs, "psnr")] == ["human-900"] * 3


def test_less_is_better_for_errors_and_a_failed_run_is_on_no_front() -> None:
    # warp_rms falls as PSNR rises here, so both fronts must hold the same runs.
    assert on_front(sweep(), "warp_rms") == on_front(sweep(), "psnr")
    assert "broken" not in [r.name for r in on_front(sweep(), "psnr")]


def test_a_parameter_that_does_less_than_seeds_do_is_idle() -> None:
    runs = sweep()
    assert spread_over_seeds(runs)["base"]["half_range"] == pytest.approx(0.02)
    found = {c.record.name: c for c in changes(runs)}
    assert found["human-900"].measurable is True
    assert found["human-900"].seconds == pytest.approx(200.0)
    assert found["nothing"].measurable is False
    assert idle_parameters(list(found.values())) == ["idle"]
    assert "broken" not in found


def test_records_come_back_and_a_damaged_file_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records(path, "table.tsv", sweep())
    name, found = read_records(path)
    assert (name, [asdict(r) for r in found]) == ("table.tsv", json.loads(json.dumps([asdict(r) for r in sweep()])))
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(UserError, match=r"records\.jsonl is not JSON"):
        read_records(path)
    path.write_text("\n".join(text.splitlines()[:-1]))
    with pytest.raises(UserError, match=r"records\.jsonl holds 7 of 8 records"):
        read_records(path)
    path.write_text("{}\n")
    with pytest.raises(UserError, match=r"records\.jsonl is not a sweep's records"):
        read_records(path)
    with pytest.raises(UserError, match="missing"):
        read_records(tmp_path / "none.jsonl")


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"machine": {"processor": "another"}}, "different machine"),
        ({"scene": "another"}, "different scene"),
        ({"scored": {"code": "y"}}, "scored differently"),
        ({"name": "base"}, "base twice"),
    ],
)
def test_mixed_records_are_refused_by_name(tmp_path: Path, changed: dict, told: str) -> None:
    path = tmp_path / "mixed.jsonl"
    write_records(path, "table.tsv", [*sweep(), replace(record("added", 5.0, 19.0), **changed)])
    with pytest.raises(UserError, match=rf"mixed\.jsonl.*{told}"):
        read_records(path)


def test_the_page_says_what_the_csv_says_and_shows_failures(tmp_path: Path) -> None:
    paths = [tmp_path / "a.jsonl", tmp_path / "b.jsonl"]
    write_records(paths[0], "one_at_a_time.tsv", sweep())
    write_records(paths[1], "one_at_a_time.tsv", [replace(r, scene="other") for r in sweep()])
    page, table = tmp_path / "index.html", tmp_path / "sweep.csv"
    sweep_page.run(paths, ROOT / "resources/solvers.tsv", page, table)
    html, rows = page.read_text(), list(csv.DictReader(io.StringIO(table.read_text())))
    assert [row["name"] for row in rows] == [r.name for r in sweep()]
    for row, told in zip(rows, sweep()):
        assert row["verdict"] == told.verdict
        if told.verdict == OK:
            assert f"{float(row['psnr']):.2f}" in html
            assert float(row["from_nothing_s"]) == told.total_s
        else:
            assert row["psnr"] == ""
            assert told.sentence in html
    assert "On this machine: human-100: 1 min 00 s → 19.00 dB" in html
    assert "No measurable effect here: idle" in html
    assert "trust processor seconds" not in html
    assert "Something else kept up to 1.5 cores busy" in section(
        "t.tsv", [replace(r, others_cores=1.5) for r in sweep()]
    )
    assert "+1.00" in scenes_section({"a": sweep(), "b": sweep()}), "the same order twice"
    # Nothing that a browser would fetch.
    assert not re.search(r"(src|href)=\"(?!data:)", html)
    assert "http" not in html.replace("http-equiv", "")


def test_an_ablation_over_scenes_is_the_mean_of_its_changes_where_both_finished() -> None:
    def scene(base: float, less: float | None, more: float) -> list[Record]:
        return [record("base", 60.0, base), record("less", 40.0, less), record("more", 90.0, more)]

    scenes = {"a": scene(20.0, 18.0, 20.5), "b": scene(23.0, 22.5, 22.0), "c": scene(21.0, None, 21.5)}
    less, more = across(scenes)
    assert (less.name, less.scenes, less.psnr_span, less.seconds) == ("less", 2, (-2.0, -0.5), -20.0)
    assert less.gains["psnr"] == pytest.approx(-1.25)
    assert (more.scenes, more.psnr_span) == (3, (-1.0, 0.5))
    assert more.gains["psnr"] == pytest.approx(0.0)
    # Less warping error is better: a gain, which the page prints with the measure's own sign.
    assert less.gains["warp_rms"] < 0
    assert across({"a": [record("base", 60.0, None), record("less", 40.0, 18.0)]}) == [], "a base that failed"
    shown = scenes_section(scenes)
    assert "2 of 3" in shown
    assert "-2.00 … -0.50" in shown
    assert f"{-less.gains['warp_rms']:+.5f}" in shown


def test_a_sweep_in_which_everything_failed_says_so() -> None:
    shown = section("t.tsv", [record("base", None, None)])
    assert "None of the 1 configurations" in shown
    assert "humans_train: planted" in shown


def test_the_csv_has_no_zero_for_what_was_not_measured() -> None:
    row = list(csv.DictReader(io.StringIO(as_csv(sweep()))))[-1]
    assert (row["psnr"], row["ssim"], row["verdict"]) == ("", "", "failed")


def test_a_solver_that_another_form_beats_in_both_is_on_no_front(tmp_path: Path) -> None:
    path = tmp_path / "solvers.tsv"
    rows = [
        ("warp", "cheap", "in the code", "1", "ms", "5", "px", ""),
        ("warp", "worse", "", "2", "ms", "6", "px", ""),
        ("warp", "exact", "", "3", "ms", "0", "px", "yes"),
    ]
    path.write_text("\n".join("\t".join(row) for row in [COLUMNS, *rows]) + "\n")
    shown = re.findall(r"<tr>(<td.*?)</tr>", solvers_section(path))
    assert [("yes" in row, "(used)" in row) for row in shown] == [(True, False), (False, False), (True, True)]
