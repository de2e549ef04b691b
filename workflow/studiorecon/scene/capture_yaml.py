# SPDX-License-Identifier: Apache-2.0
"""The keys of ``capture.yaml``, and the check of each value."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.scene.names import fold_name
from studiorecon.scene.user_files import read_yaml
from studiorecon.scene.user_values import as_list, as_mapping, name, number, path, short_text, whole

_KEYS = {
    "chapters", "frames", "starts", "held_out", "train", "calibration", "keypoints",
    "keypoint_layout", "keypoint_first_frame", "plates", "masks", "depth", "pixel_maps", "people", "identities",
    "focal_px", "height_m", "distance_m",
}  # fmt: skip
_SPELLINGS = ("capture.yaml", "capture.yml", "capture.yaml.txt")
MAX_PEOPLE = 100
# Focal lengths in pixels: lenses have smaller numbers in millimetres, and no telescope a larger one.
MIN_FOCAL_PX, MAX_FOCAL_PX = 50.0, 1e6
MIN_HEIGHT_M, MAX_HEIGHT_M = 0.5, 2.8
MAX_DISTANCE_M = 1000.0
# Eleven days at 100 frames per second.
_MAX_FRAMES = 10**8
# Nanoseconds since 1970 have 19 digits; more fit no integer.
_MAX_NUMBER = 2**63 - 1
# Pictures of other sizes than the calibration's: from a thumbnail to four times 4K; no picture is wider than 16,384 px.
MIN_PIXEL_SCALE, MAX_PIXEL_SCALE, MAX_PIXEL_OFFSET = 0.05, 20.0, 16384.0
# Keys that apply only without a calibration, and keys about recorded keypoints.
WITHOUT_CALIBRATION = ("focal_px", "height_m", "distance_m")
ABOUT_KEYPOINTS = ("keypoint_layout", "keypoint_first_frame")


def description_path(folder: Path) -> Path:
    """``capture.yaml`` in ``folder``, or the file of that name in another spelling (``capture.yml``, ``.txt``)."""
    spelled = [path for path in folder.glob("[cC]*") if path.name.casefold() in _SPELLINGS]
    if len(spelled) > 1:
        raise UserError(f"{folder} has {' and '.join(sorted(path.name for path in spelled))}; keep one")
    return spelled[0] if spelled else folder / "capture.yaml"


def read_description(folder: Path, capture_yaml: Path | None) -> dict[str, Any]:
    """The contents of ``capture_yaml`` (default: ``capture.yaml`` in ``folder``, if any); UserError for unknown
    keys."""
    path = capture_yaml or description_path(folder)
    if not path.exists() and not path.is_symlink():
        if capture_yaml is None:
            return {}
        raise UserError(
            f"{path} does not exist; pass an existing file with --config capture_yaml=FILE, or leave it out"
        )
    description = read_yaml(path)
    if description is None:
        return {}
    if not isinstance(description, dict):
        raise UserError(
            f"{path} holds {short_text(description)}; it must be lines of KEY: VALUE, such as held_out: [cam4]"
        )
    if unknown := sorted(set(map(str, description)) - _KEYS):
        near = difflib.get_close_matches(unknown[0].lower(), _KEYS, 1)
        meant = f"did you mean {near[0]}?" if near else f"known keys are {', '.join(sorted(_KEYS))}"
        raise UserError(f"{path} has the unknown key {short_text(unknown[0])}; {meant}")
    return description


def _check_named(camera: Any, key: str, footage: Mapping[str, Path]) -> str:
    given = str(camera)
    matches = [known for known in footage if fold_name(known) == fold_name(given)]
    if given not in footage and len(matches) != 1:
        raise UserError(
            f"capture.yaml lists camera {short_text(given)} under {key}, but the footage has {', '.join(footage)}; "
            "names with leading zeros have to keep them"
        )
    return given if given in footage else matches[0]


def names_under(description: dict[str, Any], key: str, footage: Mapping[str, Path]) -> list[str]:
    """The cameras listed under ``key``; all of them must be in ``footage``."""
    chosen = as_list(description.get(key), f"capture.yaml: {key}", "[cam01, cam02]")
    found = [_check_named(camera, key, footage) for camera in chosen]
    if twice := [camera for camera in dict.fromkeys(found) if found.count(camera) > 1]:
        raise UserError(f"capture.yaml lists camera {twice[0]!r} under {key} twice; keep one")
    return found


def chapters(description: dict[str, Any]) -> dict[str, list[str]]:
    """camera → the films of its recording in order, as listed under ``chapters``."""
    where = "capture.yaml: chapters"
    given = as_mapping(description.get("chapters"), where, "{cam1: [videos/first.mp4, videos/second.mp4]}")
    return {
        name(camera, where): [
            path(film, f"{where} of {camera}")
            for film in as_list(films, f"{where} of {camera}", "[videos/first.mp4, videos/second.mp4]")
        ]
        for camera, films in given.items()
    }


def path_under(description: dict[str, Any], key: str) -> str | None:
    """The file or folder named under ``key``; None without the key."""
    return None if description.get(key) is None else path(description[key], f"capture.yaml: {key}")


def paths_under(description: dict[str, Any], key: str) -> list[str] | None:
    """The file or list of files named under ``key``; None without the key."""
    given = description.get(key)
    if given is None:
        return None
    several = [given] if isinstance(given, str) else as_list(given, f"capture.yaml: {key}", "[intri.yml, extri.yml]")
    found = [path(each, f"capture.yaml: {key}") for each in several]
    if not found:
        raise UserError(f"capture.yaml: {key} names no file; name one, or take the line out")
    return found


def has_people(description: dict[str, Any]) -> bool:
    """False where ``people`` says that the room is empty."""
    given = description.get("people", 1)
    if given in (False, "none"):
        return False
    if given is True or given is None:
        return True
    return whole(given, "capture.yaml: people", 0, MAX_PEOPLE, "the number of people, 0 for an empty room,") > 0


def frames_used(description: dict[str, Any]) -> tuple[int, int]:
    """First frame and number of frames (0 = to the end), from ``frames``."""
    frames = as_mapping(description.get("frames"), "capture.yaml: frames", "{first: 0, count: 60}")
    if set(frames) - {"first", "count"}:
        raise UserError("capture.yaml: frames must have the form {first: 0, count: 60}")
    first = whole(frames.get("first", 0), "capture.yaml: frames.first", 0, _MAX_FRAMES)
    count = whole(frames.get("count", 0), "capture.yaml: frames.count", 0, _MAX_FRAMES)
    if count == 1:
        raise UserError("capture.yaml: frames.count is 1; nothing moves in one frame, choose at least 2")
    return first, count


def by_camera(description: dict[str, Any], key: str, footage: Mapping[str, Path]) -> dict[str, Any]:
    """camera → its value under ``key``, one of ``starts``, ``keypoint_first_frame``, ``focal_px`` and ``pixel_maps``.

    One value may stand for all cameras where ``_PER_CAMERA`` gives no form. Empty without the key.
    """
    read, form = _PER_CAMERA[key]
    given = description.get(key)
    if given is not None and not isinstance(given, Mapping) and not form:
        given = dict.fromkeys(footage, given)
    found: dict[str, Any] = {}
    for camera, value in as_mapping(given, f"capture.yaml: {key}", form).items():
        named = _check_named(camera, key, footage)
        if named in found:
            raise UserError(f"capture.yaml: {key} has camera {named} twice; keep one")
        found[named] = read(value, f"capture.yaml: {key} of {camera}")
    return found


def measured_lengths(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, Any]:
    """Lengths under ``height_m`` (person → metres, or one number) and ``distance_m`` ([camera, camera, metres])."""
    found: dict[str, Any] = {}
    if (heights := description.get("height_m")) is not None:
        table = heights if isinstance(heights, dict) else {"": heights}
        what = f"somebody's height in metres, {MIN_HEIGHT_M:g} to {MAX_HEIGHT_M:g}"
        found["height_m"] = {
            str(person): number(
                value, f"capture.yaml: height_m{f' of {person}' if person else ''}", MIN_HEIGHT_M, MAX_HEIGHT_M, what
            )
            for person, value in table.items()
        }
    if (distance := description.get("distance_m")) is not None:
        where, what = "capture.yaml: distance_m", "[cam01, cam02, 3.21]: metres from lens to lens of two cameras"
        if not isinstance(distance, list) or len(distance) != 3:
            raise UserError(f"{where} is {short_text(distance)}; it must have the form {what}")
        metres = number(distance[2], where, 1e-3, MAX_DISTANCE_M, f"{what}, of at most {MAX_DISTANCE_M:g} m")
        pair = [_check_named(camera, "distance_m", footage) for camera in distance[:2]]
        if pair[0] == pair[1]:
            raise UserError(f"{where} is from camera {pair[0]} to itself; name two cameras")
        found |= {"between": pair, "distance_m": metres}
    return found


def _in_range(low: float, high: float, what: str) -> Callable[[Any, str], float]:
    return lambda value, where: number(value, where, low, high, what)


def _pixel_map(entry: Any, where: str) -> tuple[float, float, float]:
    offset = entry.get("offset") if isinstance(entry, dict) and set(entry) == {"scale", "offset"} else None
    if not isinstance(offset, list) or len(offset) != 2:
        raise UserError(f"{where} must have the form {{scale: 0.99, offset: [0.0, 7.2]}}")
    what = f"pixels of the video per pixel of the calibration, {MIN_PIXEL_SCALE:g} to {MAX_PIXEL_SCALE:g}"
    scale = number(entry["scale"], f"{where}: scale", MIN_PIXEL_SCALE, MAX_PIXEL_SCALE, what)
    what = f"a number of pixels of at most {MAX_PIXEL_OFFSET:g}"
    x, y = (number(value, f"{where}: offset", -MAX_PIXEL_OFFSET, MAX_PIXEL_OFFSET, what) for value in offset)
    return scale, x, y


_PER_CAMERA: Mapping[str, tuple[Callable[[Any, str], Any], str]] = {
    "starts": (
        _in_range(-_MAX_FRAMES, _MAX_FRAMES, f"a number of frames of at most {_MAX_FRAMES}, such as 13 or 12.6"),
        "{cam02: 13}: the frame of cam02's video at which the others begin",
    ),
    "keypoint_first_frame": (lambda value, where: whole(value, where, -_MAX_NUMBER, _MAX_NUMBER), ""),
    "focal_px": (
        _in_range(
            MIN_FOCAL_PX,
            MAX_FOCAL_PX,
            f"a length in pixels above 0, of {MIN_FOCAL_PX:g} to {MAX_FOCAL_PX:g} (not millimetres)",
        ),
        "",
    ),
    "pixel_maps": (_pixel_map, "{cam01: {scale: 0.99, offset: [0.0, 7.2]}}"),
}
"""Keys with a value per camera: its check, and its form."""
