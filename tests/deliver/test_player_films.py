# SPDX-License-Identifier: Apache-2.0
"""The cameras' films over the scene, in a headless browser, as shown on its screen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.deliver import player
from studiorecon.footage.video import write_lossless
from studiorecon.scene.factors import NONE

from tests.made.browser import Browser, software_gl
from tests.made.player import WH, scene_of, write_page
from tests.made.scene import FPS

pytestmark = pytest.mark.browser
FRAMES = 4 * round(FPS)
# Every camera's film has its own colour, and a bar that reaches further to the right with every frame.
COLOURS = [(220, 40, 40), (40, 200, 40), (60, 80, 230), (210, 200, 40)]
SENTENCE = "document.getElementById('message').textContent"


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with software_gl(tmp_path_factory.mktemp("profile")) as one:
        yield one


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("player"))


def written(folder: Path) -> Path:
    """A page of a small scene whose four cameras filmed a coloured bar."""
    scene = scene_of(0, FRAMES, things=False, step_m=0.5, degree=0)
    videos = [folder / f"{camera.name}.mkv" for camera in scene.cameras]
    for video, colour in zip(videos, COLOURS):
        write_lossless(video, [bar(colour, frame) for frame in range(FRAMES)], FPS)
    return write_page(folder / "player.html", scene, NONE, None, videos)


def bar(colour: tuple[int, int, int], frame: int) -> np.ndarray:
    picture = np.zeros((WH[1], WH[0], 3), np.uint8)
    picture[:, : round((frame + 1) * WH[0] / FRAMES)] = colour
    return picture


def opened(browser: Browser, page: Path, link: str) -> None:
    browser.open("about:blank")
    browser.open(f"{page.as_uri()}#{link}")
    browser.wait("!!window.player && player.drawn() > 0")
    browser.run("player.state.opacity = 1, document.getElementById('panel').hidden = true")


def shown(browser: Browser) -> tuple[int, float]:
    """The film over the scene: the number of the camera with its colour, -1 for none, and the frame of its bar."""
    screen = cv2.imdecode(np.frombuffer(browser.screenshot(), np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(int)
    place = "document.getElementById('{}').getBoundingClientRect()"
    visible = browser.run("getComputedStyle(document.getElementById('film')).visibility") == "visible"
    left, top, width, height = browser.run(
        f"(({{ x, y, width, height }}) => [x, y, width, height])({place.format('film' if visible else 'photo')})"
    )
    row = screen[round(top + 0.3 * height), round(left) + 1 : round(left + width) - 1]
    lit = row[: max(int((row.max(axis=1) > 100).sum()), 1)].mean(axis=0)
    gaps = np.abs(np.array(COLOURS) - lit).max(axis=1)
    camera = int(gaps.argmin()) if gaps.min() < 60 else -1
    return camera, (row.max(axis=1) > 100).mean() * FRAMES - 1


def test_at_every_camera_its_film_plays(browser: Browser, page: Path) -> None:
    for number in range(len(COLOURS)):
        opened(browser, page, f"camera=cam{number}")
        browser.wait("document.getElementById('film').currentTime > 0.3")
        first, at = shown(browser), browser.run("document.getElementById('film').currentTime")
        browser.wait(f"Math.abs(document.getElementById('film').currentTime - {at}) > 0.5")
        then = shown(browser)
        assert (first[0], then[0]) == (number, number)
        assert first[1] != then[1], "the picture moves"
        assert "cannot play" not in browser.run(SENTENCE)


def test_at_rest_the_film_shows_the_frame_of_the_scene(browser: Browser, page: Path) -> None:
    opened(browser, page, "camera=cam2&frame=5")
    for frame in (5, FRAMES - 1, 17):
        browser.run(f"player.seek({frame})")
        browser.wait(
            f"(({{ seeking, readyState, currentTime }}) => !seeking && readyState > 1 && "
            f"Math.abs(currentTime - {(frame + 0.5) / FPS}) < 0.01)(document.getElementById('film'))"
        )
        browser.run("new Promise((done) => setTimeout(done, 300))")
        camera, found = shown(browser)
        assert camera == 2
        assert found == pytest.approx(frame, abs=0.6)


def test_who_switches_quickly_sees_the_last_camera_s_film_and_no_complaint(browser: Browser, page: Path) -> None:
    opened(browser, page, "camera=cam0")
    messages = browser.run(
        f"""new Promise((done) => {{
        const said = new Set();
        let turn = 0;
        const timer = setInterval(() => {{
          said.add({SENTENCE});
          player.eye.camera = turn % {len(COLOURS)};
          if (turn++ === 41) {{ clearInterval(timer); done([...said]); }}
        }}, 30);
    }})"""
    )
    assert not any("cannot play" in sentence for sentence in messages)
    browser.wait("!document.getElementById('film').paused && document.getElementById('film').readyState > 2")
    before = browser.run("document.getElementById('film').currentTime")
    browser.wait(f"Math.abs(document.getElementById('film').currentTime - {before}) > 0.3")
    assert shown(browser)[0] == 41 % len(COLOURS)
    assert "cannot play" not in browser.run(SENTENCE)


def test_a_film_that_cannot_be_played_is_reported(browser: Browser, page: Path) -> None:
    opened(browser, page, "frame=0")
    browser.run("player.scene.cameras[1].film.fill(0), Object.assign(player.eye, { mode: 'camera', camera: 1 }), 0")
    browser.wait(f"{SENTENCE}.includes('cannot play')")


def test_long_captures_show_the_photo_nearest_in_time(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(player, "FILM_FRAMES", FRAMES - 1)
    opened(browser, written(tmp_path), "camera=cam3&frame=0")
    kept = np.unique(np.rint(np.linspace(0, FRAMES - 1, player.PHOTOS)))
    for number, frame in ((3, 0), (0, FRAMES - 1), (1, 20)):
        browser.run(f"player.eye.camera = {number}, player.seek({frame})")
        browser.run("new Promise((done) => setTimeout(done, 300))")
        camera, found = shown(browser)
        assert camera == number
        assert found == pytest.approx(kept[np.abs(kept - frame).argmin()], abs=1)
