# SPDX-License-Identifier: Apache-2.0
"""What the command line is given is opened safely, and what fails ends in a sentence."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from studiorecon import __main__ as steps
from studiorecon.cli import command
from studiorecon.configuration.overlays import check_overlay
from studiorecon.detect import chapters
from studiorecon.errors import UserError
from studiorecon.machine.crash_report import FAULTS
from studiorecon.progress import say
from studiorecon.scene.names import as_paths
from studiorecon.scene.user_files import not_permitted

OVERLAYS = {
    "missing": (None, "missing"),
    "binary": (b"\x8f\x00\xff", "UTF-8"),
    "comments alone": (b"# capture: {width: 64}\n", "no settings"),
    "a list": (b"[1, 2]", "no settings"),
    "a setting twice": (b"capture: {width: 64}\ncapture: {width: 96}", "twice"),
    "octal": (b"capture: {width: 010}", "plainly"),
    "sexagesimal in a list": (b"render: {shots: {a: {keys: [1, 12:30]}}}", "plainly"),
}


@pytest.mark.parametrize(("content", "words"), OVERLAYS.values(), ids=OVERLAYS)
def test_a_file_of_settings_that_cannot_be_meant_is_refused(tmp_path: Path, content: bytes | None, words: str) -> None:
    file = tmp_path / "mine.yaml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(UserError, match=words):
        check_overlay(file)
    file.write_text("capture: {width: 64}\nstrict: on\n")
    check_overlay(file)


@pytest.mark.parametrize("closed", ["takes", "takes/cam 1"])
def test_what_is_closed_is_named_with_the_command_that_opens_it(
    closed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path / closed)
    film = tmp_path / "takes/cam 1/a.mp4"
    assert str(not_permitted(film)).endswith(f"chmod -R u+rX {shlex.quote(str(tmp_path / closed))}")


def test_a_fault_of_a_step_names_place_and_file_and_keeps_its_trace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film = tmp_path / "a.mp4"
    film.touch()

    def fail(path: Path, films: list[Path]) -> None:
        first = films[0]
        raise KeyError(first.name)

    monkeypatch.setattr(chapters, "write_chapters", fail)
    words = ["detect.chapters", "--camera", "a", "--films", str(film), "--joined", str(tmp_path / "x")]
    log = tmp_path / "step.log"
    assert steps.main([*words, "--log", str(log)]) == 1
    messages = capsys.readouterr().err
    for part in ("fault of the program", "KeyError", "detect/chapters.py, line", str(film), "report", str(log)):
        assert part in messages
    assert "Traceback" not in messages
    assert "Traceback" in log.read_text()


def test_a_step_deletes_what_a_killed_one_left_of_its_outputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chapters, "write_chapters", lambda path, films: (0, 0))
    for name in (".partial-1-x", ".partial-22-x", ".partial-1-y-x", ".partial-1-x.npz"):
        (tmp_path / name).touch()
    (tmp_path / "a.mp4").touch()
    words = ["detect.chapters", "--camera", "a", "--films", str(tmp_path / "a.mp4"), "--joined", str(tmp_path / "x")]
    steps.main([*words, "--log", str(tmp_path / "step.log")])
    assert sorted(path.name for path in tmp_path.glob(".partial-*")) == [".partial-1-x.npz", ".partial-1-y-x"]


def test_a_fault_of_the_command_is_a_sentence_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "finished_scene", lambda folder: 1 / 0)
    assert command.main(["view", "demo", "--no-browser"]) == 1
    messages = capsys.readouterr().err
    assert "ZeroDivisionError" in messages
    assert str(FAULTS) in messages
    assert "Traceback" not in messages
    assert "Traceback" in (tmp_path / FAULTS).read_text()


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_cost_nothing_but_the_output(closed: str, tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom studiorecon.machine.output import unbroken_output as u\n"
        "with u():\n print('out'); print('error', file=sys.stderr)\n"
        f" open({str(tmp_path / 'first')!r}, 'w').write('a file'); os.system('echo from below')"
    )
    done = subprocess.run(f'"{sys.executable}" -c "$CODE" {closed}', shell=True, env=os.environ | {"CODE": code})
    assert done.returncode == 0
    assert (tmp_path / "first").read_text() == "a file"


@pytest.mark.parametrize("folder", ["loop", "a" * 5000, "\udcff", ""], ids=["loop", "long", "no text", "empty"])
@pytest.mark.parametrize("word", [["view", "--no-browser"], ["doctor"]], ids=["view", "doctor"])
def test_names_that_lead_nowhere_are_refused(
    word: list[str], folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    assert command.main([word[0], folder, *word[1:]]) == 1
    messages = capsys.readouterr().err
    assert messages.startswith("studiorecon: ")
    assert "fault of the program" not in messages
    assert len(messages) < 1000


@pytest.mark.parametrize("cores", ["0", "-1", "many", ""])
def test_a_number_of_cores_that_runs_nothing_is_refused(cores: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command.main(["demo", "--cores", cores])
    assert "number of cores from 1 on" in capsys.readouterr().err


@pytest.mark.parametrize(
    "environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}]
)
def test_a_terminal_of_ascii_gets_every_sentence(environment: dict[str, str]) -> None:
    code = "from studiorecon.machine.output import unbroken_output as u\nwith u(): print('320\\xd7180')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=os.environ | environment, check=True)
    assert done.stdout.startswith(b"320")
    assert done.stdout.isascii()


def test_work_goes_on_where_nobody_reads_its_output(tmp_path: Path) -> None:
    written = tmp_path / "done"
    code = (
        "import sys\nfrom pathlib import Path\nfrom studiorecon.machine.output import unbroken_output as u\n"
        f"with u():\n for k in range(100000): print(k)\n Path({str(written)!r}).touch()"
    )
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([sys.executable, "-c", code], stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")
    assert written.exists()


@pytest.mark.parametrize("name", ["cam\n1", "a\rb", "\u202ecam", "cam\udcff", "\x1b[31m"])
def test_names_of_files_cannot_change_a_sentence(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    refusal = str(UserError(f"{name}.mp4 × 2 cannot be read"))
    assert refusal.isprintable()
    assert refusal.endswith(".mp4 × 2 cannot be read")
    say(f"{name}.mp4")
    assert capsys.readouterr().out.count("\n") == 1


def test_a_folder_called_as_an_option_is_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "-rf/videos").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert as_paths(["-rf", "-n", "-", "-rf/videos", "videos"]) == ["./-rf", "-n", "-", "./-rf/videos", "videos"]

    def run(film: Path) -> None: ...

    assert steps._parse("clocks.moments", run, ["--film", "-rf/videos"])["film"] == Path("-rf/videos")


def test_numpy_is_loaded_after_its_threads_are_chosen() -> None:
    """It reads once how many threads it may use; until a step sets them, the package must not load it."""
    asked = "import sys, studiorecon.__main__; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", asked], check=False).returncode == 0
