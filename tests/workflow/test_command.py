# SPDX-License-Identifier: Apache-2.0
"""``studiorecon``: the words, what they say to bad input, and the same from an installed wheel in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon import home
from studiorecon.cli import command, quick_check, snakemake_call
from studiorecon.configuration.catalogue import list_film_settings, list_settings
from studiorecon.errors import UserError
from studiorecon.footage.video import write_watchable
from studiorecon.render.kinds import KINDS

from tests.workflow.conftest import ROOT

PARTS = ("Snakefile", "workflow/", "config/", "envs/", "profiles/", "resources/")
LEFT_OUT = {"resources/site.yml"}


def test_a_budget_of_minutes_is_handed_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    called: list[list[str]] = []

    class Process:
        def __init__(self, words: list[str], **_: object) -> None:
            called.append(words)

        def __enter__(self) -> Process:
            return self

        def __exit__(self, *_: object) -> None:
            return None

        def wait(self) -> int:
            return 0

    monkeypatch.setattr(command.subprocess, "Popen", Process)
    monkeypatch.chdir(tmp_path)
    assert command.main(["demo", "--budget", "7.5"]) == command.main(["demo"]) == 0
    assert called[0] == [*called[1], "budget_min=7.5"]
    assert called[1][-1].startswith("dataset="), "after --config, which takes as many words as follow"


def test_a_word_is_one_call_of_the_snakefile() -> None:
    made = command.snakemake_command("doctor", "DIR", "2", None, [])
    assert made == [
        sys.executable,
        "-m",
        "snakemake",
        "doctor",
        "--snakefile",
        str(ROOT / "Snakefile"),
        "--cores",
        "2",
        "--config",
        'dataset= "DIR" ',
    ]


def test_what_is_said_for_snakemake_joins_what_the_command_says() -> None:
    rest = [
        "--dry-run",
        "--config",
        "scene=x",
        "people={fit: {iterations: 20}}",
        "-n",
        "--configfile",
        "mine.yaml",
        "--quiet",
    ]
    made = command.snakemake_command("", "DIR", "all", "standard", rest)
    assert made.count("--config") == made.count("--configfile") == 1, "Snakemake would only take the last"
    assert made[made.index("--configfile") :] == [
        "--configfile",
        str(home.PRESETS / "standard.yaml"),
        "mine.yaml",
        "--config",
        'dataset= "DIR" ',
        "scene=x",
        "people={fit: {iterations: 20}}",
    ]
    assert {"--dry-run", "-n", "--quiet"} <= set(made)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "nowhere"], "there is no folder nowhere; give the folder of your capture"),
        (["doctor", "film.mp4"], "film.mp4 is a file; give the folder"),
        (["run", ".", "--preset", "papper"], "there is no preset papper; did you mean paper?"),
        (["view"], "no finished scene of demo in results/ of this folder; make it with: studiorecon demo"),
        (["view", "takes/one"], "make it with: studiorecon run takes/one"),
        (["settings", "people.smoth"], "there is no setting people.smoth; did you mean people.smooth?"),
    ],
)
def test_bad_input_is_a_sentence(
    words: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "film.mp4").touch()
    assert command.main(words) == 1
    messages = capsys.readouterr().err
    assert sentence in messages
    assert messages.count("\n") == 1


def test_without_a_word_the_command_shows_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([]) == 0
    assert "doctor" in capsys.readouterr().out
    with pytest.raises(SystemExit) as left:
        command.main(["--version"])
    assert left.value.code == 0
    assert re.fullmatch(r"studiorecon \S.*\n", capsys.readouterr().out)


def test_the_choices_of_a_setting_are_listed_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["settings"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    choices = re.findall(r"One of [^.]+\.", words)
    assert choices
    assert not re.search(r"(One of [^.]+\.) \1", words)


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "results/take/report/index.html"
    page.parent.mkdir(parents=True)
    page.write_text("<p>the page</p>")
    return tmp_path / "results/take"


@pytest.mark.parametrize("folder", ["take", "somewhere/take", "results/take", "take.yaml"])
def test_a_scene_is_found_by_its_capture_its_name_or_its_results(scene: Path, folder: str) -> None:
    assert command.finished_scene(folder).resolve() == scene
    with pytest.raises(UserError, match="finished here: take"):
        command.finished_scene("other")


def test_every_setting_has_a_meaning_and_its_default() -> None:
    schema = yaml.safe_load(home.SCHEMA.read_text())
    config = yaml.safe_load(home.CONFIGURATION.read_text())
    found = {setting.name: setting for setting in list_settings(home.CONFIGURATION, schema)}
    assert found["people.fit.iterations"].default == "30"
    assert "paper: 1280×704" in found["capture.width"].meaning, "the comment above it"
    assert "commercial" in found["licences"].choices
    for name, setting in found.items():
        assert setting.meaning, f"{name} has no meaning"
        value = config
        for part in name.split("."):
            value = value[part]
        if setting.default is not None:
            assert yaml.safe_load(setting.default) == value or setting.default == value, name
    films = {setting.name: setting for setting in list_film_settings(KINDS, schema)}
    assert films["render.shots.NAME (kind orbit).radius"].default == "0.9"
    assert all(setting.meaning for setting in films.values())


def test_settings_are_printed_by_section(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["settings", "people.fit"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "people.fit.iterations = 30" in lines
    assert not [line for line in lines if line.startswith("people.keypoint")]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from hatchling.builders.wheel import WheelBuilder

    (built,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("wheel")), versions=["standard"])
    return Path(built)


def test_the_wheel_holds_the_workflow_whole(wheel: Path) -> None:
    listing = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode:
        pytest.skip("not a repository: nobody knows which files belong to it")
    wanted = {
        name.removeprefix("workflow/")
        if name.startswith(("workflow/studiorecon/", "workflow/snakemake_logger_plugin_studiorecon/"))
        else f"studiorecon/_workflow/{name}"
        for name in listing.stdout.splitlines()
        if name.startswith(PARTS)
        and name not in LEFT_OUT
        and not name.startswith("resources/bake_")
        and (ROOT / name).exists()
    }
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
        assert (
            "studiorecon = studiorecon.cli.command:main"
            in packed.read(next(n for n in names if n.endswith("entry_points.txt"))).decode()
        )
    assert wanted <= names, sorted(wanted - names)[:5]
    assert not [
        name
        for name in names
        if "__pycache__" in name or ("resources/weights/" in name and not name.endswith("README.md"))
    ]


def installed(wheel: Path, folder: Path, *words: str) -> subprocess.CompletedProcess:
    """Run the command as installed from the wheel, in an empty folder: the wheel's files come before the checkout's."""
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder / "site")
    (folder / "empty").mkdir()
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "PATH": "/usr/bin:/bin"}
    return subprocess.run(
        [sys.executable, "-m", "studiorecon.cli.command", *words],
        cwd=folder / "empty",
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )


def test_the_demo_is_planned_from_an_installed_wheel_in_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    done = installed(wheel, tmp_path, "demo", "--cores", "1", "--", "--dry-run")
    assert done.returncode == 0, done.stdout[-3000:]
    assert f"Snakefile: {tmp_path}/site/studiorecon/_workflow/Snakefile" in done.stdout
    assert "studio_capture" in done.stdout
    assert str(ROOT) not in done.stdout.replace(sys.prefix, ""), "nothing is taken from the checkout"


@pytest.mark.slow
def test_a_studio_is_reconstructed_from_an_installed_wheel(wheel: Path, tmp_path: Path) -> None:
    done = installed(
        wheel, tmp_path, "run", "resources/studio/tiny.yaml", "--cores", "2", "--", "--config", "depth={primitives: 0}"
    )
    assert done.returncode == 0, done.stdout[-6000:]
    assert (tmp_path / "empty/results/tiny/enhance/orbit.mp4").stat().st_size > 0
    assert "results/tiny/report/index.html" in done.stdout.splitlines()[-2], "film, page, player are the last words"


def test_the_doctor_s_first_words_need_no_run(tmp_path: Path) -> None:
    (tmp_path / "videos").mkdir()
    for name, grey in (("a", 200), ("b", 40)):
        write_watchable(tmp_path / f"videos/{name}.mp4", [np.full((48, 64, 3), grey, np.uint8)] * 3, 30.0)
    reported = list(quick_check.quick_check(tmp_path))
    assert reported[0] == "calibration: none, so the keypoints of people give the cameras"
    assert any(
        t.startswith("camera a: 64×48, 30 fps, 3 frames, mean grey 0.7") and "the detector finds people" in t
        for t in reported
    )
    assert any("the exposures differ" in t for t in reported)
    (tmp_path / "videos/b.mp4").write_bytes(b"no video")
    assert any(
        t.startswith("camera b: ") and "cannot be read as a video" in t for t in quick_check.quick_check(tmp_path)
    )


def test_a_read_only_home_is_no_hindrance(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home/cache"))
    monkeypatch.chdir(tmp_path)
    assert snakemake_call.environment()["XDG_CACHE_HOME"] == str(tmp_path / "home/cache")
    monkeypatch.setattr(snakemake_call.os, "access", lambda *_: False)
    assert snakemake_call.environment()["XDG_CACHE_HOME"] == str(tmp_path / ".snakemake/cache")


@pytest.mark.parametrize("name", ["0123", "#x", "[x]", "1e5", 'a "b"', "null", "Ü"])
def test_snakemake_reads_a_folder_s_name_as_it_is(name: str) -> None:
    parse = pytest.importorskip("snakemake.cli").parse_config
    words = snakemake_call.snakemake_command("", name, "1", None, [])
    assert parse(words[words.index("--config") + 1 :]) == {"dataset": name}
