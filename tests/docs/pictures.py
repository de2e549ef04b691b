# SPDX-License-Identifier: Apache-2.0
"""The tutorial's pictures: what its commands leave of the demo, in a browser without a window.

``python -m tests.docs.pictures results/demo docs/tutorial``, after the demo and its doctor.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from tests.made.browser import Browser, software_gl

SIZE = (1120, 700)
# Page and what it is scrolled to; the player's address says where one stands.
PAGES = {
    "doctor": ("calibration/doctor.html", "document.querySelector('img').scrollIntoView()"),
    "people": ("people/review.html", "scrollTo(0, 250)"),
    "report": ("report/index.html", ""),
}
# Software draws the player's picture in two seconds.
_STANDS_S = 6.0
PLAYER = {"player": "film=orbit&picture=20&frame=20", "truth": "film=orbit&picture=20&frame=20&tinted=1&skeletons=1"}


def keep(browser: Browser, path: Path) -> None:
    """The page as it stands as a JPEG."""
    picture = cv2.imdecode(np.frombuffer(browser.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 78])
    print(f"{path}: {picture.shape[1]}×{picture.shape[0]}, {path.stat().st_size / 1000:.0f} kB")


def main(scene: Path, target: Path) -> None:
    """Write every picture of a finished ``scene`` into ``target``."""
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as profile, software_gl(Path(profile), size=SIZE) as browser:
        browser.call(
            "Emulation.setDeviceMetricsOverride", width=SIZE[0], height=SIZE[1], deviceScaleFactor=1, mobile=False
        )
        for name, (page, script) in PAGES.items():
            browser.open((scene / page).resolve().as_uri())
            if script:
                browser.run(script)
            keep(browser, target / f"{name}.jpg")
        for name, state in PLAYER.items():
            browser.open("about:blank")
            browser.open(f"{(scene / 'deliver/player.html').resolve().as_uri()}#{state}")
            browser.wait("!!window.player && player.drawn() > 0")
            time.sleep(_STANDS_S)
            keep(browser, target / f"{name}.jpg")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
