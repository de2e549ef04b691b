# SPDX-License-Identifier: Apache-2.0
"""Pages: what they are told is text, on every one of them; a run's page says how far it is; a browser shows them."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from jinja2 import UndefinedError
from studiorecon.calibration.checks import doctor_page as doctor
from studiorecon.pages import html, run_page, skeleton
from studiorecon.people import review

from tests.made.browser import BROWSER

EVIL = "<script>alert(1)</script>"


def doctors_page(name: str) -> str:
    camera = {"wh": (64, 48), "fps": 25.0, "video_frames": 9, "rotation_deg": 0, "brightness": 0.4, "burnt": 0.0}
    report = {
        "verdict": "good",
        "notes": [f"{name} was not used"],
        "sync": {
            "sentences": [f"{name} was started first"],
            "lags_frames": {name: {"frames": 3.0, "low": 2.0, "high": 4.0}},
        },
        "advice": [f"look at {name}"],
        "shown_frame": None,
        "people": 1,
        "footage": {name: camera},
        "facts": {name: {"field_deg": 60.0, "height_m": 2.0}},
        "without_keypoints": [],
        "px_per_camera": {name: 1.0},
        "outlier_camera": None,
        "lengths": None,
        "edges": None,
        "hypotheses": [{"hypothesis": name, "score": 0.5, "remedy": f"turn {name}"}],
        "median_px": 1.0,
        "reach_m": 3.0,
        "coverage": {2: 0.5},
        "blind_sectors_deg": [(10, 120)],
    }
    return doctor.page(name, report, b"png")


def identity_page(name: str) -> str:
    track = {"camera": name, "track": 1, "first": 0, "last": 9, "detections": 10, "reason": f"beside {name}"}
    shown = {
        f"{name}/1": skeleton.Markup("seen"),
        f"p0 {name}": skeleton.Markup("x"),
        f"h0 {name}": skeleton.Markup("y"),
    }
    reported = {
        "tracks": [track],
        "corrected": False,
        "left_out": [{"name": "h0", "reason": f"near {name}", "lines": [f"{name}\t1\tp1"]}],
    }
    row = {"person": "p0", "frames": "10", "confidence": "1", "source": "keypoints", "cameras": name}
    doubtful, rejected = [{**track, "person": "p0"}], [{**track, "person": ""}]
    return review._page(reported, [row], doubtful, rejected, [name], shown, {(name, 1): "p0"})


def runs_page(name: str, folder: Path, on: bool = True) -> str:
    stages = [run_page.Stage("capture", 2, 4), run_page.Stage(name, 0, 1)]
    return run_page.write_page(folder, name, f"2 of 5 jobs of {name}", name, stages, [name], [], on)


def blocks(name: str) -> str:
    body = [html.heading(name, name), html.tiles([(name, name)]), html.figure("data:,", name), html.film(b"", name)]
    body += [html.table([name], [[name]]), html.details(name, name)]
    return html.page(name, body)


@pytest.mark.parametrize("made", ["blocks", "doctor", "identities", "running"])
def test_what_is_named_like_code_is_shown_as_text(made: str, tmp_path: Path) -> None:
    page = {
        "blocks": lambda: blocks(EVIL),
        "doctor": lambda: doctors_page(EVIL),
        "identities": lambda: identity_page(EVIL),
        "running": lambda: runs_page(EVIL, tmp_path),
    }[made]()
    assert EVIL not in page
    assert page.count("&lt;script&gt;") >= 3
    assert page.startswith("<!doctype html>")
    assert page.count("<h1>") <= 1
    assert page.rstrip().endswith("</html>")


def test_a_template_that_lacks_a_value_is_no_page() -> None:
    with pytest.raises(UndefinedError, match="name"):
        skeleton.fill_template("{{ name }}")


def test_a_page_reloads_while_the_run_is_on_and_leads_to_the_report_after_it(tmp_path: Path) -> None:
    assert f'http-equiv="refresh" content="{run_page.RELOAD_S}"' in runs_page("demo", tmp_path)
    assert 'http-equiv="refresh"' not in runs_page("demo", tmp_path, on=False), "a run that was stopped stays as it was"
    for name in ("report/index.html", "plates/cam0.png", "people/review.html"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    over = runs_page("demo", tmp_path, on=False)
    assert 'content="0;url=report/index.html"' in over
    assert 'src="plates/cam0.png"' in over
    assert 'href="people/review.html"' in over


@pytest.mark.browser
@pytest.mark.parametrize("made", ["doctor", "identities"])
def test_a_browser_finds_no_script_of_ours_in_what_pages_contain(made: str, tmp_path: Path) -> None:
    page = doctors_page(EVIL) if made == "doctor" else identity_page(EVIL)
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    done = subprocess.run(
        [
            *(str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/profile"),
            *("--dump-dom", (tmp_path / "page.html").as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr[-500:]
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in done.stdout
    assert not re.search(r"<script", done.stdout)
