# SPDX-License-Identifier: Apache-2.0
"""The player inside another page, with another scene, and in a headset that is not there."""

from __future__ import annotations

import http.server
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.made.browser import Browser, addresses_outside, pixels, software_gl
from tests.made.player import scene_of, write_page

pytestmark = pytest.mark.browser
AROUND = """<!doctype html><iframe id="inside" width="400" height="260" src="SRC"></iframe><script>
const got = [];
addEventListener("message", (event) => got.push({ ...event.data, origin: event.origin }));
const ask = (message) => document.getElementById("inside").contentWindow.postMessage(message, "*");
const state = () => got.filter((one) => one.studiorecon === "state").at(-1);
</script>"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        return None


@contextmanager
def hosted(folder: Path) -> Iterator[str]:
    """The origin of a plain server of a folder."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with software_gl(tmp_path_factory.mktemp("profile")) as one:
        yield one


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    write_page(folder / "player.html", scene_of(people=1, frames=7))
    write_page(folder / "other.html", scene_of(people=2, frames=3))
    (folder / "none.html").write_text("<p>no scene</p>")
    return folder


def around(browser: Browser, site: Path, own: str, src: str) -> None:
    (site / "around.html").write_text(AROUND.replace("SRC", src))
    browser.open(f"{own}/around.html")


def test_a_page_around_it_sets_and_hears_time_and_view(browser: Browser, site: Path) -> None:
    with hosted(site) as own:
        around(browser, site, own, "player.html")
        browser.wait("got.some((one) => one.studiorecon === 'ready')")
        about = browser.run("got[0]")
        assert (about["frames"], len(about["people"]), about["origin"]) == (7, 1, own)
        first = {"studiorecon": "set", "view": {"camera": about["cameras"][1], "frame": 3}, "playing": False}
        browser.run(f"ask({json.dumps(first)})")
        browser.wait("state()?.view.camera")
        heard = browser.run("state()")
        assert heard["view"]["camera"] == about["cameras"][1]
        assert (heard["frame"], heard["playing"]) == (3, False)
        browser.run("ask({studiorecon: 'set', view: {eye: [1, -2, 1.5], target: [0, 0, 1], hide: 'room'}})")
        browser.wait("state()?.mode === 'free'")
        heard = browser.run("state()")
        assert heard["view"]["eye"] == "1.000,-2.000,1.500"
        assert heard["frame"] == 3, "what is not named stays"
        browser.run(f"ask({{studiorecon: 'set', time_s: {5 / about['fps']}}})")
        browser.wait("Math.abs(state().frame - 5) < 1e-6")
        assert browser.run("state().view.hide") == "room"
        browser.run("ask({studiorecon: 'set', playing: true})")
        browser.wait("state().playing && state().frame !== 5")
        browser.run("ask({studiorecon: 'set', playing: false})")
        browser.run(
            "['set', 7, null, {studiorecon: 'else'}, {studiorecon: 'set', view: 'x', time_s: 'y'}].forEach(ask)"
        )
        browser.run("new Promise((done) => setTimeout(done, 300))")
        assert not [line for line in browser.logged if "Error" in line]


def test_only_the_page_that_is_named_or_of_the_same_server_is_answered(browser: Browser, site: Path) -> None:
    with hosted(site) as own, hosted(site) as other:
        around(browser, site, own, f"{other}/player.html")
        browser.run("new Promise((done) => setTimeout(done, 2500))")
        browser.run("ask({studiorecon: 'get'})")
        browser.run("new Promise((done) => setTimeout(done, 500))")
        assert browser.run("got.length") == 0
        around(browser, site, own, f"{other}/player.html?origin={own}")
        browser.wait("got.some((one) => one.studiorecon === 'ready')")
        browser.run("ask({studiorecon: 'get'})")
        browser.wait("!!state()")
        assert browser.run("state().origin") == other


def test_it_shows_another_scene_of_the_same_server_only(browser: Browser, site: Path) -> None:
    with hosted(site) as own, hosted(site) as other:
        browser.requested.clear()
        browser.open(f"{own}/player.html?src=other.html#frame=1")
        browser.wait("!!window.player && player.drawn() > 0")
        assert browser.run("player.last") == 2
        assert {one.partition("?")[0] for one in addresses_outside(browser.requested)} == {
            f"{own}/player.html",
            f"{own}/other.html",
        }
        message = "document.getElementById('message').textContent"
        for src, sentence in (
            ("none.html", "no player of a scene"),
            ("nowhere.html", "not there (404)"),
            (f"{other}/other.html", "the same server"),
        ):
            browser.open("about:blank")
            browser.open(f"{own}/player.html?src={src}")
            browser.wait(f"{message}.includes('cannot be shown')")
            assert sentence in browser.run(message)


# A headset with two eyes that looks ahead from 1.6 m above the floor, drawn into half of a canvas each.
HEADSET = """(() => {
  const q = { x: 0, y: 0, z: 0, w: 1 }, f = 1.2, p = [f, 0, 0, 0, 0, f, 0, 0, 0.1, 0, -1, -1, 0, 0, -0.2, 0];
  const eye = (x) => ({ projectionMatrix: p, transform: { orientation: q, position: { x, y: 1.6, z: 0 } } });
  window.drawnFrames = 0;
  const session = new EventTarget();
  Object.assign(session, {
    updateRenderState: () => {}, requestReferenceSpace: async () => ({}),
    requestAnimationFrame: (does) => requestAnimationFrame((now) => {
      if (session.ended) return;
      does(now, { getViewerPose: () => ({ views: [eye(-0.03), eye(0.03)] }) });
      window.drawnFrames++;
    }),
    end: () => { session.ended = true; session.dispatchEvent(new Event("end")); },
  });
  window.XRWebGLLayer = class {
    constructor(session, gl) {
      this.framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      const target = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, target);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, 128, 64);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, target);
      window.layer = this;
    }
    getViewport(one) { return { x: one.transform.position.x > 0 ? 64 : 0, y: 0, width: 64, height: 64 }; }
  };
  const xr = { isSessionSupported: async () => true, requestSession: async () => (window.session = session) };
  Object.defineProperty(navigator, "xr", { value: xr });
  WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
})()"""
SEEN = """(() => {
  const { gl } = player.painter, pixels = new Uint8Array(128 * 64 * 4);
  gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
  gl.readPixels(0, 0, 128, 64, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return { width: 128, height: 64, pixels };
})()"""


def test_a_headset_shows_both_eyes_where_the_browser_has_one(browser: Browser, site: Path) -> None:
    with hosted(site) as own:
        browser.open("about:blank")
        browser.open(f"{own}/player.html#frame=1")
        browser.wait("!!window.player && player.drawn() > 0")
        assert browser.run("document.getElementById('headset').hidden"), "no button without a headset"
        stub = browser.call("Page.addScriptToEvaluateOnNewDocument", source=HEADSET)["identifier"]
        browser.open("about:blank")
        browser.open(f"{own}/player.html#eye=0,-2.5,1&target=0,0,1&frame=1")
        browser.wait("!!window.player && player.drawn() > 0 && !document.getElementById('headset').hidden")
        browser.run("document.getElementById('headset').click()")
        browser.wait("drawnFrames > 8")
        both = pixels(browser, SEEN)[::-1].astype(int)
        # The same view as a page would draw: 1.6 m above where the eye was, looking along y, off its axis by 0.1.
        view = {
            "wh": [64, 64],
            "focal": [38.4, 38.4],
            "principal": [28.8, 32.0],
            "rotation": [1, 0, 0, 0, 0, -1, 0, 1, 0],
        }
        browser.run("session.end(); player.hold(true)")
        for k, x in enumerate((-0.03, 0.03)):
            here = json.dumps(view | {"eye": [x, -2.5, 1.6], "offset": [-x, 1.6, 2.5]})
            script = (
                f"player.order({here}).then((order) => (player.painter.setOrder(order), player.painter.draw({here})))"
            )
            flat = pixels(browser, f"{script}.then(() => ({{ width: 64, height: 64, pixels: player.painter.read() }}))")
            assert flat.std() > 10
            assert np.abs(both[:, 64 * k : 64 * k + 64] - flat).mean() < 2, f"eye {k}"
        browser.run("player.hold(false)")
        browser.wait("player.rested()")
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=stub)
        assert not [line for line in browser.logged if "Error" in line]
