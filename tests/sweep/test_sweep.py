# SPDX-License-Identifier: Apache-2.0
"""A sweep's tables, its runs and its page, on planted runs whose costs and scores are known."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from studiorecon.configuration.schema import mistakes
from studiorecon.errors import UserError
from studiorecon.report.sections.cost import pareto_front
from studiorecon.sweep import page as sweep_page
from studiorecon.sweep import row as sweep_row
from studiorecon.sweep.table import BASE, COLUMNS, parse_settings, read_rows, row_configuration

ROOT = Path(__file__).resolve().parents[2]
DEFAULTS = yaml.safe_load((ROOT / "config/config.yaml").read_text())
SCHEMA = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
PRESETS = ROOT / "config/presets"


def write_table(path: Path, rows: list[tuple[str, str, str, str]]) -> Path:
    path.write_text("\n".join("\t".join(cells) for cells in [COLUMNS, *rows]) + "\n")
    return path


@pytest.mark.parametrize("path", sorted((ROOT / "config/sweeps").glob("*.tsv")), ids=lambda p: p.stem)
def test_every_row_of_the_tables_is_a_configuration_that_the_schema_allows(path: Path) -> None:
    rows = read_rows(path)
    for row in rows:
        assert not mistakes(row_configuration(DEFAULTS, rows[0], row, PRESETS), SCHEMA), row.name


def test_a_row_changes_the_base_and_one_with_a_preset_the_preset(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("a: {y: 7}\n")
    rows = [("base", "", "", "a.x=1"), ("one", "x", "", "a.y=2"), ("other", "", "p", "a.z=3")]
    base, one, other = read_rows(write_table(tmp_path / "t.tsv", rows))
    given = {"a": {"x": 0, "y": 0, "z": 0}}
    assert row_configuration(given, base, one, tmp_path) == {"a": {"x": 1, "y": 2, "z": 0}}
    assert row_configuration(given, base, other, tmp_path) == {"a": {"x": 0, "y": 7, "z": 3}}


def test_settings_are_yaml_values() -> None:
    assert parse_settings("a.b=1 ; c.d=x ; e=[1, 2]", "here") == {"a.b": 1, "c.d": "x", "e": [1, 2]}


class PlantedSnakemake:
    """Stands in for Snakemake: makes the files of two jobs, the second only where its settings changed."""

    def __init__(self) -> None:
        self.started: list[str] = []

    def __call__(self, snakefile: Path, folder: Path, arguments: list[str], minutes: float) -> tuple[int | None, str]:
        config = yaml.safe_load((folder / "config.yaml").read_text())
        if "--detailed-summary" in arguments:
            head = "output_file\tdate\trule\tlog-file(s)\tinput-file(s)"
            return 0, f"{head}\nr1\t-\tpeople\tlogs/s/people/fit.log\t\nr2\t-\thumans\tlogs/s/humans/train.log\t\n"
        self.started.append(folder.name)
        if config["humans"]["iterations"] < 0:
            (folder / "logs").mkdir(exist_ok=True)
            (folder / "logs/x.log").write_text("started\nhumans: iterations must be positive\n")
            return 1, "Error in rule humans_train:\n    log: logs/x.log (check log file)\n"
        for stage, step, seconds in (("people", "fit", 10), ("humans", "train", config["humans"]["iterations"] / 10)):
            timing = folder / f"timings/s/{stage}/{step}.tsv"
            if stage == "people" and timing.is_file():
                continue
            for path, text in (
                (timing, f"s\tmax_rss\tcpu_time\n{seconds}\t100\t{2 * seconds}\n"),
                (folder / f"results/s/{stage}/{step}", "made"),
                (folder / f"logs/s/{stage}/{step}.log", "said"),
                (folder / ".snakemake/metadata/x", "{}"),
            ):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                path.write_text(text)
        psnr = 20 + config["humans"]["iterations"] / 1000
        frames = [psnr + 0.01 * (i % 7) for i in range(36)]
        measured = {"psnr": {"value": psnr, "reason": None, "cameras": {"view1": {"value": psnr, "frames": frames}}}}
        metrics = {"pictures": {"raw": measured}, "jitter": {}, "bodies": {"mpjpe_world_mm": 10.0}}
        target = folder / "results/s/report/metrics.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(json.dumps(metrics))
        return 0, ""


def run_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: list[tuple[str, str, str, str]]
) -> tuple[list[dict[str, Any]], PlantedSnakemake]:
    planted = PlantedSnakemake()
    monkeypatch.setattr(sweep_row, "run_snakemake", planted)
    table, records = write_table(tmp_path / "t.tsv", rows), []
    for name, *_ in rows:
        record, base = tmp_path / f"{name}.json", [] if name == BASE else [tmp_path / "base.json"]
        reported = (
            json.dumps(DEFAULTS),
            "s",
            table,
            base,
            PRESETS,
            ROOT / "Snakefile",
            2,
            5.0,
            record,
            tmp_path / "runs",
        )
        sweep_row.run(name, *reported)
        records.append(json.loads(record.read_text()))
    return records, planted


ROWS = [
    ("base", "", "", "humans.iterations=400"),
    ("long", "iterations", "", "humans.iterations=1400"),
    ("wrong", "iterations", "", "humans.iterations=-1"),
]


def test_a_row_starts_from_the_base_and_is_charged_for_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (base, long, wrong), planted = run_rows(tmp_path, monkeypatch, ROWS)
    assert planted.started == ["base", "long", "wrong"]
    assert (base["from_nothing_s"], base["ran_s"]) == (50, 50)
    assert (long["from_nothing_s"], long["ran_s"], long["processor_s"]) == (150, 140, 300)
    assert long["stages_s"] == {"people": 10, "humans": 140}
    assert long["settings"] == {"humans.iterations": 1400}
    assert long["metrics"]["psnr"] == pytest.approx(21.4)
    assert wrong["failed"] == "humans_train: humans: iterations must be positive"


def test_copies_share_results_and_nothing_that_is_written_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_rows(tmp_path, monkeypatch, ROWS[:1])
    sweep_row.copy_run(tmp_path / "runs/base", tmp_path / "copy")
    of = {name: (tmp_path / "runs/base" / name, tmp_path / "copy" / name) for name in ("results/s/people/fit",)}
    assert all(os.path.samefile(*pair) for pair in of.values())
    for name in ("timings/s/people/fit.tsv", "logs/s/people/fit.log", ".snakemake/metadata/x"):
        source, target = tmp_path / "runs/base" / name, tmp_path / "copy" / name
        assert target.read_text() == source.read_text()
        assert not os.path.samefile(source, target)
        assert target.stat().st_mtime == source.stat().st_mtime
    shutil.rmtree(tmp_path / "copy")


def test_a_base_that_fails_stops_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match=r"scene s.*base run failed.*must be positive"):
        run_rows(tmp_path, monkeypatch, [("base", "", "", "humans.iterations=-1")])


def test_a_run_past_its_limit_says_so() -> None:
    assert "2 minutes" in sweep_row.reason_of_failure("", Path("nowhere"), 2)
    assert sweep_row.reason_of_failure("a\nWorkflowError: b\n", Path("nowhere"), None) == "WorkflowError: b"


def test_without_held_out_cameras_there_is_nothing_to_score(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    nothing = {"pictures": {"raw": {"psnr": {"value": None, "reason": None, "cameras": {}}}}}
    path.write_text(json.dumps(nothing))
    assert "held-out" in sweep_row.read_scores(path)["failed"]


def test_only_what_exists_and_looks_like_a_path_becomes_absolute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "depth").mkdir()
    (tmp_path / "a.yaml").write_text("")
    given = {"a": "depth", "b": ["a.yaml", "./depth"], "c": "b.yaml", "d": 1}
    wanted = {"a": "depth", "b": [str(tmp_path / "a.yaml"), str(tmp_path / "depth")], "c": "b.yaml", "d": 1}
    assert sweep_row.with_absolute_paths(given) == wanted


@pytest.mark.parametrize(
    ("points", "wanted"),
    [
        ([(1, 20), (2, 21), (3, 22)], [0, 1, 2]),
        ([(1, 20), (2, 19), (3, 22)], [0, 2]),
        ([(3, 22), (1, 20), (1, 21)], [2, 0]),
        ([(1, 0), (2, 0)], [0]),
        ([], []),
    ],
)
def test_the_front_holds_what_nothing_dominates(points: list[tuple[float, float]], wanted: list[int]) -> None:
    assert pareto_front([cost for cost, _ in points], [quality for _, quality in points]) == wanted


def test_the_page_prices_steps_and_lists_failures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [*ROWS, ("same", "nothing", "", "render.background_rgb=[0, 0, 0]")]
    records, _ = run_rows(tmp_path, monkeypatch, rows)
    paths = [tmp_path / f"{record['name']}.json" for record in records]
    sweep_page.run(paths, tmp_path / "p.html", tmp_path / "t.csv")
    page = (tmp_path / "p.html").read_text()
    assert "+1.00 dB" in page
    assert "humans.iterations: 400 → 1400" in page
    assert "iterations must be positive" in page
    table = list(csv.DictReader(io.StringIO((tmp_path / "t.csv").read_text())))
    assert [row["name"] for row in table] == ["base", "long", "wrong", "same"]
    assert float(table[1]["psnr"]) == pytest.approx(21.4)
    assert table[2]["psnr"] == ""
    found = {
        record["name"]: (gain, interval)
        for record, gain, interval, _ in sweep_page.parameter_effects(records[0], records)
    }
    assert found["long"][0] == pytest.approx(1.0)
    assert found["long"][1][0] > 0, "a whole decibel in every frame is measurable"
    assert found["same"][1][0] <= 0 <= found["same"][1][1]
    assert "wrong" not in found


def test_several_scenes_show_the_mean_and_the_span(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    records, _ = run_rows(tmp_path, monkeypatch, ROWS[:2])
    other = json.loads(json.dumps(records))
    for record in other:
        record["scene"] = "t"
    other[1]["metrics"]["psnr"] += 1
    (entry,) = sweep_page.mean_effects({"s": records, "t": other})
    assert entry["name"] == "long"
    assert entry["changes"]["psnr"] == pytest.approx(1.5)
    assert entry["psnr_span_db"] == pytest.approx([1, 2])
    assert entry["seconds"] == pytest.approx(100)


def test_seconds_of_two_machines_do_not_go_on_one_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_rows(tmp_path, monkeypatch, ROWS[:2])
    changed = json.loads((tmp_path / "long.json").read_text()) | {"machine": {"processor": "another"}}
    (tmp_path / "long.json").write_text(json.dumps(changed))
    with pytest.raises(UserError, match="another machine"):
        sweep_page.run([tmp_path / "base.json", tmp_path / "long.json"], tmp_path / "p.html", tmp_path / "t.csv")
