# SPDX-License-Identifier: Apache-2.0
"""OpenCV's FileStorage, one XML, YAML or JSON file per camera, with any usual spelling of its entries.

ROS's ``camera_info`` has the same layout. Rotation and translation take the world to the camera, as ``solvePnP`` and
``calibrateCamera`` return them; an entry named camera-to-world is inverted. The unit is not stored.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import yaml

from studiorecon.calibration.formats.reading import CalibrationFormat, Reading
from studiorecon.camera_files.lens_kinds import lens_model
from studiorecon.camera_files.raw_camera import (
    Pose,
    RawCamera,
    camera_from_world_of_pose,
    camera_from_world_of_rows,
    raw_camera,
    rigid_camera_from_world,
)
from studiorecon.errors import UserError
from studiorecon.scene.user_files import file_size, read_bytes, read_xml, read_yaml
from studiorecon.scene.user_values import short_text

_SUFFIXES = (".xml", ".yml", ".yaml", ".json")
# Spellings without case and separators, by their meaning.
_SPELLINGS = {
    "matrix": (
        "cameramatrix", "k", "intrinsic", "intrinsics", "intrinsicmatrix", "intrinsicmat", "cameraintrinsics", "mtx",
    ),
    "distortion": (
        "distortioncoefficients", "distortioncoeffs", "distortioncoeff", "distcoeffs", "distcoef", "dist", "d",
        "distortion", "distortions", "distortionvector",
    ),
    "rotation": ("rotation", "rotationmatrix", "rotationvector", "r", "rot", "rvec", "rvecs", "rmat"),
    "translation": ("translation", "translationvector", "t", "tvec", "tvecs", "trans"),
    "camera_from_world": (
        "extrinsic", "extrinsics", "extrinsicmatrix", "extrinsicparameters", "rt", "w2c", "worldtocamera",
        "camerafromworld", "worldtocam", "pose",
    ),
    "world_from_camera": ("c2w", "cameratoworld", "worldfromcamera", "camtoworld", "camerapose"),
    "size": ("imagesize", "size", "resolution", "imageresolution"),
    "width": ("imagewidth", "width", "w"),
    "height": ("imageheight", "height", "h"),
}  # fmt: skip
_KIND = {spelling: kind for kind, spellings in _SPELLINGS.items() for spelling in spellings}
# A camera has a few hundred bytes; JSON files of keypoints have many more.
_MAX_BYTES = 2**20
_WORD = re.compile(r"[^a-z0-9]")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?|[-+]?\.?(inf|nan)", re.ASCII | re.IGNORECASE)


class _Loader(yaml.BaseLoader):
    """All scalars stay text, so that the camera name 00 is not the number 0."""


def _matrix(loader: yaml.Loader, node: yaml.Node) -> np.ndarray:
    return _array(loader.construct_mapping(node, deep=True))


def _array(entries: Mapping[str, Any]) -> np.ndarray:
    return np.array([float(v) for v in entries["data"]]).reshape(int(entries["rows"]), int(entries["cols"]))


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def load_storage(path: Path) -> dict[str, Any]:
    """The entries of a FileStorage: matrices as arrays, tables as tables, all others as text.

    Raises UserError for another file, and for a duplicate entry.
    """
    if path.suffix.lower() == ".xml":
        value = _of_xml(read_xml(path), path)
    else:
        # "%YAML:1.0" is OpenCV's own header and not a YAML directive.
        value = read_yaml(path, _Loader, comments="%YAML")
    if not isinstance(value, dict):
        raise UserError(f"{path} holds no camera matrices")
    return value


def _of_xml(element: Element, path: Path) -> Any:
    if element.get("type_id") == "opencv-matrix":
        parts = {child.tag: (child.text or "").split() for child in element}
        return _array({"rows": parts["rows"][0], "cols": parts["cols"][0], "data": parts["data"]})
    if not len(element):
        text = (element.text or "").strip()
        return text.split() if " " in text else text
    tags = [child.tag for child in element]
    if twice := next((tag for tag in tags if tags.count(tag) > 1), None):
        if set(tags) == {"_"}:
            return [_of_xml(child, path) for child in element]
        raise UserError(f"{path} has the entry {twice} twice; keep one")
    return {child.tag: _of_xml(child, path) for child in element}


def _sorted(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A table's entries by kind; raises UserError for two spellings of one kind with different values."""
    found: dict[str, tuple[str, Any]] = {}
    for key, value in table.items():
        kind = _KIND.get(_WORD.sub("", str(key).lower()))
        if kind is None or value is None or (isinstance(value, str) and not value):
            continue
        if kind in found and not _same(found[kind][1], value):
            raise UserError(f"{where} has both {found[kind][0]} and {key}, which differ; keep one")
        found.setdefault(kind, (key, value))
    return {kind: value for kind, (_, value) in found.items()}


def _same(one: Any, two: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray) and {one.size, two.size} == {3, 9}:
        first, second = (rigid_camera_from_world(rotation, [0, 0, 0], "")[0] for rotation in (one, two))
        return bool(np.abs(first - second).max() < 1e-3)
    return str(one) == str(two)


def plain_numbers(value: Any) -> Any:
    """Lists of text as numbers where they are, and a table of rows, cols and data (ROS's matrices) as an array."""
    if isinstance(value, Mapping) and {"rows", "cols", "data"} <= value.keys():
        return _array(value)
    if isinstance(value, (list, tuple)):
        return [plain_numbers(v) for v in value]
    return float(value) if isinstance(value, str) and _NUMBER.fullmatch(value.strip()) else value


def camera_tables(path: Path) -> dict[str, Mapping[str, Any]]:
    """camera → its table: the file itself, named after the file, or the tables of several cameras in it."""
    content = load_storage(path)
    several = {k: v for k, v in content.items() if isinstance(v, Mapping) and "matrix" in _kinds(v)}
    return several if several and "matrix" not in _kinds(content) else {path.name.rsplit(".", 1)[0]: content}


def _kinds(table: Mapping[str, Any]) -> set[str]:
    """The kinds of a table's entries; nested tables are ignored, except for ROS's matrices."""
    plain = [key for key, value in table.items() if not isinstance(value, Mapping) or "data" in value]
    return {kind for key in plain if (kind := _KIND.get(_WORD.sub("", str(key).lower())))}


def read_camera(name: str, table: Mapping[str, Any], where: str) -> RawCamera:
    """One camera; its pose is the identity where the table has none. Raises UserError for a table that is no camera."""
    held = {kind: plain_numbers(value) for kind, value in _sorted(table, where).items()}
    if "matrix" not in held:
        raise UserError(f"{where} has no camera matrix; it has {short_text(', '.join(map(str, table)))}")
    wh = held.get("size", [held.get("width", 0), held.get("height", 0)])
    pose = _pose(held, where) if _posed(set(held)) else (np.eye(4), 1.0)
    return raw_camera(name, where, wh, held["matrix"], pose, held.get("distortion"), lens_model(table, where))


def _posed(kinds: set[str]) -> bool:
    return {"rotation", "translation"} <= kinds or bool({"camera_from_world", "world_from_camera"} & kinds)


def _pose(held: Mapping[str, Any], where: str) -> Pose:
    if "rotation" in held and "translation" in held:
        return rigid_camera_from_world(held["rotation"], held["translation"], where)
    if "camera_from_world" in held:
        return camera_from_world_of_rows(held["camera_from_world"], where)
    return camera_from_world_of_pose(held["world_from_camera"], where)


def file_kind(path: Path) -> str:
    """``"cameras"`` with poses, ``"lenses"`` without, or ``""``: the kind of a file, by the names of its entries."""
    if path.suffix.lower() not in _SUFFIXES or file_size(path) > _MAX_BYTES:
        return ""
    text = read_bytes(path).decode("utf-8", errors="replace")
    if not any(_KIND.get(w) == "matrix" for w in _words(text)):
        return ""
    try:
        kinds = [_kinds(table) for table in camera_tables(path).values()]
    except (UserError, KeyError, ValueError, TypeError, IndexError):
        return ""
    if not all("matrix" in of for of in kinds):
        return ""
    return "cameras" if all(map(_posed, kinds)) else "lenses" if not any(map(_posed, kinds)) else ""


def _words(text: str) -> set[str]:
    return {_WORD.sub("", word.lower()) for word in re.findall(r"[\w ]+", text)}


def recognises(files: list[Path]) -> bool:
    return bool(files) and all(f.suffix.lower() in _SUFFIXES and file_kind(f) == "cameras" for f in files)


def read(files: list[Path]) -> Reading:
    """The cameras of all files, named after the file or, with several in one, after their tables."""
    cameras = []
    for path in files:
        cameras += [read_camera(name, table, f"camera {name} in {path}") for name, table in camera_tables(path).items()]
    return Reading("OpenCV FileStorage", tuple(cameras), "unknown", ())


FORMAT = CalibrationFormat(
    "opencv",
    "OpenCV's FileStorage",
    "`*.xml`, `*.yml` or `*.json`, one per camera",
    tuple((f"{folder}*{suffix}",) for folder in ("", "calibration/", "cameras/") for suffix in _SUFFIXES),
    recognises,
    read,
    holds_cameras=lambda path: file_kind(path) == "cameras",
    file_per_camera=True,
)
