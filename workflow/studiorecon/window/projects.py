# SPDX-License-Identifier: Apache-2.0
"""The projects of the current folder: what a capture holds, what was not used, and what a run made of it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import yaml

from studiorecon.configuration.schema import coerce_types
from studiorecon.errors import UserError
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.kinds import film_suffixes
from studiorecon.footage.source import open_source
from studiorecon.home import CONFIGURATION, HOME, PRESETS, SCHEMA
from studiorecon.images.encoded import jpeg
from studiorecon.machine.resource_errors import describe_resource_error
from studiorecon.pages.run_summary import read_warnings
from studiorecon.plan.budget import choose_preset
from studiorecon.plan.discovery import open_dataset
from studiorecon.plan.films import find_recordings
from studiorecon.plan.make import make_plan
from studiorecon.scene.capture_yaml import description_path, read_description
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.files import write_text
from studiorecon.scene.names import check_name, is_system_file

_NOT_CAPTURES = {"results", "logs", "timings"}
_THUMBNAIL_PX = 360
# Results that the window opens: key and pattern below results/<scene>.
_RESULTS = {
    "player": "deliver/player.html",
    "page": "report/index.html",
    "doctor": "calibration/doctor.html",
    "review": "people/review.html",
}


def enter(folder: Path) -> str:
    """Make ``folder`` the current one, and return the window's page; of a capture, its own project in the current
    folder. Raises UserError where there is no folder, or none that may be written."""
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}; make it first, or leave it out to use the current one")
    if folder.resolve() != Path.cwd() and (folder / "videos").is_dir():
        return f"#{quote(link_folder(str(folder.resolve())))}"
    os.chdir(folder)
    if not os.access(".", os.W_OK | os.X_OK):
        raise UserError(f"{folder} may not be written; choose another folder, or: chmod u+rwx {folder}")
    return ""


def list_projects() -> list[dict[str, Any]]:
    """``name``, ``is_capture`` and ``made`` (a film is there) of every project: captures, and scenes in results/."""
    names = {p.name for p in Path().iterdir() if p.is_dir() and _is_project(p)}
    scenes = {p.parents[1].name for p in Path("results").glob("*/capture/manifest.json")}
    return [
        {"name": name, "is_capture": name in names, "made": bool(_films(name))}
        for name in sorted(names | scenes, key=str.casefold)
    ]


def _is_project(folder: Path) -> bool:
    if folder.name in _NOT_CAPTURES or is_system_file(folder) or folder.name.startswith("."):
        return False
    try:
        return (folder / "videos").is_dir() or bool(find_recordings(folder, {}).films)
    except (UserError, OSError):
        return not any(folder.iterdir()) if os.access(folder, os.R_OK) else False


def find_project(name: str) -> Path:
    """The capture's folder of a project; raises UserError when there is no such project."""
    if any(project["name"] == name for project in list_projects()):
        return Path(name)
    raise UserError(f"there is no project {name} in {Path.cwd()}")


def new_project(name: str) -> None:
    """Make the empty folder of a project. Raises UserError for a name that a scene may not have, or that is taken."""
    check_name(name, "the project", "choose another name")
    if name in {*_NOT_CAPTURES, "studio", "body"}:
        raise UserError(f"{name} is the name of a folder of results; choose another name")
    try:
        (Path(name) / "videos").mkdir(parents=True)
    except FileExistsError:
        raise UserError(f"there is a folder {name} already; open that project, or choose another name") from None


def link_folder(given: str) -> str:
    """The project for a folder anywhere on this machine, by a link: nothing is copied. UserError without films."""
    folder = Path(given).expanduser()
    if not folder.is_absolute() or not folder.is_dir():
        raise UserError(f"there is no folder {given}; give its whole path, such as {Path.home() / 'takes' / 'monday'}")
    folder = folder.resolve()
    find_recordings(folder, {})
    check_name(folder.name, f"the folder {folder}", "rename the folder")
    link = Path(folder.name)
    if folder.parent != Path.cwd() and not (link.is_symlink() and link.resolve() == folder):
        if link.exists() or link.is_symlink():
            raise UserError(f"there is a project {link} already, which is another folder; rename one of them")
        link.symlink_to(folder, target_is_directory=True)
    return link.name


def upload_path(name: str, given: str) -> Path:
    """The place in a project for a dropped file: films go to videos/, others keep their folder. Raises UserError where
    a file is already, or for a path out of the project."""
    parts = given.split("/")
    if not all(parts) or any(part.startswith(".") or "\\" in part or "\0" in part for part in parts):
        raise UserError(f"{given} is no name for a file of a capture; rename it")
    is_loose_film = len(parts) == 1 and Path(given).suffix.lower() in film_suffixes()
    path = find_project(name).joinpath(*(["videos"] if is_loose_film else []), *parts)
    if path.exists() or path.is_symlink():
        raise UserError(f"{path} is there already; it was not replaced. Remove it first if the new file is better")
    return path


def describe(name: str) -> dict[str, Any]:
    """What the window shows of a project; ``error`` is the sentence of a capture that cannot be used."""
    folder = find_project(name)
    results = Path("results") / name
    about: dict[str, Any] = {"name": name, "is_capture": folder.is_dir(), "cameras": [], "unused": [], "notes": []}
    about |= {"error": "", "calibration": "", "capture_yaml": "", "folder": str(folder.resolve())}
    if folder.is_dir():
        from studiorecon.cli.takes import rig_again  # loads numerical libraries, for which the window does not wait

        try:
            description = description_path(folder)
            about["capture_yaml"] = description.read_text("utf-8") if description.is_file() else ""
            about |= _understood(str(folder), _stamp(folder))
            about["notes"] = [*about["notes"], *filter(None, rig_again(folder)[1:])]
        except (UserError, OSError) as error:
            about["error"] = (
                str(error) if isinstance(error, UserError) else describe_resource_error(error) or str(error)
            )
    found = {what: f"{results}/{file}" for what, file in _RESULTS.items() if (results / file).is_file()}
    about["results"] = {**found, "films": [path.as_posix() for path in _films(name)]}
    about["warnings"] = sorted({sentence for _, sentence in read_warnings(Path("logs") / name)})
    about["doctor"] = _doctor(results / "calibration/doctor.json")
    about["settings"] = settings_file(name).as_posix() if settings_file(name).is_file() else ""
    return about


def _stamp(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Names, sizes and times of a capture's files, two folders deep: what was understood is kept while they stay."""
    paths = sorted([*folder.glob("*"), *folder.glob("*/*")])[:1000]
    return tuple((str(path), path.lstat().st_size, path.lstat().st_mtime_ns) for path in paths)


@lru_cache(maxsize=64)
def _understood(folder: str, _: Any) -> dict[str, Any]:
    from studiorecon.cli.quick_check import quick_check  # loads SciPy, for which the window does not wait

    dataset = open_dataset(Path(folder))
    cameras: dict[str, list[str]] = {camera: [] for camera in dataset.footage}
    about: dict[str, Any] = {"unused": [], "notes": []}
    for sentence in quick_check(Path(folder)):
        camera = next((c for c in cameras if sentence.startswith(f"camera {c}: ")), None)
        if camera is not None:
            cameras[camera].append(sentence.removeprefix(f"camera {camera}: "))
        elif sentence.startswith("calibration: "):
            about["calibration"] = sentence.removeprefix("calibration: ")
        elif sentence.startswith("not used: "):
            about["unused"].append(sentence.removeprefix("not used: "))
        else:
            about["notes"].append(sentence)
    held_out = set(dataset.held_out)
    listed = [{"name": c, "facts": facts, "held_out": c in held_out} for c, facts in cameras.items()]
    return {**about, "cameras": listed}


def _films(name: str) -> list[Path]:
    """The films of a scene, the newest first."""
    films = sorted((Path("results") / name / "enhance").glob("*.mp4"), key=lambda film: (-film.stat().st_mtime, film))
    films = [film for film in films if "." not in film.stem]
    return [film for film in films if film.stem != "heldout"] or films


def _doctor(report: Path) -> dict[str, Any]:
    try:
        held = json.loads(report.read_text(encoding="utf-8"))
        # What was not used is shown with the videos.
        said = [line for line in (*held["notes"], *held["advice"]) if not line.startswith("not used: ")]
        return {"verdict": held["verdict"], "sentences": said}
    except (OSError, ValueError, KeyError):
        return {}


def thumbnail(name: str, camera: str) -> bytes:
    """A small JPEG of the middle of a camera's film; raises UserError for a camera that is not there."""
    dataset: Dataset = open_dataset(find_project(name))
    if camera not in dataset.footage:
        raise UserError(f"{name} has no camera {camera}")
    film = dataset.footage[camera]
    return _thumbnail(film, film.stat().st_mtime_ns, film.stat().st_size)


@lru_cache(maxsize=256)
def _thumbnail(film: Path, *_: int) -> bytes:
    source = open_source(film, 0.0)
    picture = seek_frames(source, [source.frames // 2])[0]
    scale = _THUMBNAIL_PX / max(picture.shape[:2])
    return jpeg(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), 80)


def write_capture_yaml(name: str, text: str) -> None:
    """Replace capture.yaml. Raises UserError, and leaves the file, where the new text cannot be read."""
    description = description_path(find_project(name))
    tried = description.with_name(f".tried-{description.name}")
    try:
        write_text(tried, text)
        read_description(description.parent, tried)
        tried.replace(description)
    except UserError as refusal:
        raise UserError(f"{refusal}".replace(str(tried), "capture.yaml")) from None
    finally:
        tried.unlink(missing_ok=True)


def settings_file(name: str) -> Path:
    """The overlay of a project's own settings, beside its folder."""
    return Path(f"{name}.settings.yaml")


def presets(name: str) -> Iterator[dict[str, Any]]:
    """Presets with a description, and their minutes from the price list; the cheapest first."""
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    config = coerce_types(yaml.safe_load(CONFIGURATION.read_text(encoding="utf-8")), schema)
    config |= {"dataset": name, "budget_min": 1.0}
    for offer in choose_preset(config, {}, schema, make_plan(config, HOME), os.cpu_count() or 1).offers:
        file = PRESETS / f"{offer.point.preset}.yaml"
        first = file.read_text(encoding="utf-8").partition("\n")[0] if file.is_file() else ""
        about = first.removeprefix("# ").partition(". ")[0].rstrip(".:") or "The usual film"
        seconds = {
            "seconds": offer.prediction.seconds,
            "low_s": offer.prediction.low_s,
            "high_s": offer.prediction.high_s,
        }
        yield {"preset": offer.point.preset, "name": offer.point.preset or "default", "about": about, **seconds}
