# SPDX-License-Identifier: Apache-2.0
"""What a sentence about a command's option, a file of settings or a description advises is done here, and accepted."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from starlette.responses import PlainTextResponse
from studiorecon import __main__ as steps
from studiorecon.board.pattern import read_board
from studiorecon.cli import command
from studiorecon.cli.snakemake_call import preset_file
from studiorecon.cli.takes import open_takes
from studiorecon.configuration import settings as configuration
from studiorecon.configuration.overlays import check_overlay
from studiorecon.placement.camera_placement import lens_from_fov, place_cameras
from studiorecon.placement.place import read_resolution
from studiorecon.placement.place import run as place
from studiorecon.placement.room import read_room
from studiorecon.scene.decisions import Decision, apply_forced
from studiorecon.scene.files import read_table
from studiorecon.scene.numbered_files import pictures_in
from studiorecon.scene.people import read_given_identities
from studiorecon.scene.replacement_photos import photos_of_strangers
from studiorecon.splatting.device import resolve
from studiorecon.studio.capture import _clear
from studiorecon.studio.description import read_description
from studiorecon.sweep.table import Row, read_rows, row_configuration
from studiorecon.window import projects
from studiorecon.window.serving import LocalServer
from studiorecon.window.shots import save_shot

from tests.made.remedies import follow_row
from tests.package.test_settings import GOOD, Outer

Call = Callable[[Path], Any]
BOARD = "{columns: 10, rows: 7, square_m: 0.04}"
COMMAND, STUDIO, SETTINGS = "cli/command.py", "studio/description.py", "configuration/settings.py"
FILES, PROJECTS = "scene/user_files.py", "window/projects.py"


@dataclass(frozen=True)
class Forced:
    """A section with keys of any name."""

    force: dict[str, str]


def written(text: str, name: str, read: Callable[[Path], Any]) -> Call:
    def call(folder: Path) -> Any:
        (folder / name).write_text(text)
        return read(folder / name)

    return call


def studio(text: str) -> Call:
    return written(text, "mine.yaml", read_description)


def overlay(text: str) -> Call:
    return written(text, "mine.yaml", check_overlay)


def section(text: str) -> Call:
    return written(text, "mine.yaml", lambda path: steps._section(str(path), "people.fit"))


def board(text: str) -> Call:
    return written(text, "board.yaml", read_board)


def setting(**changed: Any) -> Call:
    return lambda _: configuration.load(Outer, {**GOOD, **changed}, "depth")


def sweep(*rows: str) -> Call:
    head = "name\tparameter\tpreset\tsettings\n"
    return written(head + "".join("\t".join(row.split("|")) + "\n" for row in rows), "t.tsv", read_rows)


def preset_row(name: str) -> Call:
    def call(folder: Path) -> Any:
        (folder / "p.yaml").write_text("a: 1\n")
        return row_configuration({}, Row("base", "", "", {}), Row("x", "", name, {}), folder)

    return call


def identities(text: str) -> Call:
    return written(text, "identities.tsv", read_given_identities)


def numbered(*names: str) -> Call:
    def call(folder: Path) -> Any:
        for name in names:
            (folder / name).touch()
        return pictures_in(folder)

    return call


def table(text: str) -> Call:
    return written(text, "a.tsv", lambda path: read_table(path, ("camera", "track")))


def rig(**changed: Any) -> Call:
    given = {"room": "2x2x2", "cameras": 2, "hfov_deg": [65.0], "resolution": "1280x720", **changed}
    return lambda f: place(**given, picture=f / "a.svg", plan=f / "a.json")


def scene(name: str) -> Call:
    def call(folder: Path) -> Any:
        page = folder / "results/take/report/index.html"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.touch()
        return command.finished_scene(name if name == "gone" else str(folder / "results/take"))

    return call


def takes(*names: str) -> Call:
    def call(folder: Path) -> Any:
        for name in names:
            (folder / name).mkdir(parents=True)
        return open_takes([folder / name for name in names])

    return call


def plan_words(**given: Any) -> Call:
    usual = {"folder": None, "room": None, "cameras": "2", "hfov": ["65"], "resolution": "640x360"}
    return lambda f: command._plan(argparse.Namespace(**usual, **given, picture=str(f / "plan.svg")))


def taken(free: bool) -> Call:
    def call(_: Path) -> None:
        first = LocalServer(PlainTextResponse("x"), 0)
        second = None
        try:
            first._socket.listen()
            second = LocalServer(PlainTextResponse("x"), 0 if free else first.port)
        finally:
            for server in filter(None, (first, second)):
                server._socket.close()

    return call


def within(call: Call) -> Call:
    """The call with its folder as the current one."""

    def there(folder: Path) -> Any:
        with contextlib.chdir(folder):
            return call(folder)

    return there


def linked(*folders: str) -> Call:
    def call(here: Path) -> None:
        for name in folders:
            film = here / name / "videos/a.mp4"
            film.parent.mkdir(parents=True)
            film.write_bytes(b"x")
            projects.link_folder(str(here / name))

    return call


def uploaded(name: str) -> Call:
    def call(folder: Path) -> None:
        (folder / "take/videos").mkdir(parents=True)
        projects.upload_path("take", name)

    return call


def shot_saved(name: str) -> Call:
    def call(folder: Path) -> None:
        (folder / "take/videos").mkdir(parents=True)
        save_shot("take", name, f"render:\n  shots:\n    {name}:\n      kind: orbit\n")

    return call


def cleared(own: bool) -> Call:
    def call(folder: Path) -> None:
        (folder / "data").mkdir(exist_ok=True)
        (folder / "data/mine.txt").touch()
        _clear(folder / ("own" if own else "data"), folder / "truth")

    return call


def forced(effect: str, verdict: str) -> Call:
    known = [Decision("shadows", "s", 1.0, None, 0.5, "on", "because"), Decision("people", "s", 1, None, 0, "on", "x")]
    return lambda _: apply_forced(known, {effect: verdict})


# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
ROWS: list[tuple[Any, ...]] = [
    (f"{COMMAND} _plan", plan_words(), lambda f: command._plan(argparse.Namespace(
        folder=None, room="2x2x2", cameras="2", hfov=["65"], resolution="640x360", picture=str(f / "plan.svg")))),
    (f"{COMMAND} _capture 1", lambda f: command._capture(f / "gone"), command._capture),
    (f"{COMMAND} _capture 2", written("", "a.mp4", command._capture), command._capture),
    ("cli/takes.py open_takes 1", lambda f: open_takes([f / "gone"]), lambda f: open_takes([f])),
    ("cli/takes.py open_takes 2", takes("one/a", "two/a"), takes("one/a", "two/b"), takes("one/a")),
    ("cli/snakemake_call.py preset_file", lambda _: preset_file("loook"), lambda _: preset_file("look")),
    ("cli/snakemake_call.py preset_file", lambda _: preset_file("xyz"),
     written("", "a.yaml", lambda p: preset_file(str(p)))),
    (f"{COMMAND} finished_scene", scene("gone"), scene("take")),
    (f"{COMMAND} _settings", lambda _: command._settings(argparse.Namespace(name="people.fits")),
     lambda _: command._settings(argparse.Namespace(name="people.fit"))),
    (f"{PROJECTS} enter 1", within(lambda f: projects.enter(f / "gone")), within(projects.enter)),
    (f"{PROJECTS} new_project 1", within(lambda _: projects.new_project("studio")),
     within(lambda _: projects.new_project("a"))),
    (f"{PROJECTS} new_project 2", within(lambda f: ((f / "a/videos").mkdir(parents=True), projects.new_project("a"))),
     within(lambda f: ((f / "a/videos").mkdir(parents=True), projects.new_project("b"))),
     within(lambda f: ((f / "a/videos").mkdir(parents=True), projects.find_project("a")))),
    (f"{PROJECTS} link_folder 1", within(lambda _: projects.link_folder("take")), within(linked("other/take"))),
    (f"{PROJECTS} link_folder 2", within(linked("other/take", "third/take")),
     within(linked("other/take", "third/take2"))),
    (f"{PROJECTS} upload_path 1", within(uploaded("../a.mp4")), within(uploaded("a.mp4"))),
    ("window/shots.py save_shot 1", within(shot_saved("a/b")), within(shot_saved("a-b_1"))),
    ("window/shots.py save_shot 2", within(shot_saved("orbit")), within(shot_saved("mine"))),
    ("window/serving.py LocalServer.__init__", taken(free=False), taken(free=True)),
    ("configuration/overlays.py check_overlay", overlay("- capture"), overlay("capture: {width: 960}")),
    ("__main__.py _section 1", lambda f: steps._section(str(f / "gone.yaml"), "people.fit"),
     section("people: {fit: {a: 1}}")),
    ("__main__.py _section 2", section("depth: {}"), section("people: {fit: {a: 1}}")),
    (f"{SETTINGS} load", lambda _: configuration.load(Outer, {k: v for k, v in GOOD.items() if k != "count"}, "depth"),
     setting()),
    (f"{SETTINGS} _convert 1", setting(limit="high"), setting(limit=2.5), setting(limit=None)),
    (f"{SETTINGS} _convert 2", setting(mode="c"), setting(mode="a"), setting(mode="b")),
    (f"{SETTINGS} _convert 3", setting(inner=3), setting()),
    (f"{SETTINGS} _convert 4", setting(several=3), setting()),
    (f"{SETTINGS} _convert 5", setting(pair=[1]), setting()),
    (f"{SETTINGS} _convert 6", lambda _: configuration.load(Forced, {"force": 3}, "survey"),
     lambda _: configuration.load(Forced, {"force": {"people": "on"}}, "survey")),
    (f"{SETTINGS} _scalar", setting(rate="1e-4"), setting(rate=1.0e-4)),
    (f"{SETTINGS} _scalar", setting(on="yes"), setting(on=True), setting(on=False)),
    ("scene/decisions.py apply_forced", forced("shadow", "on"), forced("shadows", "on")),
    ("scene/decisions.py apply_forced", forced("shadows", "maybe"), forced("shadows", "off")),
    ("scene/replacement_photos.py stranger_name", lambda _: photos_of_strangers(["a b.png"]),
     lambda _: photos_of_strangers(["a_b.png"])),
    ("scene/replacement_photos.py photos_of_strangers", lambda _: photos_of_strangers(["x/a.png", "y/a.png"]),
     lambda _: photos_of_strangers(["x/a.png", "y/b.png"])),
    ("splatting/device.py resolve 1", lambda _: resolve("gpu"), lambda _: resolve("cpu"), lambda _: resolve("auto")),
    ("splatting/device.py resolve 2", lambda _: resolve("cuda"), lambda _: resolve("auto")),
    ("placement/place.py read_resolution", lambda _: read_resolution("1920"), lambda _: read_resolution("1920x1080")),
    ("placement/room.py read_room", lambda _: read_room("6x5"), lambda _: read_room("6x5x2.8")),
    ("placement/room.py read_room", lambda _: read_room("0.5x5x3"), lambda _: read_room("1x1x1.9"),
     lambda _: read_room("100x100x100")),
    ("placement/place.py run 1", rig(cameras=1), rig(cameras=2)),
    ("placement/place.py run 2", rig(hfov_deg=[170.0, 60.0, 50.0]), rig(hfov_deg=[150.0, 60.0])),
    ("placement/camera_placement.py place_cameras",
     lambda _: place_cameras(read_room("4x4x3"), [lens_from_fov("a", 65.0, (64, 36))]),
     lambda _: place_cameras(read_room("2x2x2"), [lens_from_fov(n, 65.0, (64, 36)) for n in "ab"])),
    ("studio/capture.py _clear", cleared(own=False), cleared(own=True)),
    (f"{STUDIO} _mapping 1", lambda f: read_description(f / "gone.yaml"),
     lambda _: read_description(Path("resources/studio/demo.yaml"))),
    (f"{STUDIO} _mapping 2", studio("- people"), studio("people: 2")),
    (f"{STUDIO} _merge 1", studio("persons: 2"), studio("people: 2")),
    (f"{STUDIO} _merge 2", studio("cameras: 3"), studio("cameras: {training: 6}")),
    (f"{STUDIO} read_description", studio("people: many"), studio("people: 2")),
    (f"{STUDIO} _check_ranges 1", studio("people: 7"), studio("people: 4"), studio("people: 0")),
    (f"{STUDIO} _check_ranges 2", studio("size: [33, 64]"), studio("size: [32, 64]")),
    (f"{STUDIO} _check_ranges 3", studio("size: [16000, 16000]"), studio("size: [1920, 1080]")),
    (f"{STUDIO} _check_ranges 4", studio("cameras: {layout: arc, training: 3, held_out: 3}"),
     studio("cameras: {layout: arc, training: 3, held_out: 2}")),
    (f"{STUDIO} _check_ranges 4", studio("cameras: {layout: ring, training: 3, held_out: 4}"),
     studio("cameras: {layout: ring, training: 3, held_out: 3}")),
    *[("board/pattern.py " + place, board(wrong), *map(board, right)) for place, wrong, *right in (
        ("read_board 1", "{cols: 10, rows: 7, square_m: 0.04}", BOARD),
        ("read_board 2", "{columns: 10, rows: 7}", BOARD),
        ("read_board 3", BOARD.replace("}", ", dictionary: 4X4}"), BOARD.replace("}", ", dictionary: DICT_4X4_50}")),
        ("read_board 4", BOARD.replace("7", "8"), BOARD, BOARD.replace("}", ", dictionary: DICT_4X4_50}")),
    )],
    ("board/pattern.py _from_caliscope", written("[a]\n", "charuco.toml", read_board), board(BOARD)),
    ("sweep/table.py read_rows 1", sweep("base|||", "a b|||"), sweep("base|||", "a-b|||")),
    ("sweep/table.py read_rows 2", sweep("base|||", "a|||", "a|||"), sweep("base|||", "a|||", "b|||")),
    ("sweep/table.py read_rows 3", sweep("a|||"), sweep("base|||", "a|||")),
    ("sweep/table.py parse_settings 1", sweep("base|||depth"), sweep("base|||depth.source=onnx ; capture.width=960")),
    ("sweep/table.py parse_settings 2", sweep("base|||a.b=["), sweep("base|||a.b=[1]")),
    ("sweep/table.py row_configuration", preset_row("q"), preset_row("p")),
    ("scene/people.py read_given_identities 1", identities("camera\ttrack\tperson\na\tx\tp0\n"),
     identities("camera\ttrack\tperson\na\t3\tp0\n")),
    ("scene/people.py read_given_identities 2", identities("camera\ttrack\tperson\na\t3\tp0\na\t3\tp1\n"),
     identities("camera\ttrack\tperson\na\t3\tp0\n")),
    ("scene/numbered_files.py pictures_in", numbered("1.png", "01.png"), numbered("1.png", "2.png")),
    ("scene/people.py read_given_identities 3", identities("camera\ttrack\tperson\n"),
     identities("camera\ttrack\tperson\na\t3\tp0\n")),
    (f"{FILES} read_rows 1", table("camera\n"), table("camera\ttrack\n")),
    (f"{FILES} read_rows 2", table("camera\tcamera\ttrack\n"), table("camera\ttrack\n")),
    (f"{FILES} read_rows 3", table("camera\ttrack\na\n"), table("camera\ttrack\na\t1\n")),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {row[0]}" for n, row in enumerate(ROWS)])
def test_what_a_command_advises_is_accepted(row: int, tmp_path: Path) -> None:
    follow_row(ROWS[row], tmp_path)
