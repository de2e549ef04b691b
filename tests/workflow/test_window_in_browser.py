# SPDX-License-Identifier: Apache-2.0
"""The window as people use it, in a browser: from an empty folder to the film, and a swap corrected by clicks."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from studiorecon.cli.takes import write_rows
from studiorecon.scene.people import read_identities, write_identities
from studiorecon.window import app, runs

from tests.made.browser import SOFTWARE_GL, Browser, addresses_outside
from tests.made.serving import served, small_film
from tests.workflow.conftest import QUICK, House

pytestmark = pytest.mark.browser


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    with Browser(tmp_path / "profile", *SOFTWARE_GL, size=(1440, 900)) as one:
        yield one


def drop(browser: Browser, *files: Path) -> None:
    """Files or folders, dragged from the desktop into the middle of the page."""
    data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        browser.call("Input.dispatchDragEvent", type=kind, x=700, y=400, data=data)


def click(browser: Browser, text: str) -> None:
    """A click on the button with this text, once it is there and can be pressed."""
    found = f"[...document.querySelectorAll('button')].find((b) => b.textContent === {json.dumps(text)} && !b.disabled)"
    browser.wait(f"!!({found})", 120)
    browser.run(f"{found}.click()")


def test_dropped_films_are_shown_and_names_are_text(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)
    started: list[str] = []
    monkeypatch.setattr(runs, "start_run", lambda goal, *_: started.append(goal))
    for number, name in enumerate(("left", "right")):
        small_film(tmp_path / "desktop" / f"{name}.mp4", number)
    hostile = tmp_path / "desktop/<img src=x onerror=hacked=1>.txt"
    hostile.write_text("no film")
    with served(app.build_app()) as server:
        browser.open(server.address(""))
        browser.wait("!!document.querySelector('.drop')")
        drop(browser, *sorted((tmp_path / "desktop").iterdir()))
        browser.wait("document.querySelectorAll('figure img').length === 2", 120)
        browser.wait("[...document.images].every((one) => one.naturalWidth > 0)")
        assert "onerror" in browser.run("document.querySelector('.warn').textContent"), "not used, with its name"
        assert not browser.run("!!window.hacked")
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        assert {one.partition("/api/")[0] for one in addresses_outside(browser.requested)}
        assert all(one.startswith(server.address("")) for one in addresses_outside(browser.requested))
        browser.wait("document.getElementById('message').textContent.endsWith('copied')")
        assert started == ["doctor"]
        (made,) = [folder for folder in home.iterdir() if folder.name.startswith("take-")]
        assert sorted(path.name for path in (made / "videos").iterdir()) == ["left.mp4", "right.mp4"]


def test_takes_are_chosen_from_a_list_and_the_table_is_shown(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    started: list[list[str]] = []
    monkeypatch.setattr(runs, "start_run", lambda goal, scene, command: started.append(command[3:]))
    names = ["monday", "noon", "<b>odd"]
    for name in names:
        for number, camera in enumerate("ab"):
            small_film(tmp_path / name / "videos" / f"{camera}.mp4", number)
    write_rows([{"take": name, "result": result} for name, result in zip(names, ("done", "failed", "not run"))])
    with served(app.build_app()) as server:
        browser.open(server.address("#/takes"))
        browser.wait("document.querySelectorAll('.take').length === 3", 60)
        assert browser.run("document.getElementById('make').disabled"), "one take is no batch"
        cells = browser.run("[...document.querySelectorAll('td')].map((one) => one.textContent)")
        assert {*names, "done", "failed", "not run"} <= {*cells}
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        browser.run("document.querySelectorAll('.take input').forEach((one, k) => k && one.click())")
        browser.wait("!!document.querySelector('input[value=look]')", 120)
        browser.run("document.querySelector('input[value=look]').click()")
        click(browser, "Run these takes")
        browser.wait("document.getElementById('message').textContent.includes('first take')")
    assert started == [["run", "./monday", "./noon", "--preset", "look"]]


@pytest.mark.slow
def test_from_an_empty_folder_to_the_film_and_a_swap_is_corrected(
    browser: Browser, finished: House, tmp_path: Path
) -> None:
    home, desktop = tmp_path / "home", tmp_path / "desktop/take"
    home.mkdir()
    shutil.copytree(finished.folder / "results/studio/tiny/dataset", desktop)
    right = read_identities(finished.folder / "results/tiny/people/identities.tsv")
    other = {"p0": "p1", "p1": "p0"}
    planted = {key: other[person] if key[0] == "cam2" else person for key, person in right.items()}
    write_identities(desktop / "identities.tsv", planted)
    (home / "take.settings.yaml").write_text(yaml.safe_dump(QUICK))
    command = [sys.executable, "-m", "studiorecon.cli.command", "open", str(home), "--no-browser", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as window:
        assert window.stdout is not None
        browser.open(window.stdout.readline().split()[0])
        browser.wait("!!document.querySelector('.drop')")
        drop(browser, desktop)
        browser.wait("document.querySelectorAll('figure img').length === 5", 120)
        browser.wait("!!document.querySelector('input[value=look]')", 120)
        browser.run("document.querySelector('input[value=look]').click()")
        click(browser, "Make the film")
        browser.wait("!!document.querySelector('.bar')", 60)
        # The browser leaves in the middle; the run goes on.
        address = browser.run("location.href")
        browser.open("about:blank")
        time.sleep(5)
        browser.open(address)
        browser.wait("!!document.querySelector('video[controls]')", 900)
        assert (home / "results/take/enhance/orbit.mp4").is_file()
        # A path is flown in the player, and its film is shown as soon as it is there.
        click(browser, "Fly")
        player = "document.querySelector('iframe').contentWindow.player"
        browser.wait(f"!!{player}?.addKey", 120)
        for step_m in (0.0, 0.3):
            browser.run(f"{player}.eye.letGo(), {player}.eye.eye[2] += {step_m}, {player}.changed()")
            click(browser, "Add this view")
        click(browser, "Film this path")
        browser.wait("!!document.querySelector('video[controls][src*=flight]')", 600)
        assert (home / "results/take/enhance/flight.mp4").is_file()
        click(browser, "People")
        browser.wait("document.querySelectorAll('.view canvas').length === 4", 60)
        place = browser.run(
            "(() => { const lane = [...document.querySelectorAll('.lane button')]"
            ".find((b) => b.title.startsWith('cam2'));"
            " lane.click(); return lane.title; })()"
        )
        assert place.startswith("cam2")
        browser.run("[...document.querySelectorAll('button')].find((b) => b.textContent.startsWith('Swap')).click()")
        click(browser, "Save")
        browser.wait("!!document.getElementById('again')", 300)
        listed = browser.run("document.getElementById('again').parentElement.textContent")
        assert "people associate" in listed
        assert "capture frames" not in listed
        assert read_identities(home / "take/identities.tsv") == right
        browser.run("document.getElementById('again').click()")
        browser.wait("!!document.querySelector('.bar')", 60)
        click(browser, "Stop")
        browser.wait("!document.querySelector('.bar')", 60)
        window.terminate()
