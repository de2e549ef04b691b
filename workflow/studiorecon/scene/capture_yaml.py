# SPDX-License-Identifier: Apache-2.0
"""What a user may write into ``capture.yaml``: its keys, and each value read with a sentence for whatever is wrong."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.scene.outside import read_yaml
from studiorecon.scene.values import listed, mapping, name, number, numbers, path, shown, whole

_KEYS = {
    "chapters", "frames", "starts", "held_out", "train", "calibration", "keypoints",
    "keypoint_layout", "keypoint_first_frame", "plates", "masks", "depth", "pixel_maps", "people", "identities",
    "focal_px", "height_m", "distance_m",
}  # fmt: skip


MOST_PEOPLE = 100
LEAST_FOCAL_PX, MOST_FOCAL_PX = 50.0, 1e6
MOST_DISTANCE_M = 1000.0
_MOST_FRAMES = 10**8


def read_description(folder: Path, capture_yaml: Path | None) -> dict[str, Any]:
    """What ``capture_yaml`` (default: ``capture.yaml`` in ``folder``, if it is there) says; UserError for a key that
    there is not."""
    path = capture_yaml or folder / "capture.yaml"
    if capture_yaml is not None and not path.exists() and not path.is_symlink():
        raise UserError(
            f"{path} does not exist; pass an existing file with --config capture_yaml=FILE, or leave it out"
        )
    if not path.exists() and not path.is_symlink():
        return {}
    description = read_yaml(path)
    if description is None:
        return {}
    if not isinstance(description, dict):
        raise UserError(f"{path} holds {shown(description)}; it must be lines of KEY: VALUE, such as held_out: [cam4]")
    unknown = sorted(set(map(str, description)) - _KEYS)
    if unknown:
        raise UserError(f"{path} has the unknown key {unknown[0]!r}; known keys are {', '.join(sorted(_KEYS))}")
    return description


def _check_named(camera: Any, key: str, footage: Mapping[str, Path]) -> str:
    if str(camera) not in footage:
        there = ", ".join(footage)
        raise UserError(
            f"capture.yaml lists camera {str(camera)!r} under {key}, but the footage has "
            f"{there}; quote names with leading zeros"
        )
    return str(camera)


def names_under(description: dict[str, Any], key: str, footage: Mapping[str, Path]) -> list[str]:
    """The cameras listed under ``key``, all of them in ``footage``."""
    chosen = listed(description.get(key), f"capture.yaml: {key}", "[cam01, cam02]")
    found = [_check_named(camera, key, footage) for camera in chosen]
    if twice := [camera for camera in dict.fromkeys(found) if found.count(camera) > 1]:
        raise UserError(f"capture.yaml lists camera {twice[0]!r} under {key} twice; keep one")
    return found


def chapters(description: dict[str, Any]) -> dict[str, list[str]]:
    """camera → the films of its recording in order, as ``chapters`` lists them."""
    where = "capture.yaml: chapters"
    given = mapping(description.get("chapters"), where, "{cam1: [videos/first.mp4, videos/second.mp4]}")
    return {
        name(camera, where): [
            path(film, f"{where} of {camera}")
            for film in listed(films, f"{where} of {camera}", "[videos/first.mp4, videos/second.mp4]")
        ]
        for camera, films in given.items()
    }


def path_under(description: dict[str, Any], key: str) -> str | None:
    """The file or folder named under ``key``, or None where there is none."""
    return None if description.get(key) is None else path(description[key], f"capture.yaml: {key}")


def paths_under(description: dict[str, Any], key: str) -> list[str] | None:
    """The file named under ``key``, or the list of them; None where there is none."""
    given = description.get(key)
    if given is None:
        return None
    several = given if isinstance(given, str) else listed(given, f"capture.yaml: {key}", "[intri.yml, extri.yml]")
    found = [several] if isinstance(several, str) else [path(each, f"capture.yaml: {key}") for each in several]
    if not found:
        raise UserError(f"capture.yaml: {key} names no file; name one, or take the line out")
    return found


def anybody(description: dict[str, Any]) -> bool:
    """False where ``people`` says that the room is empty."""
    given = description.get("people", 1)
    if given in (False, "none"):
        return False
    if given is True or given is None:
        return True
    return whole(given, "capture.yaml: people", 0, MOST_PEOPLE, "the number of people, 0 for an empty room,") > 0


def frames_used(description: dict[str, Any], folder: Path) -> tuple[int, int]:
    """First frame and number of frames (0 = to the end) that ``frames`` chooses."""
    frames = description.get("frames") or {}
    if not isinstance(frames, dict) or set(frames) - {"first", "count"}:
        raise UserError(f"capture.yaml of {folder}: frames must look like {{first: 0, count: 60}}")
    first, count = frames.get("first", 0), frames.get("count", 0)
    if not all(isinstance(v, int) and not isinstance(v, bool) and 0 <= v <= _MOST_FRAMES for v in (first, count)):
        raise UserError(f"capture.yaml of {folder}: frames.first and frames.count must be whole numbers ≥ 0")
    if count == 1:
        raise UserError(f"capture.yaml of {folder}: frames.count is 1; nothing moves in one frame, choose at least 2")
    return first, count


def starts_of(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, float]:
    """camera → the frame of its footage that shows one moment, 0 for cameras that are not named; empty where
    capture.yaml names none."""
    given = description.get("starts")
    given = {} if given is None else given
    if not isinstance(given, dict):
        raise UserError(
            "capture.yaml: starts must look like {cam02: 13}: the frame of cam02's video at which the others begin"
        )
    found = dict.fromkeys(footage, 0.0)
    for camera, value in given.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e9:
            raise UserError(
                f"capture.yaml: starts of {camera} is {value!r}; it must be a number of frames, such as 13 or 12.6"
            )
        found[_check_named(camera, "starts", footage)] = float(value)
    return found if given else {}


def whole_number(description: dict[str, Any], key: str, folder: Path) -> int:
    """The whole number under ``key``, 0 when there is none."""
    value = description.get(key, 0)
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) > _MOST_FRAMES:
        raise UserError(f"capture.yaml of {folder}: {key} must be a whole number, not {shown(value)}")
    return value


def focal_lengths(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, float]:
    """camera → ``focal_px``, in pixels of its footage; one number is everybody's."""
    given = description.get("focal_px")
    if given is None:
        return {}
    table = given if isinstance(given, dict) else dict.fromkeys(footage, given)
    return {
        _check_named(camera, "focal_px", footage): number(
            value,
            f"capture.yaml: focal_px of {camera}",
            LEAST_FOCAL_PX,
            MOST_FOCAL_PX,
            f"a length in pixels above 0, of {LEAST_FOCAL_PX:g} to {MOST_FOCAL_PX:g} (not millimetres)",
        )
        for camera, value in table.items()
    }


def measured_lengths(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, Any]:
    """What ``height_m`` (person → metres, or one number) and ``distance_m`` ([camera, camera, metres]) say; empty:
    nothing."""
    found: dict[str, Any] = {}
    if (heights := description.get("height_m")) is not None:
        table = heights if isinstance(heights, dict) else {"": heights}
        for person, value in table.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.5 < value < 2.8:
                who = f" of {person}" if person else ""
                raise UserError(f"capture.yaml: height_m{who} is {value!r}; it must be somebody's height in metres")
        found["height_m"] = {str(person): float(value) for person, value in table.items()}
    if (distance := description.get("distance_m")) is not None:
        listed = distance if isinstance(distance, list) and len(distance) == 3 else [None, None, None]
        metres = listed[2]
        if isinstance(metres, bool) or not isinstance(metres, (int, float)) or not 0 < metres < MOST_DISTANCE_M:
            raise UserError(
                "capture.yaml: distance_m must look like [cam01, cam02, 3.21]: metres from lens to lens of two cameras"
            )
        pair = [_check_named(camera, "distance_m", footage) for camera in listed[:2]]
        if pair[0] == pair[1]:
            raise UserError(f"capture.yaml: distance_m is from camera {pair[0]} to itself; name two cameras")
        found |= {"between": pair, "distance_m": float(metres)}
    return found


def pixel_maps(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, tuple[float, float, float]]:
    """camera → (scale, x, y) of ``pixel_maps``."""
    maps = mapping(
        description.get("pixel_maps"), "capture.yaml: pixel_maps", "{cam01: {scale: 0.99, offset: [0.0, 7.2]}}"
    )
    found = {}
    for camera, entry in maps.items():
        camera_name = _check_named(camera, "pixel_maps", footage)
        where = f"capture.yaml: pixel_maps of {camera}"
        example = f"{where} must look like {{scale: 0.99, offset: [0.0, 7.2]}}"
        if not isinstance(entry, dict) or set(entry) != {"scale", "offset"}:
            raise UserError(example)
        offset = numbers(entry["offset"], f"{where}: offset")
        if offset.shape != (2,):
            raise UserError(example)
        scale = number(entry["scale"], f"{where}: scale", 1e-3, 1e3, "a factor above 0, such as 0.99")
        found[camera_name] = (scale, float(offset[0]), float(offset[1]))
    return found
