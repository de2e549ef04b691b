# SPDX-License-Identifier: Apache-2.0
"""The player in a headless browser: the same pictures as ours, no network, and a user's actions."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon.configuration.schema import mistakes
from studiorecon.deliver.player_data import Shade
from studiorecon.footage.video import to_bytes
from studiorecon.render import kinds
from studiorecon.render.composite import Composite, truth_levels
from studiorecon.render.composite_renderer import CompositeRenderer
from studiorecon.render.look_at_targets import LookAtTargets
from studiorecon.render.planning import plan_steps
from studiorecon.scene.factors import Factors
from studiorecon.window.serving import Folder

from tests.made.browser import SOFTWARE_GL, Browser, addresses_outside, memory_limited, pixels, software_gl
from tests.made.player import drawn, scene_of, shade_for, write_page
from tests.made.serving import served

pytestmark = pytest.mark.browser
FRAMES = 7
# Times of the compared pictures: an object is absent at the first, and the last two are between frames, or at the end.
TIMES = (0.0, 3.5, FRAMES - 1.0)
EVERYTHING = [None, *range(8)]
# Files of both kinds of control groups with the peak memory of their processes.
PEAKS = ("memory.max_usage_in_bytes", "memory.peak")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with software_gl(tmp_path_factory.mktemp("profile")) as one:
        yield one


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = scene_of(people=2, frames=FRAMES)
    exposure = Factors({"cam1": np.linspace(0.7, 1.0, FRAMES)[:, None] * [1.0, 0.9, 0.8]})
    return write_page(tmp_path_factory.mktemp("player") / "player.html", scene, exposure, shade_for(scene))


def opened(browser: Browser, page: Path, link: str = "frame=0") -> None:
    """The page in the browser, ready and at rest."""
    browser.open("about:blank")
    browser.logged.clear()
    browser.requested.clear()
    browser.open(f"{page.as_uri()}#{link}")
    browser.wait("!!window.player && player.drawn() > 0")


def seen(browser: Browser, **state: object) -> np.ndarray:
    """The player's picture at 160 × 100 pixels, without exposures, once ``state`` holds."""
    eye = {name: state.pop(name) for name in ("mode", "camera", "film", "picture", "eye", "target") if name in state}
    script = f"(Object.assign(player.state, {json.dumps(state)}), Object.assign(player.eye, {json.dumps(eye)}), "
    return pixels(browser, script + "player.picture({ wh: [160, 100], exposure: [1, 1, 1] }))")


def psnr(picture: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
    gap = (picture.astype(np.float64) - truth)[... if where is None else where]
    return float(10 * np.log10(255**2 / max(np.mean(gap**2), 1e-9)))


def test_it_draws_what_our_rasteriser_draws(browser: Browser, page: Path) -> None:
    """Bent and twisted people of needles (polar rotation, four bones), harmonics of degree 3, changing colours, a
    tumbling thing, shadows: at every training camera and three times."""
    scene = scene_of(people=2, frames=FRAMES)
    shade, empty = shade_for(scene), replace(scene, people=[], things=[])
    opened(browser, page)
    reported = []
    for number, camera in enumerate(scene.cameras):
        for frame in TIMES:
            ours = to_bytes(drawn(scene, camera, frame, shade))
            people = np.abs(to_bytes(drawn(empty, camera, frame, shade)).astype(int) - ours).max(axis=-1) > 8
            theirs = seen(browser, mode="camera", camera=number, frame=frame)
            reported.append((camera.name, frame, psnr(theirs, ours), psnr(theirs, ours, people), people.mean()))
    print(
        *(f"{name} frame {frame}: {a:.1f} dB, people {b:.1f} dB ({c:.0%})" for name, frame, a, b, c in reported),
        sep="\n",
    )
    assert min(entry[2] for entry in reported) > 40
    assert min(entry[3] for entry in reported) > 36
    assert min(entry[4] for entry in reported) > 0.03, "people are in every picture"
    assert not unexpected(browser)


def unexpected(browser: Browser) -> list[str]:
    """Logged messages except the driver's advice on speed, which reading pixels causes."""
    return [line for line in browser.logged if "GL Driver Message" not in line]


def test_opened_from_disk_it_asks_nobody_and_logs_nothing(browser: Browser, page: Path) -> None:
    opened(browser, page, "")
    browser.wait("player.drawn() > 3")
    assert addresses_outside(browser.requested) == []
    assert not unexpected(browser)
    assert "No graphics card" in browser.run("document.getElementById('message').textContent")
    assert (
        "No graphics card" in browser.run("[...document.querySelectorAll('#panel li')].map((li) => li.textContent)")[-1]
    )
    browser.wait("document.getElementById('poster').hidden")


def test_served_it_asks_the_same_machine_only(browser: Browser, page: Path) -> None:
    with served(Folder(page.parent)) as server:
        address = server.address("player.html")
        browser.requested.clear()
        browser.open(address)
        browser.wait("!!window.player && player.drawn() > 0")
    assert addresses_outside(browser.requested) == [address]


def test_the_same_moment_gives_the_same_picture(browser: Browser, page: Path) -> None:
    opened(browser, page)
    slide = "(at => { const slider = document.getElementById('slider'); slider.value = at; slider.oninput(); })"
    pictures = []
    for frame in (2, 5, 2):
        browser.run(f"{slide}({frame})")
        assert browser.run("player.state.frame") == frame
        pictures.append(seen(browser))
    assert (pictures[0] == pictures[2]).all()
    assert (pictures[0] != pictures[1]).any()


def test_the_truth_map_is_the_one_of_films(browser: Browser, page: Path) -> None:
    scene = scene_of(people=2, frames=FRAMES)
    canvas = CompositeRenderer(Composite(scene.room, scene.provenance, scene.people, None, scene.things), 0.2)
    opened(browser, page)
    tints = {255: (70, 130, 180), 128: (240, 200, 80), 0: (200, 80, 70)}
    for number, frame in ((0, 1.0), (1, FRAMES - 1.0)):
        levels = truth_levels(canvas.draw(scene.cameras[number], frame, (0, 0, 0))[1])
        tinted = seen(browser, mode="camera", camera=number, frame=frame, tinted=True).astype(int)
        # Half of a tinted pixel is grey: the rest of its colour shows the tint.
        apart = {
            level: np.abs((tinted - tinted.mean(-1, keepdims=True)) - (0.5 * (np.array(tint) - np.mean(tint))))
            for level, tint in tints.items()
        }
        found = np.array(list(apart))[np.argmin([gap.sum(axis=-1) for gap in apart.values()], axis=0)]
        assert (found == levels).mean() > 0.99
    assert {0, 128, 255} == set(np.unique(levels))


def test_a_person_who_is_switched_off_is_gone(browser: Browser, page: Path) -> None:
    scene, number = scene_of(people=2, frames=FRAMES), 0
    opened(browser, page)
    browser.run("player.scene.sets.forEach((set) => (set.shown = set.name !== 'p0'))")
    without = replace(scene, people=[scene.people[1]])
    assert (
        psnr(
            seen(browser, mode="camera", camera=number, frame=3.0),
            to_bytes(drawn(without, scene.cameras[number], 3.0, shade_for(scene))),
        )
        > 40
    )


def test_at_a_camera_the_picture_is_as_bright_as_the_photo(browser: Browser, page: Path) -> None:
    opened(browser, page, "camera=cam1&frame=0")
    plain = seen(browser).astype(float)
    bright = pixels(browser, "player.picture({ wh: [160, 100] })").astype(float)
    assert bright.mean(axis=(0, 1)) / plain.mean(axis=(0, 1)) == pytest.approx([0.7, 0.63, 0.56], abs=0.02)


def test_a_link_opens_what_was_seen(browser: Browser, page: Path) -> None:
    opened(browser, page, "eye=1.5,-1.5,1.2&target=0,0,1&zoom=1.3&frame=2.50&hide=p1&skeletons=1")
    first = seen(browser)
    browser.run("new Promise((done) => setTimeout(done, 900))")
    link = browser.run("location.hash")
    for part in ("eye=1.500", "zoom=1.3000", "frame=2.50", "hide=p1", "skeletons=1"):
        assert part in link
    opened(browser, page, link[1:])
    assert (seen(browser) == first).all()
    opened(browser, page, "camera=nobody&frame=x&eye=1,2&film=%00&follow=p9&picture=-4")
    assert browser.run("player.eye.mode") == "free"
    assert not unexpected(browser)


def test_keys_and_hands_move_the_view(browser: Browser, page: Path) -> None:
    opened(browser, page)

    def press(key: str) -> None:
        browser.run(f"dispatch({json.dumps(key)})")

    browser.run(
        "window.dispatch = (key) => document.getElementById('stage')"
        ".dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }))"
    )
    press("2")
    assert browser.run("[player.eye.mode, player.eye.camera]") == ["camera", 1]
    press("ArrowRight")
    assert browser.run("player.state.frame") == 1
    press("t")
    assert browser.run("player.state.tinted")
    press("0")
    assert browser.run("player.eye.mode") == "free"
    before = browser.run("player.eye.eye")
    for kind, x, button in (("mousePressed", 100, "left"), ("mouseMoved", 160, "left"), ("mouseReleased", 160, "left")):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=60, button=button, buttons=1, clickCount=1)
    after = browser.run("player.eye.eye")
    assert np.linalg.norm(np.subtract(before, after)) > 0.1
    target = browser.run("player.eye.target")
    assert np.linalg.norm(np.subtract(after, target)) == pytest.approx(np.linalg.norm(np.subtract(before, target)))


def test_a_double_click_follows_that_person(browser: Browser, page: Path) -> None:
    opened(browser, page, "frame=1&camera=cam0")
    view = "player.eye.view([innerWidth, innerHeight])"
    pixel = browser.run(f"player.pixelOf({view}, player.scene.sets[2].joints.subarray(0, 3))")
    browser.run(
        f"document.getElementById('stage').dispatchEvent(new MouseEvent('dblclick',"
        f"{{ clientX: {pixel[0]}, clientY: {pixel[1]}, bubbles: true }}))"
    )
    assert browser.run("player.eye.person") == "p1"
    person = scene_of(people=2, frames=FRAMES).people[1]
    for frame in (1.0, 4.5):
        seen(browser, frame=frame)
        assert browser.run("player.eye.target") == pytest.approx(person.joints_m(frame)[0], abs=1e-3)


def test_a_path_of_keys_is_a_film_that_validates(browser: Browser, page: Path, root: Path) -> None:
    scene = scene_of(people=2, frames=FRAMES)
    opened(browser, page, "camera=cam1&frame=0")
    add = "[...document.querySelectorAll('button')].find((one) => one.textContent === 'Add key').click()"
    browser.run(add)
    views = [(1.2, -1.8, 1.4), (1.9, 0.3, 1.1)]
    for eye, frame in zip(views, (4.0, 4.0)):
        seen(browser, mode="free", eye=eye, target=[0, 0, 1], frame=frame)
        browser.run(f"player.eye.zoom = 1.5; {add}")
    browser.run("new Promise((done) => setTimeout(done, 300))")
    text = browser.run("document.querySelector('textarea').value")
    shots = yaml.safe_load(text)["render"]["shots"]
    config = yaml.safe_load((root / "config/config.yaml").read_text())
    config["render"]["shots"] = shots
    schema = yaml.safe_load((root / "workflow/schemas/config.schema.yaml").read_text())
    assert mistakes(config, schema) == []
    assert kinds.read_film_settings(shots["mine"], "mine").kind == "spline"
    subjects = LookAtTargets({}, {}, {}, np.zeros(3), FRAMES, scene.capture.fps)
    steps = plan_steps("mine", shots, 160, 0.0, scene.cameras, [], subjects, scene.room)
    at = [key["picture"] for key in shots["mine"]["keys"]]
    assert at == [0, 4, 4 + round(scene.capture.fps)], "where time stands still the camera takes a second"
    assert [steps[picture].frame for picture in at] == pytest.approx([0, 4, 4], abs=1e-6)
    for picture, place in zip(at, [scene.cameras[1].centre_m, *views]):
        assert steps[picture].camera.centre_m == pytest.approx(place, abs=1e-3)
    # The last key's picture equals the player's there.
    ours = to_bytes(drawn(scene, steps[-1].camera, 4.0, shade_for(scene)))
    assert psnr(seen(browser, mode="free", eye=views[1], target=[0, 0, 1], frame=4.0), ours) > 38


def test_a_film_is_flown_along(browser: Browser, page: Path) -> None:
    scene = scene_of(people=2, frames=FRAMES)
    step = scene.paths["orbit"][1]
    opened(browser, page, "film=orbit&picture=1&frame=0")
    ours = to_bytes(drawn(scene, step.camera, step.frame, shade_for(scene)))
    assert psnr(seen(browser), ours) > 40
    assert browser.run("player.state.frame") == step.frame


# As on a machine that takes 400 ms for a picture.
SLOWED = """(() => {
  const { painter } = player, { draw, busy } = painter;
  let until = 0;
  painter.draw = (...given) => { draw.apply(painter, given); until = performance.now() + 400; };
  painter.busy = () => window.slowed && (performance.now() < until || busy());
})(), window.slowed = true, 0"""


def test_the_poster_stands_until_a_picture_is_drawn(browser: Browser, page: Path) -> None:
    opened(browser, page, "camera=cam0&frame=1")
    reported = browser.run(
        """new Promise((done) => {
        const told = [];
        const on = () => {
          const [poster, picture] = ["poster", "picture"].map((id) => !document.getElementById(id).hidden);
          told.push([player.pictures() > 0, poster, picture]);
          if (player.pictures() > 1) done(told); else { player.changed(); requestAnimationFrame(on); }
        };
        on();
    })"""
    )
    assert all(poster != drawn and picture == drawn for drawn, poster, picture in reported)


def test_where_drawing_is_slow_fewer_gaussians_move_and_at_rest_all_are_there(browser: Browser, page: Path) -> None:
    opened(browser, page, "")
    browser.run("Object.assign(player.state, { playing: true, loop: true }), 0")
    browser.wait("player.pictures() > 2")
    total = browser.run("player.scene.sets.reduce((sum, set) => sum + set.count, 0)")
    browser.run(SLOWED)
    browser.wait(f"player.painter.count() < {0.5 * total}")
    before = browser.run("player.pictures()")
    browser.wait(f"player.pictures() > {before + 2}")
    browser.run("window.slowed = false, player.state.playing = false, player.changed(), 0")
    browser.wait("player.rested()")
    seen_at_rest = pixels(
        browser,
        "(({ width, height }) => ({ width, height, pixels: player.painter.read() }))"
        "(document.getElementById('picture'))",
    )
    whole = pixels(browser, "player.picture()")
    assert np.abs(seen_at_rest.astype(int) - whole).max() <= 2


def test_keys_are_shown_the_view_is_reset_and_speed_and_loop_fit_a_phone(browser: Browser, page: Path) -> None:
    opened(browser, page, "frame=0")
    first = browser.run("[player.eye.eye, player.eye.target, player.eye.zoom]")
    press = (
        "document.getElementById('stage').dispatchEvent(new KeyboardEvent('keydown', {{ key: '{}', bubbles: true }}))"
    )
    browser.run("player.eye.orbit(1, 0.2), player.eye.nearer(0.5), player.eye.zoom = 2, 0")
    browser.run(press.format("r"))
    assert browser.run("[player.eye.eye, player.eye.target, player.eye.zoom]") == first
    for shown in (True, False):
        browser.run(press.format("?"))
        assert browser.run("document.getElementById('keys').open") is shown
    browser.run(press.format("f"))
    browser.wait("!!document.fullscreenElement")
    browser.run(press.format("f"))
    browser.wait("!document.fullscreenElement")
    browser.call("Emulation.setDeviceMetricsOverride", width=390, height=700, deviceScaleFactor=1, mobile=True)
    try:
        for name in ("speed", "loop", "reset", "help", "slider", "clock"):
            left, right, height = browser.run(
                f"(({{ left, right, height }}) => [left, right, height])"
                f"(document.getElementById('{name}').getBoundingClientRect())"
            )
            assert 0 <= left < right <= 390, name
            assert 15 < height < 60, name
    finally:
        browser.call("Emulation.clearDeviceMetricsOverride")


def test_on_a_phone_the_controls_leave_the_picture_free(browser: Browser, page: Path) -> None:
    browser.call("Emulation.setDeviceMetricsOverride", width=390, height=700, deviceScaleFactor=1, mobile=True)
    height = "document.getElementById('panel').getBoundingClientRect().height"
    try:
        opened(browser, page)
        assert browser.run(height) < 60, "closed at first"
        browser.run("document.querySelector('#panel > details').open = true")
        assert 150 < browser.run(height) < 0.45 * 700
    finally:
        browser.call("Emulation.clearDeviceMetricsOverride")


@pytest.mark.parametrize(("people", "frames"), [(0, 3), (7, 2), (1, 1)])
def test_scenes_of_all_sizes_open(browser: Browser, tmp_path: Path, people: int, frames: int) -> None:
    scene = scene_of(people, frames, things=False, step_m=0.5, degree=0)
    opened(browser, write_page(tmp_path / "player.html", scene), "")
    ours = to_bytes(drawn(scene, scene.cameras[0], frames - 1.0))
    assert psnr(seen(browser, mode="camera", camera=0, frame=frames - 1.0, playing=False), ours) > 38
    assert not unexpected(browser)


def test_five_minutes_open_and_end_where_they_end(browser: Browser, tmp_path: Path) -> None:
    """9,000 frames at 30 per second: the slider reaches the last one, and its picture is of that frame."""
    frames = 9000
    short = scene_of(people=2, frames=4, things=False, step_m=0.5, degree=0)
    again = np.arange(frames) % 4
    people = [
        replace(
            one, network=None, **{name: getattr(one, name)[again] for name in ("poses", "trans", "valid", "present")}
        )
        for one in short.people
    ]
    scene = replace(short, capture=replace(short.capture, frames=frames), people=people)
    opened(browser, write_page(tmp_path / "player.html", scene), "")
    assert browser.run("document.getElementById('slider').max") == "8999"
    ours = to_bytes(drawn(scene, scene.cameras[0], frames - 1.0))
    assert psnr(seen(browser, mode="camera", camera=0, frame=frames - 1.0, playing=False), ours) > 36
    assert not unexpected(browser)


def test_without_webgl2_there_is_a_picture_and_a_sentence(tmp_path: Path, page: Path) -> None:
    with Browser(tmp_path, "--disable-3d-apis") as browser:
        browser.open(page.as_uri())
        browser.wait("document.getElementById('message').textContent.includes('WebGL2')")
        assert "films in the same folder show it" in browser.run("document.getElementById('message').textContent")
        assert browser.run("document.getElementById('poster').naturalWidth") == 960
        assert browser.run("document.getElementById('panel').hidden")


def test_a_graphics_card_that_gives_up_leaves_the_picture_and_a_sentence(browser: Browser, page: Path) -> None:
    """As with too little memory: the browser loses the graphics context and all drawn content."""
    opened(browser, page)
    browser.wait("document.getElementById('poster').hidden")
    browser.run(
        "document.getElementById('picture').getContext('webgl2').getExtension('WEBGL_lose_context').loseContext(), 0"
    )
    browser.wait("document.getElementById('message').textContent.startsWith('The graphics card stopped')")
    assert browser.run("document.getElementById('poster').hidden") is False
    assert browser.run("document.getElementById('picture').hidden") is True


@pytest.mark.slow
def test_a_browser_that_gets_2_gb_shows_a_large_scene(tmp_path: Path) -> None:
    """200,000 Gaussians and seven people through 300 frames, drawn without a card, so that its memory counts too."""
    scene = scene_of(people=7, frames=300, things=False, step_m=0.022, degree=1)
    page = write_page(tmp_path / "player.html", scene)
    assert len(scene.room.means_m) > 200_000
    with memory_limited(2_000_000_000) as group, Browser(tmp_path / "profile", *SOFTWARE_GL, group=group) as browser:
        opened(browser, page, "frame=20")
        browser.wait("document.getElementById('poster').hidden")
        ours = to_bytes(drawn(scene, scene.cameras[0], 20.0))
        assert psnr(seen(browser, mode="camera", camera=0, frame=20.0, playing=False), ours) > 36
        assert not unexpected(browser)
        peak = [int((group / name).read_text()) for name in PEAKS if (group / name).exists()]
        print(f"the browser took {min(peak) / 1e6:.0f} MB")
        assert 100_000_000 < min(peak) < 2_000_000_000


def test_who_wants_no_motion_starts_at_rest(browser: Browser, page: Path) -> None:
    calm = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    browser.call("Emulation.setEmulatedMedia", features=calm)
    opened(browser, page, "")
    assert browser.run("player.state.playing") is False
    browser.call("Emulation.setEmulatedMedia", features=[])
    opened(browser, page, "")
    assert browser.run("player.state.playing") is True


def test_a_broken_page_says_so(browser: Browser, page: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.html"
    text = page.read_text(encoding="utf-8")
    start = text.index('id="bytes">') + len('id="bytes">')
    broken.write_text(text[:start] + text[start + 4000 :], encoding="utf-8")
    browser.open(broken.as_uri())
    browser.wait("document.getElementById('message').textContent.startsWith('The scene cannot be shown')")


def test_a_shade_of_one_moment_is_a_shade(browser: Browser, tmp_path: Path) -> None:
    scene = scene_of(0, 1, things=False, step_m=0.3, degree=0)
    shade = shade_for(scene)
    opened(
        browser, write_page(tmp_path / "player.html", scene, shade=Shade(shade.at, shade.times[:1], shade.factors[:1]))
    )
    twice = Shade(shade.at, np.array([0, 1]), np.repeat(shade.factors[:1], 2, axis=0))
    ours = to_bytes(drawn(scene, scene.cameras[2], 0.0, twice))
    assert psnr(seen(browser, mode="camera", camera=2), ours) > 38


def test_who_is_away_is_not_drawn(browser: Browser, tmp_path: Path) -> None:
    scene = scene_of(people=2, frames=FRAMES)
    late = replace(scene.people[1], present=np.arange(FRAMES) >= 3)
    scene = replace(scene, people=[scene.people[0], late])
    opened(browser, write_page(tmp_path / "player.html", scene))
    alone = replace(scene, people=[scene.people[0]])
    camera = scene.cameras[0]
    for frame in (0.0, 2.4, 3.0, FRAMES - 1.0):
        ours, without = (to_bytes(drawn(one, camera, frame)) for one in (scene, alone))
        assert (np.abs(ours.astype(int) - without).max() > 30) == (frame >= 2.5)
        assert psnr(seen(browser, mode="camera", camera=0, frame=frame, playing=False), ours) > 36
    assert not unexpected(browser)
