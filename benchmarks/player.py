# SPDX-License-Identifier: Apache-2.0
"""Pictures per second of the player without a graphics card: ``python -m benchmarks.player [PAGE ...]``.

Made rooms of three sizes with two people, or the given ``player.html`` files, play at 640×360 in Chromium's software
WebGL. Prints one table; returns 1 where a scene is drawn fewer than two times a second. Half a minute per scene.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from tests.made.browser import software_gl
from tests.made.player import scene_of, write_page

WH = (640, 360)
MIN_PICTURES_PER_S = 2.0
# Before this the player has not yet adapted the number of Gaussians to the machine.
SETTLE_S, MEASURED_S = 10.0, 10.0
# Spacing of the made room's Gaussians: 50,000, 200,000 (the default's size) and 450,000 of them.
STEPS_M = (0.045, 0.0225, 0.015)


def pace(page: Path, folder: Path) -> tuple[int, float, float]:
    """(Gaussians, pictures per second, share of the Gaussians that was drawn) of a playing page."""
    with software_gl(folder, size=WH) as browser:
        browser.open(page.as_uri())
        browser.wait("window.player && player.pictures() > 0", 180)
        browser.run("Object.assign(player.state, { playing: true, loop: true }), player.eye.reset(), 0")
        time.sleep(SETTLE_S)
        before, start = browser.run("player.pictures()"), time.monotonic()
        time.sleep(MEASURED_S)
        drawn, passed = browser.run("player.pictures()") - before, time.monotonic() - start
        total = browser.run("player.scene.size")
        return total, drawn / passed, browser.run("player.painter.count()") / total


def main(pages: list[str]) -> int:
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        named = [Path(page).resolve() for page in pages]
        for step_m in [] if named else STEPS_M:
            scene = scene_of(people=2, frames=60, things=False, step_m=step_m, degree=1)
            named.append(write_page(folder / f"room{len(named)}.html", scene))
        print(f"{'page':24s} {'Gaussians':>10s} {'pictures/s':>10s} {'drawn':>6s}   at {WH[0]}×{WH[1]}, software WebGL")
        slow = 0
        for number, page in enumerate(named):
            total, per_s, share = pace(page, folder / f"profile{number}")
            slow += per_s < MIN_PICTURES_PER_S
            print(f"{page.name:24s} {total:10,d} {per_s:10.1f} {share:6.0%}", flush=True)
    return int(slow > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
