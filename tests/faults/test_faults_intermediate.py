# SPDX-License-Identifier: Apache-2.0
"""What lies between two steps, damaged since: the next step names the file and says what to do, and no number that is
none gets in."""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.camera_files.calibration import read_lenses
from studiorecon.camera_files.colmap import read_model, write_model
from studiorecon.depth.layout.primitives import Primitive, read_primitives, write_primitives
from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.capture import Footage, Manifest, read_footage, read_manifest, write_footage, write_manifest
from studiorecon.scene.clocks import read_clocks, write_clocks
from studiorecon.scene.factors import read_factors, write_factors
from studiorecon.scene.files import write_json, write_npz
from studiorecon.scene.intermediate import read_arrays
from studiorecon.scene.path import PathStep, read_path, write_path
from studiorecon.scene.people import read_detections
from studiorecon.scene.raw_detections import read_raw_detections
from studiorecon.scene.readouts import Readout, read_readouts, write_readouts
from studiorecon.scene.room import FACES, read_room
from studiorecon.splatting.rigid_object import read_objects

from tests.faults import damage
from tests.made.clocks import as_counted

INTRINSICS = np.array([[500.0, 0, 240], [0, 500, 136], [0, 0, 1]])
CAMERA = Camera("cam1", (480, 272), INTRINSICS, np.eye(4))
LENS = Lens("cam1", (480, 272), INTRINSICS, "opencv", np.zeros(8), np.eye(4), np.eye(2, 3))
FOOTAGE = Footage(
    "cam1",
    False,
    (480, 272),
    INTRINSICS.tolist(),
    30.0,
    60,
    3,
    "videos/cam1.mp4",
    "0" * 64,
    (480, 272),
    0,
    0.1,
    ["cut"],
)
ROOM = {
    "yaw_rad": 0.1,
    "low_m": [0.0, 0.0, 0.0],
    "high_m": [4.0, 5.0, 3.0],
    "gains": {"cam1": [1.0, 1.0, 1.0]},
    "planes": [[0.0, 0.0, 1.0, 0.0]],
    "faces": {name: {"fitted": True, "score": 0.5} for name in FACES},
    "platform": {"low_m": [1.0, 1.0], "high_m": [2.0, 3.0], "top_m": 0.3},
}
PRIMITIVE = Primitive("box", (1.0, 1.0), 0.2, (0.5, 0.5), 0.0, 1.0, 30.0)
DETECTIONS = {
    "camera": "cam1",
    "layout": "coco17",
    "frame": np.arange(3),
    "track": np.zeros(3, int),
    "keypoints": np.ones((3, 17, 3)),
}
FOUND = DETECTIONS | {
    "presence": np.ones(3),
    "points_m": np.ones((3, 17, 3)),
    "mask": np.zeros((3, 4, 4), np.uint8),
    "mask_from_picture": np.zeros((3, 2, 3)),
    "looked": np.array([0, 3]),
    "note": "",
}
THING = {
    "names": np.array(["o0"]),
    "frames": 2,
    "o0.means_m": np.zeros((1, 3), np.float32),
    "o0.sh": np.zeros((1, 1, 3)),
    "o0.quaternions": np.ones((1, 4)),
    "o0.log_scales": np.zeros((1, 3)),
    "o0.logit_opacities": np.zeros(1),
    "o0.provenance": np.zeros(1, np.uint8),
    "o0.centres_m": np.array([[1.0, 2, 3], [math.nan] * 3]),
    "o0.world_from_object": np.zeros((2, 3, 3)),
    "o0.valid": np.array([True, False]),
    "o0.present": np.array([True, False]),
    "o0.radius_m": 0.1,
    "o0.turns": "undetermined",
}


@dataclasses.dataclass(frozen=True)
class Kind:
    """A file between two steps: its name, how it is written and read, and arrays whose gaps mean something."""

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path], Any]
    gaps: tuple[str, ...] = ()


KINDS = {
    "clocks": Kind("clocks.json", lambda p: write_clocks(p, as_counted("cam1", 30.0, 3, 60)), read_clocks),
    "footage": Kind("cam1.json", lambda p: write_footage(p, FOOTAGE), read_footage),
    "manifest": Kind(
        "manifest.json", lambda p: write_manifest(p, Manifest("demo", 30.0, 60, (FOOTAGE,))), read_manifest
    ),
    "path": Kind("path.json", lambda p: write_path(p, [PathStep(CAMERA, 1.5, "01")], 30.0), read_path),
    "factors": Kind("gains.json", lambda p: write_factors(p, {"cam1": np.ones((2, 3))}), lambda p: read_factors([p])),
    "readouts": Kind(
        "readouts.json", lambda p: write_readouts(p, [Readout("cam1", 0.02, 0.001, 0.02, "")]), read_readouts
    ),
    "room": Kind("room.json", lambda p: write_json(p, ROOM), read_room),
    "primitives": Kind("primitives.json", lambda p: write_primitives(p, [PRIMITIVE]), read_primitives),
    "lenses": Kind("calibration.json", lambda p: write_json(p, {"lenses": [LENS.as_json()]}), read_lenses),
    "detections": Kind("cam1.npz", lambda p: write_npz(p, DETECTIONS), read_detections, ("keypoints",)),
    "raw detections": Kind(
        "cam1.npz", lambda p: write_npz(p, FOUND), lambda p: read_raw_detections(p, True), ("keypoints", "points_m")
    ),
    "objects": Kind("objects.npz", lambda p: write_npz(p, THING), read_objects),
}
EVERY = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def told(kind: Kind, path: Path) -> str:
    """What reading ``path`` is refused with; "" when it is not."""
    refusal = ""
    try:
        kind.read(path)
    except UserError as error:
        refusal = str(error)
    assert refusal == "" or path.name in refusal
    assert "\n" not in refusal
    return refusal


@EVERY
def test_the_whole_file_is_read(kind: Kind, tmp_path: Path) -> None:
    kind.write(tmp_path / kind.name)
    assert told(kind, tmp_path / kind.name) == ""


@EVERY
def test_a_missing_or_cut_file_is_named(kind: Kind, tmp_path: Path) -> None:
    path = tmp_path / kind.name
    assert "is missing" in told(kind, path)
    kind.write(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert "delete it, and it is made again" in told(kind, path)


@EVERY
def test_damage_ends_in_a_sentence_or_is_none(kind: Kind, tmp_path: Path) -> None:
    path, rng = tmp_path / kind.name, np.random.default_rng(0)
    kind.write(path)
    whole = path.read_bytes()
    for _ in range(100):
        path.write_bytes(damage.bytes_changed(whole, rng))
        told(kind, path)


def without_a_number(kind: Kind, path: Path) -> Iterator[str]:
    """Writes the file once for every number in it (a hundredth of every array, at least one), which becomes none."""
    kind.write(path)
    if path.suffix == ".npz":
        with np.load(path) as stored:
            arrays = {name: stored[name] for name in stored.files}
        for name, values in arrays.items():
            if values.dtype.kind == "f" and name not in kind.gaps and np.isfinite(values).all():
                flat = values.reshape(-1).copy()
                flat[::100] = np.nan
                write_npz(path, arrays | {name: flat.reshape(values.shape)})
                yield name
        return
    whole = json.loads(path.read_text())
    for place in damage.places(whole):
        copy = json.loads(json.dumps(whole))
        holder = copy
        for key in place[:-1]:
            holder = holder[key]
        if place and isinstance(holder[place[-1]], float) and place[-1] != "score":
            for none in (math.nan, None):
                holder[place[-1]] = none
                path.write_text(json.dumps(copy))
                yield f"{place} {none}"


@EVERY
def test_a_number_that_is_none_is_named(kind: Kind, tmp_path: Path) -> None:
    tried = 0
    for place in without_a_number(kind, tmp_path / kind.name):
        assert re.search("delete it|run [a-z]+", told(kind, tmp_path / kind.name)), place
        tried += 1
    assert tried or kind.name == "cam1.npz"


@pytest.mark.parametrize("file", ["cameras.txt", "images.txt"])
@pytest.mark.parametrize("number", ["nan", "inf", "x"])
def test_cameras_of_a_model_that_are_none_are_named(file: str, number: str, tmp_path: Path) -> None:
    write_model(tmp_path, [CAMERA], np.zeros((0, 3)))
    text = (tmp_path / file).read_text().splitlines()
    at = next(k for k, line in enumerate(text) if line and not line.startswith("#"))
    fields = text[at].split()
    fields[5] = number
    text[at] = " ".join(fields)
    (tmp_path / file).write_text("\n".join(text) + "\n")
    with pytest.raises(UserError, match=rf"{file} is damaged"):
        read_model(tmp_path)


def test_arrays_that_are_not_there_are_named(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz", {"one": np.zeros(3)})
    with pytest.raises(UserError, match=r"a\.npz has no 'two'.*delete it"):
        read_arrays(tmp_path / "a.npz", ["one", "two"])
    assert list(read_arrays(tmp_path / "a.npz", but=("one",))) == []


def test_no_step_opens_arrays_past_the_door() -> None:
    package = Path(__file__).parents[2] / "workflow" / "studiorecon"
    # The two that look whether a file of their own is still good, and otherwise make it again.
    own = {"body/avatar/avatar_files.py", "splatting/train/checkpoint.py"}
    found = set()
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Attribute(value=ast.Name(id="np"), attr="load" | "fromfile"):
                    found.add(path.relative_to(package).as_posix())
    assert found == own
