# SPDX-License-Identifier: Apache-2.0
"""What files hold, as trees of mappings, lists and arrays, and back: what rules of damage need to see."""

from __future__ import annotations

import io
import json
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomllib
import yaml
from studiorecon.footage.exr import write_channels
from studiorecon.footage.frames import decode
from studiorecon.footage.source import open_source
from studiorecon.footage.video import read_stack, write_lossless, write_watchable


@dataclass(frozen=True)
class Form:
    """How a kind of file is taken apart and put together again."""

    taken: Callable[[bytes], Any]
    put: Callable[[Any], bytes]


def _npz(data: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(data)) as stored:
        return {name: stored[name] for name in stored.files}


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def _word(word: str) -> Any:
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def _table(separator: str) -> Form:
    def taken(data: bytes) -> list[list[Any]]:
        return [[_word(word) for word in line.split(separator)] for line in data.decode().split("\n")]

    def put(rows: Any) -> bytes:
        return "\n".join(separator.join(map(str, row)) if isinstance(row, list) else str(row) for row in rows).encode()

    return Form(taken, put)


def _ply(data: bytes) -> dict[str, Any]:
    end = data.index(b"end_header\n") + len(b"end_header\n")
    columns = data[:end].count(b"property")
    return {"header": data[:end].decode(), "rows": np.frombuffer(data[end:], "<f4").reshape(-1, columns)}


def _through(suffix: str, write: Callable[[Path, Any], object], read: Callable[[Path], Any]) -> Form:
    """A form of which the package's own writer and a reader are known by path only."""

    def in_file(use: Callable[[Path], Any], data: bytes | None = None) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"file{suffix}"
            if data is not None:
                path.write_bytes(data)
            return use(path)

    def written(path: Path, tree: Any) -> bytes:
        write(path, tree)
        return path.read_bytes()

    return Form(lambda data: in_file(read, data), lambda tree: in_file(lambda path: written(path, tree)))


def _encoded(pixels: np.ndarray) -> bytes:
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3):
        raise ValueError("OpenCV would write something else")
    return cv2.imencode(".png", pixels)[1].tobytes()


def _read_exr(path: Path) -> dict[str, np.ndarray]:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


class _OpenCv(yaml.SafeLoader):
    """YAML as OpenCV's FileStorage writes it."""


_OpenCv.add_constructor(
    "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
)


def _opencv_yaml(tree: Any) -> bytes:
    lines = ["%YAML:1.0", "---"]
    for key, value in tree.items():
        text = yaml.safe_dump(value, default_flow_style=None, width=10**6).rstrip("\n").removesuffix("\n...")
        matrix = isinstance(value, dict) and "data" in value
        indented = "\n".join(f"  {line}" for line in text.split("\n"))
        lines.append(f"{key}: !!opencv-matrix\n{indented}" if matrix else f"{key}:\n{indented}")
    return "\n".join([*lines, ""]).encode()


def _toml(tree: Any) -> bytes:
    lines: list[str] = []
    for name, table in tree.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join(lines).encode()


def _element(element: ElementTree.Element) -> dict[str, Any]:
    """Attributes as ``@name``, elements below as ``place name``, text as ``#``."""
    found: dict[str, Any] = {
        f"@{key}": value if key.lower() in ("serial", "deviceid") else _words(value)
        for key, value in element.attrib.items()
    }
    found |= {f"{place} {below.tag}": _element(below) for place, below in enumerate(element)}
    return found | ({"#": element.text} if (element.text or "").strip() else {})


def _words(text: str) -> Any:
    words = [float(word) if isinstance(_word(word), int) else _word(word) for word in text.split()]
    return words if len(words) > 1 else words[0] if words else text


def _xml(tree: Any, name: str) -> ElementTree.Element:
    made = ElementTree.Element(name)
    for key, value in tree.items():
        if key == "#":
            made.text = str(value)
        elif key.startswith("@"):
            made.set(key[1:], " ".join(map(str, value)) if isinstance(value, list) else str(value))
        elif isinstance(value, dict):
            made.append(_xml(value, key.split()[-1]))
    return made


def _xml_form(encoding: str) -> Form:
    def taken(data: bytes) -> Any:
        root = ElementTree.fromstring(data)
        return {f"0 {root.tag}": _element(root)}

    def put(tree: Any) -> bytes:
        ((name, root),) = tree.items()
        return ElementTree.tostring(_xml(root, name.split()[-1]), encoding, xml_declaration=True)

    return Form(taken, put)


def _read_film(path: Path) -> dict[str, Any]:
    source = open_source(path, 30.0)
    return {"frames": np.array(list(decode(source, 0, 0))), "fps": source.fps}


FORMS = {
    ".json": Form(json.loads, lambda tree: json.dumps(tree, indent=1).encode()),
    ".yaml": Form(yaml.safe_load, lambda tree: yaml.safe_dump(tree).encode()),
    ".npz": Form(_npz, lambda tree: npz(**tree)),
    ".npy": Form(lambda data: {"array": np.load(io.BytesIO(data))}, lambda tree: npy(tree["array"])),
    ".tsv": _table("\t"),
    ".csv": _table(","),
    ".txt": _table(" "),
    ".calib": _table(" "),
    ".yml": Form(lambda data: yaml.load(data.split(b"---", 1)[1], _OpenCv), _opencv_yaml),
    ".toml": Form(lambda data: tomllib.loads(data.decode()), _toml),
    ".xcp": _xml_form("utf-8"),
    ".mcal": _xml_form("utf-16"),
    ".qca.txt": _xml_form("utf-8"),
    ".mp4": _through(".mp4", lambda path, tree: write_watchable(path, tree["frames"], tree["fps"]), _read_film),
    ".ply": Form(_ply, lambda tree: tree["header"].encode() + np.asarray(tree["rows"], "<f4").tobytes()),
    ".png": Form(
        lambda data: {"pixels": cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)},
        lambda tree: _encoded(tree["pixels"]),
    ),
    ".exr": _through(".exr", write_channels, _read_exr),
    ".mkv": _through(
        ".mkv", lambda path, tree: write_lossless(path, iter(tree["frames"]), 30.0), lambda p: {"frames": read_stack(p)}
    ),
}
"""By the file's ending; what is not here is damaged as bytes alone."""
