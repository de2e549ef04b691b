# SPDX-License-Identifier: Apache-2.0
"""How far a run is and how long the rest takes, from planted jobs; and the plugin that follows Snakemake's events."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake_interface_logger_plugins.common import LogEvent
from snakemake_logger_plugin_studiorecon import LogHandler
from studiorecon.cli.run_progress import KEPT, Run, Running, keep_seconds, read_seconds


def planned(**jobs: int) -> Counter[str]:
    return Counter(jobs)


def test_what_is_left_is_spread_over_the_cores_and_bounded_by_the_longest() -> None:
    run = Run({"film": [10.0], "train": [100.0, 120.0, 140.0]}, 2, 0.0, planned(film=4, train=1))
    assert run.remaining(0.0) == (120.0, 1.0), "one job takes 120 s whatever runs beside it"
    run.planned["film"] = 40
    assert run.remaining(0.0)[0] == pytest.approx((40 * 10 + 120) / 2)
    run.running[1] = Running("train", "p0", 0.0)
    assert run.remaining(60.0)[0] == pytest.approx((40 * 10 + 60) / 2), "what runs has been running for a minute"
    assert run.left_in_words(60.0) == "about 4 min left"


def test_a_slower_machine_today_makes_the_rest_longer() -> None:
    run = Run({"film": [10.0], "train": [100.0]}, 1, 0.0, planned(film=4, train=1))
    for job in range(3):
        run.running[job] = Running("film", "", 30.0 * job)
        run.finished(job, 30.0 * (job + 1))
    assert run.pace() == pytest.approx(3.0)
    # One film as this run's took, and training three times as long as before.
    assert run.remaining(90.0)[0] == pytest.approx(30 + 300)


def test_what_never_ran_is_said() -> None:
    run = Run({"film": [10.0]}, 1, 0.0, planned(film=1, train=3))
    assert run.left_in_words(0.0) == "at least 10 s left: some of it never ran here"
    assert Run({}, 1, 0.0, planned(film=2)).left_in_words(0.0) == "nothing like it ran here before: no telling how long"


def test_seconds_are_remembered_by_scene_and_only_the_last(tmp_path: Path) -> None:
    path = tmp_path / "timings/seconds.json"
    assert read_seconds(path, "demo") == {}
    keep_seconds(path, "demo", {"film": [1.0] * 30, "train": [5.0]})
    keep_seconds(path, "demo", {"film": [2.0]})
    keep_seconds(path, "tiny", {"film": [9.0]})
    assert read_seconds(path, "demo")["film"] == [1.0] * (KEPT - 1) + [2.0]
    assert read_seconds(path, "tiny") == {"film": [9.0], "train": [5.0]}
    path.write_text("{", encoding="utf-8")
    assert read_seconds(path, "demo") == {}


def event(kind: LogEvent | None, level: int = logging.INFO, **said: object) -> logging.LogRecord:
    record = logging.LogRecord("snakemake", level, "", 0, None, None, None)
    record.__dict__.update(said, event=kind)
    return record


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LogHandler:
    monkeypatch.chdir(tmp_path)
    return LogHandler(SimpleNamespace(dryrun=False), None)


def test_the_plugin_writes_the_page_of_the_scene_that_runs(plugin: LogHandler, tmp_path: Path) -> None:
    plugin.emit(event(LogEvent.RUN_INFO, stats={"capture_frames": 2, "report_page": 1, "all": 1, "total": 4}))
    for job, camera in ((1, "cam0"), (2, "cam1")):
        wildcards = {"scene": "demo", "camera": camera}
        plugin.emit(event(LogEvent.JOB_INFO, jobid=job, rule_name="capture_frames", threads=1, wildcards=wildcards))
    page = tmp_path / "results/demo/progress.html"
    assert "0 of 3 jobs, nothing like it ran here before" in page.read_text()
    plugin._written_s = 0.0
    plugin.emit(event(LogEvent.JOB_FINISHED, job_id=1))
    plugin._written_s = 0.0
    plugin.emit(event(LogEvent.JOB_ERROR, jobid=2))
    text = page.read_text()
    assert "1 of 3 jobs" in text
    assert "Failed: capture_frames cam1" in text
    plugin.close()
    assert "1 of 3 jobs, stopped" in page.read_text()
    plugin.close()
    assert [len(s) for s in read_seconds(tmp_path / "timings/seconds.json", "demo").values()] == [1]


def test_a_dry_run_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    plugin = LogHandler(SimpleNamespace(dryrun=True), None)
    plugin.emit(event(LogEvent.JOB_INFO, jobid=1, rule_name="capture_frames", threads=1, wildcards={"scene": "demo"}))
    plugin.close()
    assert not list(tmp_path.iterdir())


def test_what_the_plugin_cannot_follow_does_not_stop_a_run(plugin: LogHandler, capsys: pytest.CaptureFixture) -> None:
    plugin.emit(event(LogEvent.JOB_INFO, rule_name="capture_frames"))
    assert "KeyError" in capsys.readouterr().err
