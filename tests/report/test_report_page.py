# SPDX-License-Identifier: Apache-2.0
"""The page: complete without a network, with the numbers of the JSON, and working in a headless browser if there is
one.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.pages.run_summary import read_warnings
from studiorecon.report import strict
from studiorecon.report.sections import appendix, comparison_slider, tables, timeline
from studiorecon.report.sections import tables as sections
from studiorecon.report.sections.quality_summary import quality_summary
from studiorecon.scene.decisions import Decision
from studiorecon.scene.files import read_json, write_json, write_table, write_text
from studiorecon.scene.people import Detections, Person

from tests.made.browser import BROWSER
from tests.made.fitted import fitted_person
from tests.made.report import report_scene

# One pixel each: a picture need not be large to be swapped.
PIXELS = {
    name: f"data:image/gif;base64,R0lGODlhAQABAIAAA{code}AAP///yH5BAAAAAAALAAAAAABAAEAAAICRAEAOw=="
    for name, code in (("photo", "P8A"), ("enhanced", "AD/"), ("render", "AAA"))
}


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory, root: Path, default_settings: Callable) -> Path:
    return report_scene(tmp_path_factory.mktemp("scene"), root, default_settings)


class Addresses(HTMLParser):
    """Every address that a page's elements name."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.found += [
            (tag, value or "") for name, value in attributes if name in ("src", "href", "data", "action", "poster")
        ]


def opened(page: Path, *arguments: str, script: str = "") -> tuple[str, str]:
    """The document after its scripts ran in a browser without access to any host, and the browser's log.

    ``script`` runs at the end.
    """
    if script:
        page = page.with_name("scripted.html")
        source = (page.with_name("index.html")).read_text(encoding="utf-8")
        write_text(page, source.replace("</body>", f"<script>{script}</script></body>"))
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"]
    command += [
        "--host-resolver-rules=MAP * ~NOTFOUND",
        "--virtual-time-budget=4000",
        *arguments,
        "--dump-dom",
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout, done.stderr


def test_whom_association_left_out_stands_on_the_page_with_what_takes_them_in(reported: Path) -> None:
    text = (reported / "report/index.html").read_text(encoding="utf-8")
    part = text.split("<h2>People left out</h2>")[1].split("<h2>")[0]
    for output in ("r0", "2.5 s", "left, right", "it has no &lt;depth&gt;", "left\t3\tp0\nright\t1\tp0"):
        assert output in part
    assert sections.rejected_people_table([]) == ""


def test_the_page_needs_no_network_and_shows_the_numbers(reported: Path) -> None:
    text = (reported / "report/index.html").read_text(encoding="utf-8")
    metrics = read_json(reported / "report/metrics.json")
    parser = Addresses()
    parser.feed(text)
    shown = [(tag, address) for tag, address in parser.found if not address.startswith("data:")]
    assert {tag for tag, _ in shown} <= {"a"}, "everything that is shown is inside the page"
    for _, address in shown:
        there = f'<a id="{address[1:]}"></a>' in text if address.startswith("#") else None
        assert there or (reported / "report" / address).is_file(), "links lead to headings, and to files beside it"
    assert ("a", "metrics.json") in shown
    assert ("a", "../deliver/player.html") in shown
    assert not re.search(r"@import|url\(", text)
    assert f"{metrics['pictures']['raw']['psnr']['value']:.2f} dB" in text
    assert "not measured" in text
    assert "data:video/mp4;base64," in text
    assert "an &lt;empty&gt; room" in text
    assert "it flickers" in text
    assert "too early" not in text, "what a later survey decided counts"
    assert "100 % inferred" in text
    assert "passes through &lt;p0&gt;" in text, "warnings of the logs"
    assert "shows less than 50 % measured surfaces in 1 of 2 pictures" in text, "and of the films' ledgers"
    assert "shot heldout passes through &lt;p1&gt;" in text
    assert "drawn" not in text.split("<h2>Warnings")[1].split("<h2>Versions")[0]
    for library, version in metrics["provenance"]["libraries"].items():
        assert f"<td>{library}</td><td>{version}</td>" in text


@pytest.mark.browser
def test_a_browser_opens_the_page_without_errors_and_shows_the_numbers_of_the_json(reported: Path) -> None:
    document, log = opened(reported / "report/index.html")
    assert "CONSOLE" not in log, log[-2000:]
    words = re.sub(
        r"\s+", " ", re.sub(r"<script.*?</script>|<style.*?</style>|<[^>]+>", " ", document, flags=re.DOTALL)
    )
    pictures = read_json(reported / "report/metrics.json")["pictures"]
    for version in ("raw", "enhanced"):
        assert f"{pictures[version]['psnr']['value']:.2f} dB" in words
        assert f"{pictures[version]['ssim']['value']:.4f}" in words
        for camera, entry in pictures[version]["psnr"]["cameras"].items():
            assert camera in words
            assert f"{entry['value']:.2f}" in words


def test_the_first_screen_is_the_judgement_the_player_and_the_contents(reported: Path) -> None:
    text = (reported / "report/index.html").read_text(encoding="utf-8")
    first, _, rest = text.partition('<a id="films"></a>')
    psnr = read_json(reported / "report/metrics.json")["pictures"]["enhanced"]["psnr"]["value"]
    assert f"{psnr:.1f} dB PSNR" in first.partition('class="lead">')[2].partition("</p>")[0]
    assert '<a class="open" href="../deliver/player.html">' in first
    listed = re.findall(r'<a href="#([^"]+)">', first)
    assert listed[0] == "films"
    assert all(f'<a id="{anchor}"></a>' in text for anchor in listed)
    assert rest.index("<video") < rest.index('class="tile"') < rest.index("<table"), "numbers come after pictures"


def values(**found: float | None) -> dict:
    return {name: {"value": value, "reason": "r", "cameras": {}} for name, value in found.items()}


def scored(raw: dict, enhanced: dict) -> dict:
    bodies = {"mpjpe_world_mm": 21.4, "people": {}}
    return {"pictures": {"raw": raw, "enhanced": enhanced}, "bodies": bodies, "coverage": {"orbit": {"measured": 0.61}}}


UNSEEN = values(psnr=20.0, ssim=0.7, psnr_seen=26.0, psnr_unseen=12.0, share_seen=0.9)


@pytest.mark.parametrize(
    ("pictures", "limits", "helps"),
    [
        (UNSEEN, "10% of the room", "studiorecon plan"),
        (
            values(psnr=20.0, ssim=0.7, psnr_people=18.0, psnr_background=24.0),
            "People limit the quality (18.0 dB",
            "standard",
        ),
        (
            values(psnr=20.0, psnr_seen=20.0, psnr_unseen=19.0, share_seen=0.9),
            "cameras do see limit the quality (90%",
            "standard",
        ),
        (values(psnr=None), "no camera is held out", "held_out in capture.yaml"),
    ],
)
def test_the_judgement_names_what_limits_and_what_would_help(pictures: dict, limits: str, helps: str) -> None:
    messages = quality_summary(scored(pictures, pictures))
    assert limits in messages
    assert helps in messages
    assert "21 mm" in messages
    assert ("61%" in messages) == (pictures["psnr"]["value"] is None)


@pytest.mark.parametrize("gained", [0.0, 0.3])
def test_what_is_enhanced_has_a_column_only_where_something_was(gained: float) -> None:
    metrics = scored(values(psnr=20.0, ssim=0.7), values(psnr=20.0 + gained, ssim=0.7))
    shown = sections.measures_table(metrics) + sections.main_numbers(metrics, {"total": {"seconds": 9.0}})
    assert ("enhanced" in shown) == (">change<" in shown) == bool(gained)
    assert f"{20 + gained:.2f} dB" in shown


def test_settings_are_lines_and_not_json() -> None:
    shown = sections.settings_table(json.dumps({"people": {"fit": {"iterations": 20}}, "rgb": [0, 1]}))
    assert "people.fit.iterations = 20" in shown
    assert "rgb = 0, 1" in shown
    assert "{" not in shown


def test_what_was_delivered_is_linked_by_folder(tmp_path: Path) -> None:
    files = ["README.txt", "bodies/p0.bvh", "bodies/p0.glb", "keypoints/a.json", "keypoints/b.json", "gone.ply"]
    for name in files[:-1]:
        write_text(tmp_path / "deliver" / name, "x")
    write_json(tmp_path / "deliver/manifest.json", {"files": {name: {} for name in files}})
    shown = appendix.delivery_links(tmp_path / "deliver", tmp_path / "report/index.html")
    linked = re.findall(r'href="([^"]+)"', shown)
    assert linked == ["../deliver/README.txt", "../deliver/bodies/p0.bvh", "../deliver/bodies/p0.glb"]
    assert "2 more files" in shown
    assert appendix.delivery_links(tmp_path / "none", tmp_path / "report/index.html") == ""


@pytest.mark.browser
def test_nothing_is_cut_on_a_phone(reported: Path) -> None:
    """In a frame as wide as a phone, because browsers' own windows are wider."""
    frame = reported / "report/frame.html"
    write_text(
        frame,
        '<body><iframe id="f" src="index.html" style="width:390px;height:800px;border:0"></iframe><script>'
        "f.onload = () => { const d = f.contentDocument; for (const x of d.querySelectorAll('details')) x.open = true;"
        "document.title = [d.documentElement, ...d.querySelectorAll('.scroll')]"
        ".filter(t => t.scrollWidth > t.clientWidth).length + ' of ' + d.querySelectorAll('.scroll').length; }"
        "</script></body>",
    )
    document, _ = opened(frame, "--allow-file-access-from-files")
    cut, tables = map(int, re.search(r"<title>(\d+) of (\d+)</title>", document).groups())
    assert tables > 5
    assert cut == 0


@pytest.mark.browser
@pytest.mark.parametrize("width", [360, 1280])
def test_nothing_is_wider_than_the_window(reported: Path, width: int) -> None:
    output = "document.title = document.documentElement.scrollWidth + ' of ' + window.innerWidth;"
    document, _ = opened(reported / "report/index.html", f"--window-size={width},800", script=output)
    inner, outer = map(int, re.search(r"<title>(\d+) of (\d+)</title>", document).groups())
    assert inner <= outer, "a phone must not scroll sideways"


@pytest.mark.browser
def test_the_slider_moves_the_line_and_swaps_versions_and_moments(reported: Path) -> None:
    script = """
    const figure = document.querySelector('figure.comparison'), at = q => figure.querySelector(q);
    const made = JSON.parse(at('script').textContent), images = figure.querySelectorAll('.wipe img');
    const started = images[0].src === made[0].pictures.photo && images[1].src === made[0].pictures.enhanced;
    const line = at('input'); line.value = 20; line.dispatchEvent(new Event('input'));
    const moment = at('.moment'); moment.value = 1; moment.dispatchEvent(new Event('change'));
    const right = figure.querySelectorAll('.version')[1]; right.value = 'render';
    right.dispatchEvent(new Event('change'));
    const ended = images[0].src === made[1].pictures.photo && images[1].src === made[1].pictures.render;
    const told = images[1].alt === 'render, ' + made[1].caption;
    document.title = [started, at('.wipe').style.getPropertyValue('--cut'), ended, told].join(' ');
    """
    document, log = opened(reported / "report/index.html", script=script)
    assert "CONSOLE" not in log, log[-2000:]
    assert "<title>true 20% true true</title>" in document


def test_the_slider_keeps_a_caption_from_ending_its_script() -> None:
    made = comparison_slider.slider([("a</script><b>", PIXELS)], "photo", "enhanced")
    held = re.search(r'<script type="application/json">(.*?)</script>', made, re.DOTALL).group(1)
    assert json.loads(held)[0]["caption"] == "a</script><b>"
    assert comparison_slider.slider([], "photo", "enhanced") == ""
    with pytest.raises(ValueError, match="same versions"):
        comparison_slider.slider([("a", PIXELS), ("b", {"photo": ""})], "photo", "enhanced")


def test_the_strip_shows_who_is_seen_when() -> None:
    frame, track = np.array([0, 1, 2, 4, 4]), np.array([7, 7, 7, 7, 9])
    found = Detections("cam1", "coco", frame, track, np.zeros((5, 17, 3)))
    seen = timeline.frames_with_detections([found], {("cam1", 7): "p1"}, ["p0", "p1"], 5)
    assert seen["cam1"].tolist() == [[False] * 5, [True, True, True, False, True], [False] * 4 + [True]]
    assert timeline.true_runs(seen["cam1"][1]) == [(0, 3), (4, 5)]
    drawn = timeline.timeline_strip(seen, ["p0", "p1"])
    assert "<title>p1, frames 0 to 2</title>" in drawn
    assert "<title>no person, frames 4 to 4</title>" in drawn
    assert "p0, frames" not in drawn
    assert timeline.timeline_strip({}, []) == ""


def test_joint_deviations_are_those_of_measured_frames() -> None:
    valid, sigma = np.array([True, True, False]), np.full((3, 24), 0.004)
    sigma[2] = np.inf
    person = fitted_person("p0", "body", 30.0, 3, valid=valid, sigma=sigma)
    shown = timeline.certainty_table([person], {"p0": {"joints_mm_f2": 1.25, "pose_deg_f2": None}})
    assert "2 of 3" in shown
    assert shown.count("4.0 mm") == 2
    assert "1.25 mm/frame²" in shown
    assert "not known" in shown


def test_coverage_is_what_the_survey_measured() -> None:
    decision = Decision("view_synthesis", "s", 0.5, (0.4, 0.6), 0.2, "on", "r", detail={"seen_by": [0.91, 0.52]})
    shown = sections.coverage_table([{"view_synthesis": decision}])
    assert "91%" in shown
    assert "52%" in shown
    assert sections.coverage_table([{}]) == ""


def test_a_budget_is_reported_beside_what_its_jobs_took() -> None:
    total = {"count": 3.0, "seconds": 400.0, "cpu_seconds": 361.0, "peak_memory_mb": 900.0}
    spent = {"reason": None, "total": total, "stages": {"render": total}}
    budget = {"minutes": 5.0, "preset": "look", "predicted_s": 120, "low_s": 96, "high_s": 150, "work_s": 200}
    budget["more"] = "the defaults would take 5 min for 0.9 dB more"
    output = sections.cost_and_quality({"pictures": {}}, spent, budget)
    assert "A budget of 5 min chose look: predicted 2 min 00 s from nothing (1 min 36 s to 2 min 30 s)." in output
    assert "predicted to take 3 min 20 s of processor time and took 6 min 01 s." in output
    assert "The defaults would take 5 min for 0.9 dB more." in output
    assert "budget" not in sections.cost_and_quality({"pictures": {}}, spent, {})


def test_warnings_appear_once_with_their_step(tmp_path: Path) -> None:
    write_text(tmp_path / "people/fit/p0.log", "fine\nwarning: one\nwarning: one\n")
    write_text(tmp_path / "plates/clean/cam1.log", "warning: two\na warning: is no warning\n")
    write_text(tmp_path / "people/first/associate.log", "warning: three for 1.7 s\n")
    write_text(tmp_path / "people/associate.log", "warning: three for 1.6 s\n")
    assert read_warnings(tmp_path) == [
        ("people.associate", "three for 1.6 s"),
        ("people.fit.p0", "one"),
        ("plates.clean.cam1", "two"),
    ]
    assert "No warnings" in appendix.warnings_section([])


def test_warnings_name_the_pictures_of_a_film(tmp_path: Path) -> None:
    columns = ("picture", "measured", "angle_deg", "near")
    rows = [(i, 0.9 if i < 5 else 0.3, 70.0 if i in (1, 3) else 10.0, "p0" if i == 7 else "") for i in range(8)]
    write_table(tmp_path / "fly.tsv", columns, rows)
    assert [sentence for _, sentence in appendix.film_warnings([tmp_path / "fly.tsv"], 0.5, 60.0)] == [
        "shot fly shows less than 50 % measured surfaces in 3 of 8 pictures (5-7)",
        "shot fly is more than 60 degrees from every training camera in 2 of 8 pictures (1, 3)",
        "shot fly passes through p0 in 1 of 8 pictures (7)",
    ]
    assert appendix.film_warnings([tmp_path / "fly.tsv"], 0.2, 90.0) == [
        ("render.shot.fly", "shot fly passes through p0 in 1 of 8 pictures (7)")
    ]


def test_in_how_many_frames_somebody_is_there_stands_beside_how_many_were_measured() -> None:
    about = 30.0, np.zeros((9, 72)), np.zeros((9, 3)), np.zeros(10), np.zeros((9, 24, 3)), np.arange(9) < 3
    always, left = (
        Person(name, "body", *about, np.full((9, 24), 0.004), True, present)
        for name, present in (("p0", np.ones(9, bool)), ("p1", np.arange(9) < 5))
    )
    shown = timeline.certainty_table([always, left], {})
    assert "frames present" in shown
    cells = [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in shown.split("<tr>")[2:]]
    assert [row[:3] for row in cells] == [["p0", "3 of 9", "all"], ["p1", "3 of 9", "5"]]


# ---- The section on cameras of the report's page ----

CONTRADICTED = {"cameras": ["cam1", "<b>"], "off_deg": 2.37, "off_sigmas": 4.8, "believed": False}


def messages(edges: dict[str, Any] | None) -> str:
    return tables.cameras_table({} if edges is None else {"edges": edges}, "sheet.png").split("<img")[0]


def test_what_the_room_s_edges_say_stands_before_and_after() -> None:
    moved = messages({**CONTRADICTED, "believed": True, "off_after_deg": 0.19, "between_deg": 2.56})
    assert "contradicted the rotation between cam1 and &lt;b&gt; by 2.4°; after refinement by 0.2°" in moved
    assert "±2.6° (95 %)" in moved
    stayed = messages(CONTRADICTED)
    assert "2.4°, 4.8 of their" in stayed
    assert "no camera was refined" in stayed
    assert "straight edges" not in messages(None)


# ---- With strict, a run in which any step warned ends with all the warnings as one error ----


def test_warnings_of_all_steps_are_one_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_text(tmp_path / "logs/detect/people/cam2.log", "looked\nwarning: camera cam2: nobody was found\n")
    write_text(
        tmp_path / "logs/people/associate.log", "warning: somebody was left out\nwarning: somebody was left out\n"
    )
    with pytest.raises(UserError) as refused:
        strict.run(tmp_path / "index.html", tmp_path / "logs", tmp_path / "strict.txt")
    assert str(refused.value).startswith("2 warnings, treated as errors (strict)")
    shown = capsys.readouterr().out
    for line in ("detect.people.cam2: camera cam2: nobody was found", "people.associate: somebody was left out"):
        assert shown.count(line) == 1
    assert not (tmp_path / "strict.txt").exists()


def test_without_warnings_it_passes(tmp_path: Path) -> None:
    write_text(tmp_path / "logs/plates/clean/cam1.log", "a plate of which 99 % were seen; no warning: none\n")
    strict.run(tmp_path / "index.html", tmp_path / "logs", tmp_path / "strict.txt")
    assert (tmp_path / "strict.txt").is_file()
