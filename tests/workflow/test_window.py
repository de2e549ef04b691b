# SPDX-License-Identifier: Apache-2.0
"""``studiorecon open``: what its pages ask the server for, and bad input of every kind."""

from __future__ import annotations

import errno
import http.client
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
import yaml
from studiorecon.cli.run_progress import PROGRESS
from studiorecon.errors import UserError
from studiorecon.scene.files import write_json
from studiorecon.window import app, people, projects, runs, shots
from studiorecon.window.serving import LocalServer

from tests.made.serving import served, small_film

HOSTILE = ["a b", "Ä+é", "<b>x", "a&b", "%2e%2e", "it's", '"q"', "$(touch x)", "-rf"]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def window(home: Path) -> Iterator[LocalServer]:
    with served(app.build_app()) as server:
        yield server


def request(window: LocalServer, path: str, given: Any = None, **headers: str) -> tuple[int, Any]:
    """Status and content (JSON, or bytes) of a GET, or of a POST of ``given`` from the window's own page."""
    plug = http.client.HTTPConnection("127.0.0.1", window.port, timeout=60)
    body = given if isinstance(given, bytes) or given is None else json.dumps(given).encode()
    own = {} if given is None else {"Origin": f"http://127.0.0.1:{window.port}"}
    plug.request("GET" if given is None else "POST", f"/{window.token}/{path}", body, {**own, **headers})
    answer = plug.getresponse()
    content = answer.read()
    plug.close()
    is_json = answer.getheader("content-type", "").startswith("application/json")
    return answer.status, json.loads(content) if is_json else content


def test_dropped_films_become_a_project_that_is_understood(window: LocalServer, home: Path) -> None:
    assert request(window, "api/projects")[1]["projects"] == []
    assert request(window, "api/new", {"name": "monday"})[0] == 200
    for number, camera in enumerate(("left", "right")):
        content = small_film(home / "elsewhere" / f"{camera}.mp4", number)
        assert request(window, f"api/upload/monday?path={camera}.mp4", content)[1] == f"monday/videos/{camera}.mp4"
    request(window, "api/upload/monday?path=notes/read.txt", b"hello")
    request(window, "api/upload/monday?path=spare.toml", b"x = 1")
    about = request(window, "api/project/monday")[1]
    assert [camera["name"] for camera in about["cameras"]] == ["left", "right"]
    assert "64×48, 15 fps, 6 frames" in about["cameras"][0]["facts"][0]
    assert any(line.startswith("notes/") for line in about["unused"])
    assert any("spare.toml" in line and "capture.yaml" in line for line in about["unused"])
    assert request(window, "api/thumbnail/monday/left")[1].startswith(b"\xff\xd8")
    assert [offer["preset"] for offer in request(window, "api/presets/monday")[1]] == ["look", "", "standard"]
    assert request(window, "api/upload/monday?path=left.mp4", b"other")[0] == 400, "nothing is replaced"


def test_a_folder_of_this_machine_is_used_where_it_is(window: LocalServer, home: Path) -> None:
    other = home / "far/away/take7"
    for number, camera in enumerate("ab"):
        small_film(other / "videos" / f"{camera}.mp4", number)
    assert request(window, "api/link", {"folder": str(other)}) == (200, "take7")
    assert (home / "take7").is_symlink()
    assert len(request(window, "api/project/take7")[1]["cameras"]) == 2
    for wrong in ("take7", "/no/such", str(home / "far")):
        assert request(window, "api/link", {"folder": wrong})[0] == 400


def test_a_folder_without_videos_says_what_is_missing(window: LocalServer) -> None:
    request(window, "api/new", {"name": "empty"})
    about = request(window, "api/project/empty")[1]
    assert "put one video" in about["error"]
    assert about["cameras"] == []


@pytest.mark.parametrize("name", ["..", "../x", "a/b", ".hidden", "results", "", "x" * 300, "a\0b", "<script>", "-rf"])
def test_names_that_no_scene_can_have_make_nothing(window: LocalServer, home: Path, name: str) -> None:
    assert request(window, "api/new", {"name": name})[0] in (400, 500)
    assert list(home.iterdir()) == []


@pytest.mark.parametrize("path", ["../../x", "/etc/x", ".bashrc", "a/../../x", "a//b", "a\\b", "", ".", "a/.x"])
def test_a_drop_stays_in_its_project(window: LocalServer, home: Path, path: str) -> None:
    request(window, "api/new", {"name": "take"})
    assert request(window, f"api/upload/take?path={quote(path, safe='')}", b"x")[0] == 400
    assert [p.name for p in home.rglob("*")] == ["take", "videos"]


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_of_files_are_data(window: LocalServer, home: Path, name: str) -> None:
    request(window, "api/new", {"name": "take"})
    assert request(window, f"api/upload/take?path={quote(name, safe='')}.mp4", b"no film")[0] == 200
    assert (home / "take/videos" / f"{name}.mp4").read_bytes() == b"no film"
    assert request(window, "api/project/take")[1]["error"], "a sentence, whatever the name"


def test_a_full_disk_is_a_sentence_and_leaves_no_half(
    window: LocalServer, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    request(window, "api/new", {"name": "take"})

    async def full(write: Callable[..., Any], *given: Any) -> Any:
        if getattr(write, "__name__", "") == "write":
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(*given)

    monkeypatch.setattr(app, "run_in_threadpool", full)
    status, said = request(window, "api/upload/take?path=a.mp4", b"x" * 100)
    assert status == 400
    assert "disk is full" in said["error"]
    assert list((home / "take/videos").iterdir()) == []


def test_a_drop_that_breaks_off_leaves_no_half(window: LocalServer, home: Path) -> None:
    request(window, "api/new", {"name": "take"})
    plug = http.client.HTTPConnection("127.0.0.1", window.port, timeout=60)
    plug.putrequest("POST", f"/{window.token}/api/upload/take?path=a.mp4")
    plug.putheader("Origin", f"http://127.0.0.1:{window.port}")
    plug.putheader("Content-Length", "1000")
    plug.endheaders(b"half")
    time.sleep(0.3)
    plug.close()
    until = time.monotonic() + 10
    while list((home / "take/videos").iterdir()):
        assert time.monotonic() < until
        time.sleep(0.05)


def test_only_the_window_itself_changes_something(window: LocalServer, home: Path) -> None:
    for origin in ("http://example.org", "null", f"http://127.0.0.1:{window.port + 1}"):
        assert request(window, "api/new", {"name": "evil"}, Origin=origin)[0] == 403
    token, window.token = window.token, "guess"
    assert request(window, "api/new", {"name": "evil"})[0] == request(window, "api/projects")[0] == 404
    window.token = token
    assert list(home.iterdir()) == []


def test_capture_yaml_is_checked_before_it_is_replaced(window: LocalServer, home: Path) -> None:
    request(window, "api/new", {"name": "take"})
    mine = "# by hand\nheld_out: [b]\n"
    assert request(window, "api/capture", {"name": "take", "text": mine})[0] == 200
    assert (home / "take/capture.yaml").read_text() == mine
    status, said = request(window, "api/capture", {"name": "take", "text": "heldout: [b]\n"})
    assert (status, "did you mean held_out" in said["error"]) == (400, True)
    assert (home / "take/capture.yaml").read_text() == mine
    assert not list((home / "take").glob(".tried*"))


@pytest.fixture
def stand_in(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Instead of Snakemake a process that waits for the file ``go``, ends at once on an interrupt, and says so."""
    script = home / "snakemake.py"
    script.write_text(
        "import os, pathlib, signal, sys, time\n"
        "signal.signal(signal.SIGINT, lambda *_: (pathlib.Path('interrupted').touch(), sys.exit(1)))\n"
        "pathlib.Path('began').write_text(str(os.getpid()))\n"
        "while not pathlib.Path('go').exists(): time.sleep(0.02)\n"
        "print('1 of 1 steps (100%) done')\n"
    )
    monkeypatch.setattr(app, "snakemake_command", lambda *_: [sys.executable, str(script), "config/presets/look.yaml"])
    for number, camera in enumerate("ab"):
        small_film(home / "take/videos" / f"{camera}.mp4", number)
    return script


def wait(true: Callable[[], Any]) -> None:
    until = time.monotonic() + 20
    while not true():
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_run_outlives_the_window_and_both_windows_show_it(home: Path, stand_in: Path) -> None:
    with served(app.build_app()) as first, served(app.build_app()) as second:
        assert request(first, "api/start", {"name": "take", "goal": "film"})[0] == 200
        for window in (first, second):
            assert request(window, "api/run")[1]["run"]["scene"] == "take"
            status, said = request(window, "api/start", {"name": "take", "goal": "film"})
            assert (status, "a run of take is on" in said["error"]) == (400, True)
    assert runs.current_run() is not None, "its windows are closed, and it goes on"
    wait((home / "began").exists)
    (home / "go").touch()
    wait(lambda: runs.current_run() is None)
    last = runs.last_run("take")
    assert (last["unfinished"], last["preset"]) == (False, "look")


def test_stop_interrupts_and_the_run_can_go_on(home: Path, stand_in: Path, window: LocalServer) -> None:
    request(window, "api/start", {"name": "take", "goal": "film"})
    wait((home / "began").exists)
    assert request(window, "api/stop", {})[0] == 200
    assert (home / "interrupted").exists()
    assert runs.current_run() is None
    assert runs.last_run("take")["unfinished"]
    (home / "go").touch()
    assert request(window, "api/start", {"name": "take", "goal": "film"})[0] == 200
    wait(lambda: runs.current_run() is None)


@pytest.mark.parametrize(
    ("log", "why"),
    [
        (
            "Job stats:\nLogfile x.log:\n=====\nwarning: dim\ndetect.keypoints: set keypoint_layout\n=====\nend",
            1,
        ),
        ("Using workflow specific profile\nConfig file a is extended\nthere is no dataset; give one\n", 1),
        ("Job stats:\nall 1\nExecute 1 jobs\n", 0),
        ("Nothing to be done\n", 0),
    ],
)
def test_a_failed_run_says_why(home: Path, log: str, why: int) -> None:
    runs.log_file("take").parent.mkdir(parents=True)
    runs.log_file("take").write_text(f"$ python -m snakemake\n{log}")
    said = runs.last_run("take")["why"]
    assert len(said) == why
    assert not any(line.startswith(("warning", "Using", "Config")) for line in said)


def test_a_check_makes_room_for_the_film(home: Path, stand_in: Path, window: LocalServer) -> None:
    request(window, "api/start", {"name": "take", "goal": "doctor"})
    wait((home / "began").exists)
    assert request(window, "api/start", {"name": "take", "goal": "film"})[0] == 200
    assert request(window, "api/run")[1]["run"]["goal"] == "film"
    (home / "go").touch()
    wait(lambda: runs.current_run() is None)


def test_takes_run_one_after_another_and_stop(home: Path, stand_in: Path, window: LocalServer) -> None:
    runs.start_run("takes", "", [sys.executable, "-c", f"import subprocess; subprocess.call(['python', '{stand_in}'])"])
    assert runs.current_run() is not None
    wait(lambda: (home / "began").exists() and (home / "began").read_text())
    child = int((home / "began").read_text())
    write_json(PROGRESS, {"scene": "take", "on": True, "pid": child, "done": 3, "total": 9, "failed": []})
    run = request(window, "api/takes")[1]["run"]
    assert (run["goal"], run["scene"], run["ours"], run["done"]) == ("takes", "take", True, 3)
    assert request(window, "api/stop", {})[0] == 200
    assert (home / "interrupted").exists()
    assert runs.current_run() is None


def test_the_table_of_takes_has_every_chosen_one(window: LocalServer, home: Path) -> None:
    for name in ("one", "-two", "three"):
        (home / name / "videos").mkdir(parents=True)
    assert request(window, "api/takes")[1] == {"run": None, "rows": []}
    assert request(window, "api/takes", {"names": ["one", "nowhere"], "preset": ""})[0] == 400
    assert request(window, "api/takes", {"names": ["one", "-two"], "preset": "look"})[0] == 200
    until = time.monotonic() + 60
    while runs.current_run():
        assert time.monotonic() < until
        time.sleep(0.1)
    rows = request(window, "api/takes")[1]["rows"]
    assert {(row["take"], row["result"]) for row in rows} == {("one", "failed"), ("-two", "failed")}
    assert all("put one video" in row["notes"] for row in rows)


def test_a_run_of_a_terminal_is_shown_and_not_stopped(home: Path, stand_in: Path, window: LocalServer) -> None:
    with subprocess.Popen([sys.executable, str(stand_in)], cwd=home) as terminal:
        try:
            wait((home / "began").exists)
            write_json(
                PROGRESS, {"scene": "take", "on": True, "pid": terminal.pid, "done": 3, "total": 9, "failed": []}
            )
            run = request(window, "api/run")[1]["run"]
            assert (run["ours"], run["done"], run["total"]) == (False, 3, 9)
            assert request(window, "api/start", {"name": "take", "goal": "film"})[0] == 400
            assert "terminal" in request(window, "api/stop", {})[1]["error"]
        finally:
            terminal.send_signal(signal.SIGKILL)
        terminal.wait()
        assert request(window, "api/run")[1]["run"] is None, "a killed run is not on, whatever its file says"


def test_a_run_is_shown_where_its_session_began_outside_of_the_container(
    home: Path, stand_in: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getsid", lambda _pid: 0)
    with subprocess.Popen([sys.executable, str(stand_in)], cwd=home) as terminal:
        try:
            wait((home / "began").exists)
            write_json(PROGRESS, {"scene": "take", "on": True, "pid": terminal.pid})
            assert runs.current_run() is not None
        finally:
            terminal.send_signal(signal.SIGKILL)


def test_a_window_that_nobody_uses_costs_nothing(window: LocalServer) -> None:
    request(window, "api/projects")
    time.sleep(0.3)
    before = os.times()
    time.sleep(1.0)
    after = os.times()
    assert after.user + after.system - before.user - before.system < 0.03


KEYS = "      kind: spline\n      keys:\n      - {picture: 0, eye_m: [1, 0, 1], target: [0, 0, 1], frame: 0}\n"
SHOT = f"render:\n  shots:\n    NAME:\n{KEYS}      - {{picture: 30, camera: a, frame: 5}}\n"


def test_flown_paths_are_added_to_what_was_written(home: Path, stand_in: Path) -> None:
    assert shots.save_shot("take", "one", SHOT.replace("NAME", "one")) == "take.shots.yaml"
    file = home / "take.shots.yaml"
    file.write_text(file.read_text() + "# mine\n")
    shots.save_shot("take", "two", SHOT.replace("NAME", "two"))
    assert "# mine" in file.read_text()
    assert list(yaml.safe_load(file.read_text())["render"]["shots"]) == ["one", "two"]
    before = file.read_text()
    for name, text in (
        ("one", SHOT), ("orbit", SHOT), ("a b", SHOT), ("three", "x: 1"), ("four", SHOT.replace("eye_m", "eye")),
    ):  # fmt: skip
        with pytest.raises(UserError):
            shots.save_shot("take", name, text.replace("NAME", name))
    assert file.read_text() == before


def test_the_folder_may_be_a_capture_itself(home: Path, stand_in: Path) -> None:
    assert projects.enter(home / "take") == "#take"
    assert Path.cwd() == home
    assert projects.enter(Path()) == ""
    with pytest.raises(UserError, match="there is no folder"):
        projects.enter(home / "nowhere")


def test_corrected_identities_are_written_as_a_person_would(
    home: Path, stand_in: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Found:
        def __init__(self, camera: str) -> None:
            self.camera, self.track = camera, np.array([0, 1, 1])

    monkeypatch.setattr(people, "_detections", lambda _: [Found("a"), Found("b")])
    rows = [("a", 0, "p0"), ("a", 1, "p1"), ("b", 0, "p1"), ("b", 1, "p0")]
    assert people.save_identities("take", rows) == "take/identities.tsv"
    text = (home / "take/identities.tsv").read_text()
    assert text.splitlines() == ["camera\ttrack\tperson", "a\t0\tp0", "a\t1\tp1", "b\t0\tp1", "b\t1\tp0"]
    with pytest.raises(UserError, match="two cameras"):
        people.save_identities("take", [("a", 0, "p7")])
    assert (home / "take/identities.tsv").read_text() == text
