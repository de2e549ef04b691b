# SPDX-License-Identifier: Apache-2.0
"""A sweep's tables, what its runs share, and who pays for it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from base64 import urlsafe_b64encode
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from studiorecon.errors import UserError
from studiorecon.sweep import jobs as sweep_jobs
from studiorecon.sweep import run as sweep_run
from studiorecon.sweep.fingerprint import busy_s
from studiorecon.sweep.jobs import Job, charge, cone, keys, peak_memory_mb, read_jobs, reusable, share
from studiorecon.sweep.outcome import NOTHING_MEASURED, outcome, why_it_failed
from studiorecon.sweep.plan import hypercube, one_at_a_time, parameters
from studiorecon.sweep.records import read_records
from studiorecon.sweep.run import clock, with_absolute_paths
from studiorecon.sweep.table import (
    BASE,
    COLUMNS,
    format_settings,
    full_configuration,
    parse_settings,
    read_configurations,
)

ROOT = Path(__file__).resolve().parents[2]
DEFAULTS = yaml.safe_load((ROOT / "config/config.yaml").read_text())
PRESETS = ROOT / "config/presets"


def job(log: str, inputs: tuple[str, ...] = (), started: float = 1.0) -> Job:
    """logs/s/stage/name.log makes results/s/stage/name."""
    output = f"results/{log.removeprefix('logs/').removesuffix('.log')}"
    return Job(log.split("/")[2], log, (output,), inputs, started, ())


def planted(folder: Path, made: Job, seconds: float, memory: float = 10.0) -> None:
    """The files that a finished job leaves."""
    for output in made.outputs:
        (folder / output).parent.mkdir(parents=True, exist_ok=True)
        (folder / output).write_text(output)
        record = folder / sweep_jobs.METADATA / urlsafe_b64encode(output.encode()).decode()
        record.parent.mkdir(parents=True, exist_ok=True)
        told = {
            "rule": made.rule,
            "log": [made.log],
            "input": list(made.inputs),
            "starttime": made.started,
            "incomplete": False,
        }
        record.write_text(json.dumps(told))
    (folder / made.benchmark).parent.mkdir(parents=True, exist_ok=True)
    (folder / made.benchmark).write_text(f"s\tmax_rss\tcpu_time\n{seconds}\t{memory}\t{seconds}\n")


CAPTURE = job("logs/s/capture/frames.log")
PEOPLE = job("logs/s/people/fit.log", CAPTURE.outputs)
ROOM = job("logs/s/background/train.log", CAPTURE.outputs)
FILM = job("logs/s/render/film.log", (*PEOPLE.outputs, *ROOM.outputs))
UNUSED = job("logs/s/deliver/export.log", FILM.outputs)
ALL = (CAPTURE, PEOPLE, ROOM, FILM, UNUSED)
BASE_CONFIG = {
    "device": "cpu",
    "capture": {"width": 1},
    "people": {"n": 1},
    "background": {"n": 1},
    "render": {"n": 1},
    "deliver": {},
}


@pytest.fixture
def base(tmp_path: Path) -> Path:
    for made, seconds in zip(ALL, (10.0, 20.0, 40.0, 5.0, 99.0)):
        planted(tmp_path / "base", made, seconds, memory=seconds)
    return tmp_path / "base"


def test_jobs_are_what_snakemake_wrote(base: Path) -> None:
    assert set(read_jobs(base)) == {made.log for made in ALL}
    (base / FILM.outputs[0]).unlink()
    assert FILM.log not in read_jobs(base), "what was removed is not finished"


def test_two_branches_share_a_stage_that_totals_charge_twice_and_marginal_cost_once(base: Path, tmp_path: Path) -> None:
    made = read_jobs(base)
    needed = cone(made, FILM.outputs)
    assert UNUSED.log not in needed, "a job that the result does not need costs it nothing"
    assert charge(base, needed.values()) == {"capture": 10.0, "people": 20.0, "background": 40.0, "render": 5.0}
    assert peak_memory_mb(base, needed.values()) == 40.0
    # The second run trains another room: the room and the film are new, the capture and the people are the first one's.
    paid = frozenset(one.execution for one in made.values())
    other, config = tmp_path / "other", BASE_CONFIG | {"background": {"n": 2}}
    for source, found in reusable([(base, made, BASE_CONFIG)], config):
        assert {one.log for one in found} == {CAPTURE.log, PEOPLE.log}
        share(source, found, other)
    planted(other, job(ROOM.log, ROOM.inputs, started=2.0), 80.0)
    planted(other, job(FILM.log, FILM.inputs, started=3.0), 6.0)
    second = cone(read_jobs(other), FILM.outputs)
    totals = [sum(charge(folder, run.values()).values()) for folder, run in ((base, needed), (other, second))]
    assert totals == [75.0, 116.0], "the shared ten and twenty seconds are in both"
    assert charge(other, second.values(), paid) == {"background": 80.0, "render": 6.0}
    # Forgetting the shared stage would have made the dearer room look almost free: 86 of 116.
    assert sum(charge(other, second.values(), paid).values()) == 86.0


def test_a_third_run_takes_each_branch_from_whoever_made_it(base: Path, tmp_path: Path) -> None:
    made = read_jobs(base)
    second, second_config = tmp_path / "second", BASE_CONFIG | {"background": {"n": 2}}
    share(base, [CAPTURE, PEOPLE], second)
    planted(second, job(ROOM.log, ROOM.inputs, started=2.0), 80.0)
    config = second_config | {"render": {"n": 2}}
    plan = reusable([(base, made, BASE_CONFIG), (second, read_jobs(second), second_config)], config)
    assert [{one.log for one in found} for _, found in plan] == [{CAPTURE.log, PEOPLE.log}, {ROOM.log}]


def test_keys_follow_settings_of_what_lies_above_and_no_others() -> None:
    jobs = {made.log: made for made in ALL}
    before = keys(jobs, BASE_CONFIG)

    def changed(**sections: object) -> set[str]:
        after = keys(jobs, BASE_CONFIG | sections)
        return {log for log in jobs if before[log] != after[log]}

    assert changed(people={"n": 2}) == {PEOPLE.log, FILM.log, UNUSED.log}
    assert changed(render={"n": 2}) == {FILM.log, UNUSED.log}
    assert changed(capture={"width": 2}) == set(jobs)
    assert changed(device="cuda") == set(jobs)
    assert changed(scene="other", sweep="x.tsv") == set()


def test_who_waits_for_kernels_shares_none_of_their_stage_s_settings() -> None:
    compiled = replace(job("logs/made/background/kernels.log", ()), rule="background_kernels")
    person = job("logs/made/humans/train/p0.log", compiled.outputs)
    jobs = {made.log: made for made in (compiled, person)}
    config = BASE_CONFIG | {"humans": {"n": 1}}
    assert keys(jobs, config) == keys(jobs, config | {"background": {"n": 2}})
    assert keys(jobs, config)[person.log] != keys(jobs, config | {"humans": {"n": 2}})[person.log]


def test_shared_files_keep_their_times_and_a_remade_one_leaves_the_other_end_alone(base: Path, tmp_path: Path) -> None:
    os.utime(base / CAPTURE.outputs[0], (1e9, 1e9))
    other = tmp_path / "other"
    share(base, read_jobs(base).values(), other)
    linked = other / CAPTURE.outputs[0]
    assert linked.stat().st_mtime == 1e9
    assert linked.stat().st_ino == (base / CAPTURE.outputs[0]).stat().st_ino
    linked.unlink()  # what Snakemake does before it runs a job again
    linked.write_text("new")
    assert (base / CAPTURE.outputs[0]).read_text() == CAPTURE.outputs[0]
    # Snakemake opens benchmarks in place, so they must not be links.
    assert (other / ROOM.benchmark).stat().st_ino != (base / ROOM.benchmark).stat().st_ino


def test_a_job_that_was_too_short_to_measure_counts_nothing(base: Path) -> None:
    (base / PEOPLE.benchmark).write_text("s\tmax_rss\tcpu_time\n-\t-\tNA\n")
    assert charge(base, [PEOPLE]) == {"people": 0.0}
    (base / PEOPLE.benchmark).unlink()
    assert charge(base, [PEOPLE]) == {"people": 0.0}
    assert peak_memory_mb(base, [PEOPLE]) is None


def write_table(path: Path, rows: list[tuple[str, str, str, str]]) -> Path:
    path.write_text("\n".join("\t".join(row) for row in [COLUMNS, *rows]) + "\n")
    return path


def test_a_row_lies_over_the_base_and_a_preset_starts_anew(tmp_path: Path) -> None:
    rows = [
        ("base", "", "", "humans.iterations=7 ; capture.width=160"),
        ("b", "k", "", "humans.iterations=9"),
        ("p", "", "standard", ""),
    ]
    found = read_configurations(write_table(tmp_path / "t.tsv", rows), DEFAULTS, PRESETS)
    full = [full_configuration(DEFAULTS, found[0], row, PRESETS) for row in found]
    assert [c["humans"]["iterations"] for c in full] == [7, 9, 4000]
    assert [c["capture"]["width"] for c in full] == [160, 160, 960]
    assert full[1]["humans"]["gaussians"] == DEFAULTS["humans"]["gaussians"]


@pytest.mark.parametrize(
    ("row", "told"),
    [
        (("x", "", "", "humans.iteration=1"), "humans.iteration, which config/config.yaml does not have"),
        (("x", "", "", "humans=1"), "a section"),
        (
            ("x", "", "", "render.shots.around.frames=4"),
            "render.shots.around.frames, which config/config.yaml does not have",
        ),
        (("x", "", "", "humans.iterations"), "not of the form"),
        (("x", "", "none-such", ""), "preset none-such"),
        (("a/b", "", "", ""), "folder's name"),
        (("base", "", "", ""), "second one called base"),
    ],
)
def test_a_wrong_row_is_refused_with_file_and_row(tmp_path: Path, row: tuple[str, str, str, str], told: str) -> None:
    path = write_table(tmp_path / "wrong.tsv", [("base", "", "", ""), row])
    with pytest.raises(UserError, match=f"row 3 of .*wrong.tsv.*{told}"):
        read_configurations(path, DEFAULTS, PRESETS)


def test_the_first_row_is_the_base(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="must be called base"):
        read_configurations(write_table(tmp_path / "t.tsv", [("other", "", "", "")]), DEFAULTS, PRESETS)


def test_settings_are_read_as_they_are_written() -> None:
    settings = {"a.b": 1, "a.c": 0.5, "d": "auto", "e.f": [1, 2], "g": False, "h": "", "i": "off"}
    assert parse_settings(format_settings(settings), "here") == settings


@pytest.mark.parametrize("path", sorted((ROOT / "config/sweeps").glob("*.tsv")), ids=lambda p: p.stem)
def test_every_table_that_comes_along_runs_with_this_configuration(path: Path) -> None:
    if path.stem == "parameters":
        assert {parameter.name for parameter in parameters(path) if not parameter.levels} == {
            parameter.name for parameter in parameters(path) if parameter.missing
        }
        return
    import jsonschema

    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    found = read_configurations(path, DEFAULTS, PRESETS)
    assert found[0].name == BASE
    for row in found:
        jsonschema.Draft202012Validator(schema).validate(full_configuration(DEFAULTS, found[0], row, PRESETS))


def test_tables_are_what_the_plan_makes_of_the_parameters() -> None:
    known = parameters(ROOT / "config/sweeps/parameters.tsv")
    for name, rows in (("one_at_a_time", one_at_a_time(known)), ("latin_hypercube", hypercube(known, 20, 0))):
        found = read_configurations(ROOT / f"config/sweeps/{name}.tsv", DEFAULTS, PRESETS)
        assert [(r.name, dict(r.settings)) for r in found[1:]] == [(r.name, dict(r.settings)) for r in rows], name


def test_a_latin_hypercube_uses_every_level_about_equally_often() -> None:
    known = parameters(ROOT / "config/sweeps/parameters.tsv")
    rows = hypercube(known, 20, 0)
    for parameter in (k for k in known[1:] if k.levels):
        own = {key for level in parameter.levels for key in level.settings}
        drawn = [{key: value for key, value in row.settings.items() if key in own} for row in rows]
        counts = [drawn.count(dict(level.settings)) for level in parameter.levels]
        assert sum(counts) == len(rows)
        assert max(counts) - min(counts) <= 1, parameter.name
    assert [r.settings for r in hypercube(known, 20, 0)] == [r.settings for r in rows]
    assert [r.settings for r in hypercube(known, 20, 1)] != [r.settings for r in rows]


def metrics(psnr: object, frames: Mapping[str, list]) -> dict:
    cameras = {c: {"value": sum(values) / len(values), "frames": values} for c, values in frames.items()}
    return {
        "pictures": {
            "enhanced": {"psnr": {"value": psnr, "interval": [1, 2], "reason": "planted", "cameras": cameras}}
        },
        "bodies": {"mpjpe_world_mm": 9.0, "people": {}, "missed": []},
        "jitter": {"p0": {"joints_mm_f2": 5.0}},
        "identities": {"accuracy": None},
        "provenance": {"masks": "exact", "libraries": {}, "code": "c", "settings": {}, "revision": "r"},
    }


def test_an_outcome_names_the_worst_camera_and_frame(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    path.write_text(json.dumps(metrics(20.0, {"v1": [21.0, 15.0, 24.0], "v2": [19.0, 20.0, 18.0]})))
    found = outcome(path)
    assert found.sentence == ""
    assert found.metrics["psnr"] == 20.0
    assert found.metrics["lpips"] is None
    told = {"camera": "v2", "camera_psnr": 19.0, "frame_camera": "v1", "frame": 1, "frame_psnr": 15.0}
    assert found.worst == told


def test_a_result_that_is_not_a_number_is_a_failure(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    path.write_text(json.dumps(metrics(None, {"v1": [1.0]})))
    assert "not a number" in outcome(path).sentence
    path.write_text(json.dumps(metrics(float("nan"), {"v1": [1.0]})))
    assert "not a number" in outcome(path).sentence
    path.write_text(json.dumps(metrics(None, {})))
    assert outcome(path).sentence == NOTHING_MEASURED
    path.write_text("{")
    assert "metrics.json" in outcome(path).sentence


def test_why_a_run_failed_is_its_steps_own_sentence(tmp_path: Path) -> None:
    (tmp_path / "fit.log").write_text("people.fit: 3 frames\npeople.fit: p0 is nobody\n")
    said = "Error in rule people_fit:\n    jobid: 1\n    log: fit.log (check log file(s) for error details)\nExiting"
    assert why_it_failed(said, tmp_path, None) == "people_fit: people.fit: p0 is nobody"
    assert why_it_failed("first\nlast word\n", tmp_path, None) == "last word"
    assert "60 minutes" in why_it_failed("", tmp_path, 60.0)


def test_processor_seconds_tell_own_work_from_other_peoples() -> None:
    burn = "import time; end = time.process_time() + 0.4\nwhile time.process_time() < end: pass"
    everything, own = busy_s()
    subprocess.run([sys.executable, "-c", burn], check=True)
    later = busy_s()
    assert later[1] - own >= 0.4
    assert later[0] - everything >= 0.39, "what was started here is part of everything"


def test_only_what_is_a_path_becomes_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("depth", "way.json", "sub/file"):
        (tmp_path / name).mkdir(parents=True)
    given = {
        "start": "depth",
        "shots": {"a": {"file": "way.json"}},
        "many": ["sub/file", "sub/none"],
        "rate": 0.5,
        "empty": "",
    }
    told = {
        "start": "depth",
        "shots": {"a": {"file": str(tmp_path / "way.json")}},
        "many": [str(tmp_path / "sub/file"), "sub/none"],
    }
    assert with_absolute_paths(given) == {**told, "rate": 0.5, "empty": ""}


def test_a_sweep_that_is_started_again_keeps_what_its_runs_took(base: Path) -> None:
    made = read_jobs(base)
    assert clock(base, made, 100.0, 3.0) == (100.0, 3.0)
    assert clock(base, made, 5.0, 1.0) == (100.0, 3.0), "nothing was left to do"
    planted(base, job("logs/s/report/more.log", started=9.0), 1.0)
    assert clock(base, read_jobs(base), 20.0, 2.0) == (120.0, 5.0), "the rest of an interrupted run"


class PlantedSnakemake:
    """Stands in for the runs' own Snakemake: makes what is missing of a capture, a person and a film, or fails where it
    is told to."""

    def __init__(self) -> None:
        self.started = 10.0
        self.ran: list[str] = []

    def __call__(
        self, _snakefile: Path, folder: Path, target: str, _cores: int, _minutes: float
    ) -> tuple[int | None, str]:
        config = yaml.safe_load((folder / "config.yaml").read_text())
        have = read_jobs(folder)
        capture, person = job("logs/s/capture/frames.log"), job("logs/s/humans/train.log", CAPTURE.outputs)
        score = Job("report_evaluate", "logs/s/report/evaluate.log", (target,), person.outputs, 1.0, ())
        for made, seconds in ((capture, 10.0), (person, 0.1 * config["humans"]["iterations"]), (score, 3.0)):
            if made.log in have:
                continue
            self.ran.append(made.log)
            if made is person and config["humans"]["iterations"] == 666:
                (folder / made.log).parent.mkdir(parents=True, exist_ok=True)
                (folder / made.log).write_text("humans.train: planted refusal\n")
                return 1, f"Error in rule humans_train:\n    log: {made.log} (check log)\n"
            if made is person and config["humans"]["iterations"] == 777:
                return None, ""
            self.started += 1.0
            planted(folder, Job(made.rule, made.log, made.outputs, made.inputs, self.started, ()), seconds)
        psnr = 20.0 + config["humans"]["iterations"] / 1000
        (folder / target).write_text(json.dumps(metrics(psnr, {"view1": [psnr] * 30})))
        return 0, ""


def test_a_sweep_goes_on_after_failures_and_charges_what_it_shares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        ("base", "", "", "humans.iterations=300"),
        ("more", "steps", "", "humans.iterations=900"),
        ("bad", "steps", "", "humans.iterations=666"),
    ]
    rows += [("slow", "steps", "", "humans.iterations=777"), ("again", "seed", "", "background.seed=1")]
    table, records = write_table(tmp_path / "t.tsv", rows), tmp_path / "sweep/records.jsonl"
    stand_in = PlantedSnakemake()
    monkeypatch.setattr(sweep_run, "_snakemake", stand_in)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    told = (json.dumps(DEFAULTS), "s", table, PRESETS, ROOT / "Snakefile", 2, 5.0, records, tmp_path / "sweep/runs")
    sweep_run.run(*told)
    base, more, bad, slow, again = found = read_records(records)[1]
    assert [r.verdict for r in found] == ["ok", "ok", "failed", "failed", "ok"]
    assert bad.sentence == "humans_train: humans.train: planted refusal"
    assert slow.sentence == "stopped after 5 minutes (sweep_minutes)"
    # Scoring is not charged; the capture is charged to everybody and run once.
    assert [r.seconds["from_nothing"] for r in (base, more, again)] == pytest.approx([40.0, 100.0, 40.0])
    assert [r.seconds["marginal"] for r in (more, again)] == pytest.approx([90.0, 0.0])
    assert [r.seconds["ran"] for r in found] == pytest.approx([40.0, 90.0, 0.0, 0.0, 0.0])
    assert more.metrics["psnr"] == pytest.approx(20.9)
    assert bad.metrics == {}
    assert again.seeds["background.seed"] == 1
    assert stand_in.ran.count("logs/s/capture/frames.log") == 1
    # Started again it runs only what failed, and says the same.
    stand_in.ran.clear()
    sweep_run.run(*told)
    assert set(stand_in.ran) == {"logs/s/humans/train.log"}
    assert [(r.name, r.verdict, r.seconds["ran"]) for r in read_records(records)[1]] == [
        (r.name, r.verdict, r.seconds["ran"]) for r in found
    ]


def test_nor_when_that_run_was_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel, stand_in = tmp_path / "kernels/studiorecon/train.nbc", PlantedSnakemake()

    def interrupted(snakefile: Path, folder: Path, *rest: object) -> tuple[int | None, str]:
        if not kernel.exists():
            kernel.parent.mkdir(parents=True)
            kernel.touch()
            planted(folder, job("logs/s/capture/frames.log"), 500.0)
            raise KeyboardInterrupt
        return stand_in(snakefile, folder, *rest)

    monkeypatch.setattr(sweep_run, "_snakemake", interrupted)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    table = write_table(tmp_path / "t.tsv", [("base", "", "", "humans.iterations=300")])
    told = (
        json.dumps(DEFAULTS),
        "s",
        table,
        PRESETS,
        ROOT / "Snakefile",
        2,
        5.0,
        tmp_path / "records.jsonl",
        tmp_path / "runs",
    )
    with pytest.raises(KeyboardInterrupt):
        sweep_run.run(*told)
    for _ in range(2):
        sweep_run.run(*told)
        (base,) = read_records(tmp_path / "records.jsonl")[1]
        assert base.seconds["from_nothing"] == pytest.approx(40.0)
    assert stand_in.ran.count("logs/s/humans/train.log") == 2, "once where it went on, once anew, and never again"


def test_nobody_is_charged_for_kernels_that_the_first_run_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a fresh machine the base would pay minutes that no later row pays, and the front would be drawn upside
    down."""
    kernel, stand_in = tmp_path / "kernels/studiorecon/train.nbc", PlantedSnakemake()

    def compiling(snakefile: Path, folder: Path, *rest: object) -> tuple[int | None, str]:
        told = stand_in(snakefile, folder, *rest)
        if not kernel.exists():
            kernel.parent.mkdir(parents=True)
            kernel.touch()
            for job in read_jobs(folder).values():
                planted(folder, job, 500.0)
        return told

    monkeypatch.setattr(sweep_run, "_snakemake", compiling)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    table = write_table(
        tmp_path / "t.tsv", [("base", "", "", "humans.iterations=300"), ("more", "steps", "", "humans.iterations=900")]
    )
    records = tmp_path / "sweep/records.jsonl"
    sweep_run.run(
        json.dumps(DEFAULTS), "s", table, PRESETS, ROOT / "Snakefile", 2, 5.0, records, tmp_path / "sweep/runs"
    )
    base, more = read_records(records)[1]
    assert [r.seconds["from_nothing"] for r in (base, more)] == pytest.approx([40.0, 100.0])
    assert stand_in.ran.count("logs/s/capture/frames.log") == 2, "the base ran twice, and nobody else"
    assert stand_in.ran.count("logs/s/humans/train.log") == 3


def test_a_sweep_is_not_continued_on_another_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_run, "_snakemake", PlantedSnakemake())
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    table = write_table(tmp_path / "t.tsv", [("base", "", "", "")])
    told = (
        json.dumps(DEFAULTS),
        "s",
        table,
        PRESETS,
        ROOT / "Snakefile",
        2,
        5.0,
        tmp_path / "records.jsonl",
        tmp_path / "runs",
    )
    sweep_run.run(*told)
    monkeypatch.setattr(sweep_run, "machine", lambda: {"processor": "another"})
    with pytest.raises(UserError, match="another machine"):
        sweep_run.run(*told)
