# SPDX-License-Identifier: Apache-2.0
"""What a user may write into ``capture.yaml``: its keys, and each value read with a sentence for whatever is wrong."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from studiorecon.errors import UserError

_KEYS = {
    "frames", "starts", "held_out", "train", "calibration", "keypoints", "keypoint_layout", "keypoint_first_frame",
    "plates", "masks", "depth", "pixel_maps", "people", "identities", "focal_px",
    "height_m", "distance_m",
}  # fmt: skip


def read_description(folder: Path, capture_yaml: Path | None) -> dict[str, Any]:
    """What ``capture_yaml`` (default: ``capture.yaml`` in ``folder``, if it is there) says; UserError for a key that
    there is not."""
    path = capture_yaml or folder / "capture.yaml"
    if not path.is_file():
        if capture_yaml is not None:
            raise UserError(
                f"{path} does not exist; pass an existing file with --config capture_yaml=FILE, or leave it out"
            )
        return {}
    try:
        description = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except yaml.YAMLError as error:
        raise UserError(f"{path} is not valid YAML ({str(error).splitlines()[0]})") from None
    unknown = sorted(set(description) - _KEYS) if isinstance(description, dict) else ["(not a mapping)"]
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
    return [_check_named(name, key, footage) for name in description.get(key) or []]


def frames_used(description: dict[str, Any], folder: Path) -> tuple[int, int]:
    """First frame and number of frames (0 = to the end) that ``frames`` chooses."""
    frames = description.get("frames") or {}
    if not isinstance(frames, dict) or set(frames) - {"first", "count"}:
        raise UserError(f"capture.yaml of {folder}: frames must look like {{first: 0, count: 60}}")
    first, count = frames.get("first", 0), frames.get("count", 0)
    if not all(isinstance(v, int) and v >= 0 for v in (first, count)):
        raise UserError(f"capture.yaml of {folder}: frames.first and frames.count must be whole numbers ≥ 0")
    return first, count


def starts_of(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, float]:
    """camera → the frame of its footage that shows one moment, 0 for cameras that are not named; empty where
    capture.yaml names none."""
    given = description.get("starts") or {}
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
    if not isinstance(value, int) or isinstance(value, bool):
        raise UserError(f"capture.yaml of {folder}: {key} must be a whole number, not {value!r}")
    return value


def focal_lengths(description: dict[str, Any], footage: Mapping[str, Path]) -> dict[str, float]:
    """camera → ``focal_px``, in pixels of its footage; one number is everybody's."""
    given = description.get("focal_px") or {}
    table = given if isinstance(given, dict) else dict.fromkeys(footage, given)
    found = {}
    for camera, value in table.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
            raise UserError(f"capture.yaml: focal_px of {camera} is {value!r}; it must be a length in pixels above 0")
        found[_check_named(camera, "focal_px", footage)] = float(value)
    return found


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
        if isinstance(metres, bool) or not isinstance(metres, (int, float)) or not metres > 0:
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
    maps = description.get("pixel_maps") or {}
    if not isinstance(maps, dict):
        raise UserError("capture.yaml: pixel_maps must look like {cam01: {scale: 0.99, offset: [0.0, 7.2]}}")
    found = {}
    for camera, entry in maps.items():
        name = _check_named(camera, "pixel_maps", footage)
        try:
            found[name] = (float(entry["scale"]), float(entry["offset"][0]), float(entry["offset"][1]))
        except (TypeError, KeyError, IndexError, ValueError):
            raise UserError(
                f"capture.yaml: pixel_maps of {camera} must look like {{scale: 0.99, offset: [0.0, 7.2]}}"
            ) from None
    return found
