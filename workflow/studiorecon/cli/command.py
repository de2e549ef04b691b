# SPDX-License-Identifier: Apache-2.0
"""``studiorecon``: the workflow as a command for people, each subcommand a thin call of the packaged Snakefile.

Results, logs and Snakemake's own files go to the current folder, wherever the package is installed.
"""

from __future__ import annotations

import argparse
import difflib
import os
import subprocess
import sys
import webbrowser
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from studiorecon.__main__ import main as step_main
from studiorecon.cli.real_demo import TAKE, fetch_take
from studiorecon.cli.snakemake_call import environment, preset_names, snakemake_command
from studiorecon.configuration.overlays import split_option
from studiorecon.errors import UserError
from studiorecon.home import CONFIGURATION, HOME, SCHEMA
from studiorecon.machine.crash_report import fault_sentence, keep_trace
from studiorecon.machine.output import unbroken_output
from studiorecon.machine.resource_errors import describe_resource_error
from studiorecon.scene.names import as_paths

if TYPE_CHECKING:
    from studiorecon.window.serving import LocalServer

_DEMO = "resources/studio/demo.yaml"
_PORT = 8642


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; the exit status is Snakemake's, or 1 with a sentence when there is nothing to run."""
    given = list(sys.argv[1:] if argv is None else argv)
    cut = given.index("--") if "--" in given else len(given)
    parser = _parser()
    options = parser.parse_args(as_paths(given[:cut]))
    if options.word is None:
        parser.print_help()
        return 0
    options.rest = given[cut + 1 :]
    with unbroken_output():
        try:
            return options.word(options)
        except UserError as refusal:
            sentence = str(refusal)
        except Exception as error:
            sentence = describe_resource_error(error) or fault_sentence(error, keep_trace(error))
    print(f"studiorecon: {sentence}", file=sys.stderr)
    return 1


def _cores(given: str) -> str:
    """``all`` or a number of processor cores; Snakemake starts with 0 cores, and then no job."""
    if given != "all" and not (given.isascii() and given.isdigit() and int(given) > 0):
        raise argparse.ArgumentTypeError(f"{given!r} is neither a number of cores from 1 on nor all")
    return given


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="studiorecon",
        description="From the videos of a few static, far-apart cameras to a 4D scene. Results "
        "go to results/ in the current folder.",
        epilog="Arguments after -- go to Snakemake: studiorecon run DIR -- --dry-run --config capture='{width: 960}'",
    )
    parser.set_defaults(word=None)
    parser.add_argument("--version", action="version", version=f"studiorecon {_version()}")
    words = parser.add_subparsers(metavar="WORD")

    def word(name: str, does: Any, goal: str, runs: bool = True) -> argparse.ArgumentParser:
        made = words.add_parser(
            name, help=goal, description=goal[0].upper() + goal[1:] + ".", epilog=parser.epilog if runs else None
        )
        made.set_defaults(word=does)
        if runs:
            made.add_argument(
                "--cores", type=_cores, default="all", metavar="N", help="processor cores to use (default: all)"
            )
        return made

    demo = word("demo", _demo, "film a synthetic studio and reconstruct it (minutes, needs no data)")
    doctor = word("doctor", _doctor, "check calibration, clocks, exposures and coverage before anything expensive")
    look = word("look", _look, "preview a capture: one small film, nothing else")
    run = word("run", _run, "reconstruct a capture: films, page and files for other tools")
    plan = word("plan", _plan, "suggest camera positions for a room or a capture, with a picture")
    window = word("open", _open, "one window: drop videos, look, correct, fly", runs=False)
    view = word("view", _view, "show a finished scene's page in the browser", runs=False)
    settings = word("settings", _settings, "print every setting with its meaning and default", runs=False)
    for made in (doctor, look, run):
        several: dict[str, Any] = {"nargs": "+"} if made is run else {}
        films = "the capture: videos/ with one file per camera, and optional calibration, keypoints, masks, depth"
        made.add_argument("folder", type=Path, metavar="DIR", help=films, **several)
    run.add_argument(
        "--rig",
        type=Path,
        metavar="DIR",
        help="take whose cameras the others use (default: one with a calibration, or the longest)",
    )
    for made in (demo, run):
        made.add_argument("--preset", metavar="P", help=f"{', '.join(preset_names())}, or a file of your own")
        made.add_argument("--budget", metavar="MIN", type=float, help="minutes it may take: chooses the preset")
    real = f"a first look at a real take instead, in this folder; pip fetches it once (default: {TAKE}/)"
    demo.add_argument("--real", nargs="?", const=Path(TAKE), type=Path, metavar="DIR", help=real)
    _add_plan_arguments(plan)
    _add_view_arguments(view)
    _add_window_arguments(window)
    begins = "section or setting: people, people.fit, render.shots"
    settings.add_argument("name", nargs="?", default="", help=begins)
    return parser


def _add_plan_arguments(plan: argparse.ArgumentParser) -> None:
    folder_help = "a calibrated capture; without it, give --room"
    plan.add_argument("folder", type=Path, nargs="?", metavar="DIR", help=folder_help)
    plan.add_argument("--room", metavar="WxDxH", help="width, depth and height in metres: 6x5x2.8")
    plan.add_argument("--cameras", metavar="N", default="4", help="number of cameras (default: 4)")
    field = "horizontal field of view, one or one each (default: 65)"
    plan.add_argument("--hfov", nargs="+", default=["65"], metavar="DEG", help=field)
    plan.add_argument("--resolution", default="1920x1080", metavar="WxH", help="of the pictures (default: 1920x1080)")
    above = "the room from above (default: plan.svg, with plan.json in the same folder)"
    plan.add_argument("--picture", default="plan.svg", metavar="FILE", help=above)


def _add_view_arguments(view: argparse.ArgumentParser) -> None:
    finished = "the capture or its results folder (default: the demo's)"
    view.add_argument("folder", nargs="?", default="demo", metavar="DIR", help=finished)
    _add_server_arguments(view)


def _add_window_arguments(window: argparse.ArgumentParser) -> None:
    home = "folder of projects, which gets results/ too (default: the current one); or one capture"
    window.add_argument("folder", nargs="?", type=Path, default=Path(), metavar="DIR", help=home)
    _add_server_arguments(window)


def _add_server_arguments(word: argparse.ArgumentParser) -> None:
    port = f"port on 127.0.0.1 (default: {_PORT}; 0: a free one)"
    word.add_argument("--port", type=int, default=_PORT, help=port)
    word.add_argument("--no-browser", action="store_true", help="only serve and print the address")


def _version() -> str:
    try:
        return version("studiorecon")
    except PackageNotFoundError:  # the package is on the path, but not installed
        return "not installed"


def _demo(options: argparse.Namespace) -> int:
    if options.real is not None:
        fetch_take(options.real)
        options.preset = options.preset or "look"
        return _snakemake("look", str(options.real), options)
    return _snakemake("", _DEMO, options)


def _doctor(options: argparse.Namespace) -> int:
    meanwhile = _quick_check(options.folder) if options.folder.is_dir() else ()
    return _snakemake("doctor", _capture(options.folder), options, meanwhile)


def _quick_check(folder: Path) -> Iterator[str]:
    from studiorecon.cli.quick_check import quick_check  # loads OpenCV, for which Snakemake does not wait

    yield from quick_check(folder)


def _look(options: argparse.Namespace) -> int:
    options.preset = "look"
    return _snakemake("look", _capture(options.folder), options)


def _run(options: argparse.Namespace) -> int:
    if len(options.folder) > 1 or options.rig is not None:
        return _run_takes(options)
    return _snakemake("", _capture(options.folder[0]), options)


def _run_takes(options: argparse.Namespace) -> int:
    from studiorecon.cli import takes  # loads numerical libraries, which other subcommands do not need

    rest = options.rest
    if own := [
        word for word in split_option(rest, ("--config", "-C"))[0] if word.startswith(("scene=", "capture_yaml="))
    ]:
        raise UserError(f"{own[0]} is for one take; run it alone, or leave this out")
    found, notes = takes.open_takes(options.folder)
    rig_of = takes.open_takes([options.rig])[0] if options.rig is not None else []
    if not found or (options.rig is not None and not rig_of):
        raise UserError(f"{options.folder[0] if rig_of else options.rig} is no folder; give the folders of the takes")

    def run(folder: Path, more: Sequence[str]) -> tuple[int, bool]:
        options.rest, options.stopped = [*rest, *(["--config", *more] if more else [])], False
        return _snakemake("", str(folder), options), options.stopped

    for note in notes:
        print(note, flush=True)
    rows = takes.run_takes(found, rig_of[0] if rig_of else None, run)
    print(takes.table_text(rows))
    return int(any(row["result"] != "done" for row in rows))


def _plan(options: argparse.Namespace) -> int:
    if options.folder is not None:
        return _snakemake("plan", _capture(options.folder), options)
    if options.room is None:
        raise UserError(
            "give the room, studiorecon plan --room 6x5x2.8 --cameras 4 --hfov 65, or the folder of a capture"
        )
    picture = Path(options.picture)
    words = [
        "--room",
        options.room,
        "--cameras",
        options.cameras,
        "--hfov-deg",
        *options.hfov,
        "--resolution",
        options.resolution,
    ]
    return step_main(
        ["placement.place", *words, "--picture", str(picture), "--plan", str(picture.with_suffix(".json"))]
    )


def _capture(folder: Path) -> str:
    if not folder.exists() and not (HOME / folder).is_file():
        raise UserError(
            f"there is no folder {folder}; give the folder of your capture, which "
            "holds videos/ with one file per camera"
        )
    if folder.is_file() and folder.suffix not in (".yaml", ".yml"):
        raise UserError(
            f"{folder} is a file; give the folder of your capture, which holds videos/ with one file per camera"
        )
    return str(folder)


def _snakemake(target: str, dataset: str, options: argparse.Namespace, meanwhile: Iterable[str] = ()) -> int:
    """Snakemake's exit status; the sentences ``meanwhile`` are printed while it starts, and a refusal there ends it."""
    budget = getattr(options, "budget", None)
    command = snakemake_command(target, dataset, options.cores, getattr(options, "preset", None), options.rest)
    command += [] if budget is None else [f"budget_min={budget:g}"]
    with subprocess.Popen(command, env=environment()) as process:
        try:
            for sentence in meanwhile:
                print(sentence, flush=True)
        except UserError:
            process.terminate()
            raise
        while True:
            try:
                status = process.wait()
                break
            except KeyboardInterrupt:
                # Snakemake got the signal as well, and ends its jobs in order.
                options.stopped = True
                continue
    return status


def finished_scene(folder: str) -> Path:
    """The results folder for a capture's folder, a scene's name or itself; raises UserError without a page."""
    name = Path(folder).stem if folder.endswith((".yaml", ".yml")) else os.path.basename(os.path.realpath(folder))
    for place in (Path(folder), Path("results") / folder, Path("results") / name):
        if (place / "report" / "index.html").is_file():
            return place
    there = sorted(page.parents[1].name for page in Path("results").glob("*/report/index.html"))
    others = f"; finished here: {', '.join(there)}" if there else ""
    raise UserError(
        f"there is no finished scene of {folder} in results/ of this folder{others}; make it with: studiorecon "
        f"{'demo' if folder == 'demo' else f'run {folder}'}"
    )


def _view(options: argparse.Namespace) -> int:
    from studiorecon.window.serving import Folder, LocalServer  # loads the server, which other subcommands do not need

    return _serve(LocalServer(Folder(finished_scene(str(options.folder))), options.port), "report/", options)


def _open(options: argparse.Namespace) -> int:
    from studiorecon.window.app import build_app
    from studiorecon.window.projects import enter
    from studiorecon.window.serving import LocalServer

    page = enter(options.folder)
    return _serve(LocalServer(build_app(), options.port), page, options)


def _serve(server: LocalServer, page: str, options: argparse.Namespace) -> int:
    print(f"{server.address(page)} (Ctrl-C ends it)", flush=True)
    if not options.no_browser:
        webbrowser.open(server.address(page))
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        print()
    return 0


def _settings(options: argparse.Namespace) -> int:
    import yaml

    from studiorecon.configuration import catalogue
    from studiorecon.render.kinds import KINDS

    schema: Mapping[str, Any] = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    every = [*catalogue.list_settings(CONFIGURATION, schema), *catalogue.list_film_settings(KINDS, schema)]
    chosen = [setting for setting in every if f"{setting.name}.".startswith(f"{options.name}." if options.name else "")]
    chosen = chosen or [setting for setting in every if setting.name.startswith(options.name)]
    if not chosen:
        near = difflib.get_close_matches(options.name, [setting.name for setting in every], 1, 0.5)
        raise UserError(f"there is no setting {options.name}{f'; did you mean {near[0]}?' if near else ''}")
    print(catalogue.settings_text(chosen, 110))
    return 0


if __name__ == "__main__":
    sys.exit(main())
