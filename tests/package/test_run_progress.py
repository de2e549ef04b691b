# SPDX-License-Identifier: Apache-2.0
"""How far a run is and how long the rest takes, from planted jobs; and the plugin that follows Snakemake's events."""

from __future__ import annotations

import io
import logging
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake_interface_logger_plugins.common import LogEvent
from snakemake_logger_plugin_studiorecon import LogHandler
from studiorecon import progress
from studiorecon.cli.run_progress import REMEMBERED_JOBS, Run, Running, read_seconds, record_seconds
from studiorecon.pages.run_summary import closing_lines


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
    assert run.left_in_words(0.0) == "at least 10 s left"
    assert Run({}, 1, 0.0, planned(film=2)).left_in_words(0.0) == "time left not known yet"


def test_seconds_are_remembered_by_scene_and_only_the_last(tmp_path: Path) -> None:
    path = tmp_path / "timings/seconds.json"
    assert read_seconds(path, "demo") == {}
    record_seconds(path, "demo", {"film": [1.0] * 30, "train": [5.0]})
    record_seconds(path, "demo", {"film": [2.0]})
    record_seconds(path, "tiny", {"film": [9.0]})
    assert read_seconds(path, "demo")["film"] == [1.0] * (REMEMBERED_JOBS - 1) + [2.0]
    assert read_seconds(path, "tiny") == {"film": [9.0], "train": [5.0]}
    path.write_text("{", encoding="utf-8")
    assert read_seconds(path, "demo") == {}


@pytest.mark.parametrize("columns", [40, 79, 119])
def test_the_bar_is_one_line_that_names_what_runs(columns: int) -> None:
    run = Run({"depth_sweep": [30.0]}, 2, 0.0, planned(depth_sweep=9), planned(depth_sweep=3))
    for job in range(4):
        run.running[job] = Running("depth_sweep", f"camera number {job}", 0.0)
    line = run.bar(0.0, columns)
    assert len(line) <= columns
    assert "\n" not in line
    assert line.startswith("3/9 ")
    assert columns < 79 or "depth.sweep camera number 0" in line


@pytest.mark.parametrize("bar", [True, False])
def test_beside_a_runs_bar_a_step_is_one_short_line_and_keeps_its_warnings_for_the_end(
    bar: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("STUDIORECON_RUN", "bar" if bar else "lines")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "60")
    with progress.log_to("depth.sweep", tmp_path / "step.log"):
        progress.say("a long sentence, " * 20)
        progress.warn("the floor is wet")
        assert list(progress.progress(range(3), "pictures")) == [0, 1, 2]
    printed = capsys.readouterr()
    assert "wet" not in printed.out
    assert not printed.err, "no bar of its own"
    assert printed.out.count("\n") == 1
    assert not bar or (printed.out.startswith("\r\x1b[K") and len(printed.out) < 65)
    kept = (tmp_path / "step.log").read_text()
    assert "warning: the floor is wet" in kept
    assert ("a long sentence, " * 20).strip() in kept, "the log has it whole"


def test_a_line_and_its_end_are_one_write(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Otherwise the bar may be drawn between the two, over the line."""
    written: list[str] = []

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

        def write(self, text: str) -> int:
            written.append(text)
            return len(text)

    monkeypatch.setenv("STUDIORECON_RUN", "bar")
    monkeypatch.setattr("sys.stdout", Terminal())
    monkeypatch.setattr("sys.stderr", Terminal())
    with progress.log_to("depth.sweep", tmp_path / "step.log"):
        progress.say("a sentence")
        progress.fail("a reason")
    assert [text for text in written if text] == ["\r\x1b[Kdepth.sweep: a sentence\n", "\r\x1b[Ka reason\n"]


def scene_folder(folder: Path) -> None:
    for name in ("enhance/orbit.mp4", "enhance/heldout.mp4", "enhance/orbit.wipe.mp4", "report/index.html"):
        (folder / "results/demo" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "results/demo" / name).touch()
    for name in ("deliver/player.html", "calibration/doctor.html"):
        (folder / "results/demo" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "results/demo" / name).touch()
    for name, text in (("a", "warning: one\nfine\n"), ("b", "warning: one\nwarning: two\n")):
        (folder / "logs/demo/people").mkdir(parents=True, exist_ok=True)
        (folder / f"logs/demo/people/{name}.log").write_text(text)


@pytest.mark.parametrize(
    ("rules", "named"),
    [
        ({"report_page", "deliver_player"}, ["orbit.mp4", "index.html", "player.html"]),
        ({"enhance_shot"}, ["orbit.mp4"]),
        ({"calibration_doctor"}, ["doctor.html"]),
        (None, ["orbit.mp4", "index.html", "player.html"]),
    ],
)
def test_a_run_ends_with_its_warnings_once_and_where_its_results_are(
    rules: set[str] | None, named: list[str], tmp_path: Path
) -> None:
    scene_folder(tmp_path)
    lines = closing_lines("demo", rules, tmp_path / "results", tmp_path / "logs").splitlines()
    assert [line.rpartition("/")[2] for line in lines if ".html" in line or ".mp4" in line] == named
    assert all(Path(line.split(maxsplit=1)[1]).is_file() for line in lines[-len(named) :])
    assert sum("one" in line for line in lines) == sum("two" in line for line in lines) == (rules is not None)


def test_the_last_lines_are_wrapped_between_words_on_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    scene_folder(tmp_path)
    sentence = "shot orbit shows less than half measured surfaces in some of its pictures (101-103)"
    (tmp_path / "logs/demo/people/a.log").write_text(f"warning: {sentence}\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("STUDIORECON_SCENE", "demo")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "50")
    plugin = LogHandler(SimpleNamespace(dryrun=False), None)
    plugin.emit(event(LogEvent.RUN_INFO, stats={"report_page": 1, "total": 1}))
    wildcards = {"scene": "demo"}
    plugin.emit(event(LogEvent.JOB_INFO, jobid=1, rule_name="report_page", threads=1, wildcards=wildcards))
    plugin.emit(event(LogEvent.JOB_FINISHED, job_id=1))
    plugin.close()
    *_, last = capsys.readouterr().err.split(progress.CLEAR_LINE)
    lines = last.splitlines()
    assert max(map(len, lines)) < 50
    assert sentence in " ".join(line.strip() for line in lines), "a word was cut"
    assert "page:   results/demo/report/index.html" in lines


def test_what_is_printed_beside_a_bar_takes_its_place(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("STUDIORECON_RUN", "bar")
    progress.print_error("not used: a.txt")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    progress.print_error("not used: b.txt")
    assert capsys.readouterr().err == "not used: a.txt\n\r\x1b[Knot used: b.txt\n"


def test_a_run_with_nothing_to_do_says_where_the_results_are(
    plugin: LogHandler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    scene_folder(tmp_path)
    monkeypatch.setenv("STUDIORECON_SCENE", "demo")
    record = event(None)
    record.msg = "Nothing to be done (all requested files are present and up to date)."
    plugin.emit(record)
    plugin.close()
    assert "results/demo/report/index.html" in capsys.readouterr().err


def event(kind: LogEvent | None, level: int = logging.INFO, **messages: object) -> logging.LogRecord:
    record = logging.LogRecord("snakemake", level, "", 0, None, None, None)
    record.__dict__.update(messages, event=kind)
    return record


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[LogHandler]:
    monkeypatch.chdir(tmp_path)
    made = LogHandler(SimpleNamespace(dryrun=False), None)
    yield made
    made.close()


def test_the_plugin_writes_the_page_of_the_scene_that_runs(plugin: LogHandler, tmp_path: Path) -> None:
    plugin.emit(event(LogEvent.RUN_INFO, stats={"capture_frames": 2, "report_page": 1, "all": 1, "total": 4}))
    for job, camera in ((1, "cam0"), (2, "cam1")):
        wildcards = {"scene": "demo", "camera": camera}
        plugin.emit(event(LogEvent.JOB_INFO, jobid=job, rule_name="capture_frames", threads=1, wildcards=wildcards))
    page = tmp_path / "results/demo/progress.html"
    assert "0 of 3 jobs, time left not known yet" in page.read_text()
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
