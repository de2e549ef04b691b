# SPDX-License-Identifier: Apache-2.0
"""Calibration files of every format: damaged, they lead to a sentence; made again as it advises, they are read."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.calibration.files import read_calibration
from studiorecon.calibration.formats.opencv_storage import load_storage
from studiorecon.calibration.names import pairings_in_order
from studiorecon.plan.discovery import find_calibration

from tests.calibration import test_calibration_formats as research
from tests.calibration.test_calibration_alicevision import write_sfm
from tests.calibration.test_calibration_colmap import rig_model
from tests.calibration.test_calibration_kinds import SPELLINGS, storage, transforms
from tests.calibration.test_calibration_laboratory import (
    planted,
    write_biocv,
    write_opencap,
    write_optitrack,
    write_vicon,
)
from tests.calibration.test_calibration_traps import write_calibration
from tests.made.cameras import ring
from tests.made.cameras_parts import write_toml
from tests.made.remedies import follow

Make = Callable[[Path], Any]
FORMATS = "calibration/formats"


def qualisys(folder: Path) -> None:
    lines = []
    for camera in ring():
        turn = (camera.world_from_camera[:3, :3] * [1, -1, -1]).T
        axes = " ".join(f'r{i + 1}{j + 1}="{turn[i, j]:.17g}"' for i in range(3) for j in range(3))
        place = " ".join(f'{axis}="{1000 * v:.17g}"' for axis, v in zip("xyz", camera.centre_m))
        lines.append(
            f'<camera active="1" serial="{camera.name}" viewrotation="0"><fov_video left="0" top="0" right="1279" '
            f'bottom="703"/><transform {place} {axes}/><intrinsic focalLengthU="64000" focalLengthV="64000" '
            'centerPointU="41000" centerPointV="22500"/></camera>'
        )
    (folder / "a.qca.txt").write_text(f"<calibration><cameras>{''.join(lines)}</cameras></calibration>")


def colmap(folder: Path, suffix: str) -> None:
    made = rig_model(ring())
    made.write_binary(str(folder)) if suffix == ".bin" else made.write_text(str(folder))


def pair(folder: Path) -> None:
    write_calibration(folder, ring())


MAKE: dict[str, Make] = {
    "vicon": lambda f: write_vicon(f, planted()),
    "optitrack": lambda f: write_optitrack(f, planted()),
    "opencap": lambda f: write_opencap(f, planted()),
    "biocv": lambda f: write_biocv(f, planted()),
    "qualisys": qualisys,
    "egohumans": lambda f: research.write_egohumans(f, research.named_ring()),
    "harmony": lambda f: research.write_egohumans(f, research.named_ring(), harmony=True),
    "dynamic": lambda f: research.write_dynamic(f, research.named_ring()),
    "egoexo": lambda f: research.write_egoexo(f, research.named_ring()),
    "llff": lambda f: research.write_llff(f, research.named_ring()),
    "zju": lambda f: research.write_zju(f, research.named_ring()),
    "sfm": lambda f: write_sfm(f, ring()),
    "transforms": lambda f: transforms(f, {}),
    "xml": lambda f: storage(f, SPELLINGS[0], ".xml"),
    "yaml": lambda f: storage(f, SPELLINGS[0], ".yml"),
    "easymocap": pair,
    "colmap": lambda f: colmap(f, ".txt"),
    "toml": lambda f: write_toml(f, ring()),
    "binary": lambda f: colmap(f, ".bin"),
}


def text(pattern: str, instead: str, file: str = "*") -> Make:
    """Replaces the first match of a pattern in the first file that is so called."""

    def change(folder: Path) -> None:
        path = sorted(p for p in folder.rglob(file) if p.is_file())[0]
        encoding = "utf-16" if path.suffix == ".mcal" else "utf-8"
        old = path.read_bytes().decode(encoding)
        new = re.sub(pattern, instead, old, count=1, flags=re.DOTALL)
        assert new != old
        path.write_bytes(new.encode(encoding))

    return change


def entries(change: Callable[[Any], Any], file: str = "*.json") -> Make:
    def changed(folder: Path) -> None:
        path = next(folder.rglob(file))
        value = json.loads(path.read_text()) if file != "*.pickle" else pickle.loads(path.read_bytes())
        value = value if (found := change(value)) is None else found
        path.write_text(json.dumps(value)) if file != "*.pickle" else path.write_bytes(pickle.dumps(value))

    return changed


def array(file: str, value: Any) -> Make:
    return lambda f: np.save(f / file, value)


def pickled(file: str, value: Any) -> Make:
    return lambda f: (f / file).write_bytes(pickle.dumps(value))


def of_first(**changed: Any) -> Make:
    """Entries of the first picture of a transforms.json; None takes one out."""

    def change(value: dict[str, Any]) -> None:
        frame = value["frames"][0]
        frame |= changed
        for key in [key for key, new in changed.items() if new is None]:
            del frame[key]

    return entries(change)


def cut(file: str, share: float) -> Make:
    return lambda f: (f / file).write_bytes((f / file).read_bytes()[: int(share * (f / file).stat().st_size)])


def moving(value: dict[str, Any], camera: int = 1, by: float = 1.0) -> None:
    value["w2c"][2][camera][0][3] += by


def all_moving(value: dict[str, Any]) -> None:
    for camera in range(4):
        moving(value, camera)


SKEWED = [[1.0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
NAN = [[float("nan")] * 4] * 4
GLASSES = "colmap_from_aria_transforms.pkl"
# Where it is said, the format, and the damage: the advice is another file, made again.
ROWS: list[tuple[str, str, Make]] = [
    (f"{FORMATS}/vicon.py _camera 1", "vicon", text('PIXEL_ASPECT_RATIO="1"', 'PIXEL_ASPECT_RATIO="1.09"')),
    (f"{FORMATS}/vicon.py _camera 2", "vicon", text('ORIENTATION="[^"]*"', 'ORIENTATION="0 0 0 0"')),
    (f"{FORMATS}/vicon.py _camera 3", "vicon", text("Vicon3Parameter", "Vicon9")),
    (f"{FORMATS}/vicon.py _camera 4", "vicon", text('FOCAL_LENGTH="[^"]*"', 'FOCAL_LENGTH="-1"')),
    (f"{FORMATS}/vicon.py _camera 5", "vicon", text('VICON_RADIAL2="[^"]*"', 'VICON_RADIAL="-2e-6 0"')),
    (f"{FORMATS}/reading.py number_attributes", "qualisys", text('centerPointU="41000"', 'centerPointU="x"')),
    (f"{FORMATS}/reading.py attribute", "vicon", text('POSITION="[^"]*"', "")),
    (f"{FORMATS}/vicon.py _numbers", "vicon", text('POSITION="[^"]*"', 'POSITION="1 2"')),
    (f"{FORMATS}/optitrack.py read", "optitrack",
     lambda f: (f / "room.mcal").rename(f / "room.cal").write_bytes(b"\0a")),
    (f"{FORMATS}/optitrack.py _camera", "optitrack", text("<Attributes[^>]*>", "")),
    (f"{FORMATS}/reading.py attribute", "optitrack", text("OrientMatrix0", "Other")),
    (f"{FORMATS}/opencap.py _camera 1", "opencap", entries(lambda v: [1], "*.pickle")),
    (f"{FORMATS}/opencap.py _camera 2", "opencap",
     entries(lambda v: {k: x for k, x in v.items() if k != "rotation"}, "*.pickle")),
    ("camera_files/raw_camera.py raw_camera 1", "opencap",
     entries(lambda v: v | {"imageSize": np.ones(3)}, "*.pickle")),
    (f"{FORMATS}/biocv.py _camera 1", "biocv", text(r"^1280", "wide")),
    (f"{FORMATS}/biocv.py _camera 2", "biocv", text(r"^1280\n", "")),
    (f"{FORMATS}/qualisys.py read 1", "qualisys", text('viewrotation="0"', 'viewrotation="90"')),
    (f"{FORMATS}/qualisys.py read 2", "qualisys", text("<transform[^>]*>", "")),
    (f"{FORMATS}/reading.py attribute", "qualisys", text('focalLengthU="[^"]*"', "")),
    (f"{FORMATS}/egohumans.py _similarity 1", "harmony", array("scale.npy", np.eye(3))),
    (f"{FORMATS}/egohumans.py _similarity 2", "egohumans", pickled(GLASSES, [1])),
    (f"{FORMATS}/egohumans.py _similarity 3", "egohumans", pickled(GLASSES, {"aria03": np.eye(4)})),
    (f"{FORMATS}/pickles.py read_pickle", "egohumans", cut(GLASSES, 0.5)),
    (f"{FORMATS}/train_meta.py read 1", "dynamic", entries(lambda v: {k: x for k, x in v.items() if k != "w2c"})),
    (f"{FORMATS}/reading.py merged_static", "dynamic",
     entries(all_moving)),
    ("scene/user_values.py numbers 3", "dynamic", entries(lambda v: moving(v, 0, np.nan))),
    ("scene/user_files.py user_file_context 1", "sfm", text('"principalPoint"', '"other"')),
    ("scene/user_files.py user_file_context 2", "sfm", entries(lambda v: v | {"views": 5}, "*.sfm")),
    (f"{FORMATS}/train_meta.py read 2", "dynamic", entries(lambda v: v.pop("fn") and moving(v))),
    (f"{FORMATS}/egoexo.py _camera 1", "egoexo", text(",1280,", ",wide,")),
    (f"{FORMATS}/egoexo.py _camera 2", "egoexo",
     text(r"(\n[^,]*,[^,]*,[^,]*,[^,]*,[^,]*,[^,]*,)[^,]*,[^,]*,[^,]*,[^,]*,", r"\g<1>0,0,0,0,")),
    (f"{FORMATS}/llff.py read", "llff", array("poses_bounds.npy", np.ones((2, 16)))),
    ("camera_files/raw_camera.py raw_camera 1", "llff",
     lambda f: np.save(f / "poses_bounds.npy", np.load(f / "poses_bounds.npy") + 0.25 * (np.arange(17) == 9))),
    (f"{FORMATS}/zju.py read", "zju", array("annots.npy", np.array({"cams": {}}, object))),
    (f"{FORMATS}/alicevision.py read", "sfm", text('"viewId"', '"rigId": "7", "viewId"')),
    (f"{FORMATS}/alicevision.py _camera", "sfm", text('"pinhole"', '"3deradial4"')),
    ("scene/user_files.py read_json 1", "sfm", cut("cameras.sfm", 0.5)),
    ("scene/user_files.py read_json 3", "sfm", text('"viewId"', '"viewId": 1, "viewId"')),
    ("scene/user_files.py read_json 2", "sfm", lambda f: (f / "cameras.sfm").write_text("[" * 10**5)),
    ("scene/user_files.py read_xml 1", "xml", text("<opencv_storage>", "<!DOCTYPE a><opencv_storage>", "c0.xml")),
    ("scene/user_files.py read_xml 2", "qualisys", cut("a.qca.txt", 0.5)),
    (f"{FORMATS}/opencv_storage.py _of_xml", "xml", text("(<image_width>.*?</image_width>)", r"\1\1", "c0.xml")),
    (f"{FORMATS}/opencv_storage.py _sorted", "yaml", text("CameraMatrix", "K: 3\nCameraMatrix", "c0.yml")),
    ("camera_files/raw_camera.py pose_rows 1", "yaml",
     text("Rotation:.*", "pose: [1, 0, 0]\n", "c0.yml")),
    (f"{FORMATS}/easymocap.py read 1", "easymocap", text('   - "c0"\n', '   - "x"\n   - "c0"\n', "intri.yml")),
    (f"{FORMATS}/easymocap.py read 2", "easymocap",
     text(r"\Z", "R_c0: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [1, 1, 1]\n", "extri.yml")),
    ("scene/user_values.py numbers 2", "easymocap", text("T_c0: ", "T_c0: 5\nT_other: ", "extri.yml")),
    ("scene/user_values.py numbers 2", "easymocap", text("K_c0: ", "W_c0: wide\nH_c0: 9\nK_c0: ", "intri.yml")),
    (f"{FORMATS}/easymocap.py _required", "easymocap", text("T_c0", "other", "extri.yml")),
    (f"{FORMATS}/nerfstudio.py read", "transforms", of_first(file_path=None)),
    ("camera_files/transforms_json.py read_transforms", "transforms", entries(lambda v: v | {"frames": []})),
    ("camera_files/transforms_json.py _camera 1", "transforms", of_first(file_path=3)),
    ("camera_files/transforms_json.py _camera 2", "transforms", of_first(transform_matrix=None)),
    ("camera_files/raw_camera.py pose_rows 1", "transforms", of_first(transform_matrix=[[1.0]])),
    ("scene/user_values.py numbers 3", "transforms", of_first(transform_matrix=NAN)),
    ("camera_files/raw_camera.py raw_camera 1", "transforms", of_first(w=1280.5)),
    ("camera_files/transforms_json.py _camera 4", "transforms", of_first(is_fisheye=True, p1=0.1)),
    ("camera_files/transforms_json.py _camera 3", "transforms", of_first(K1=0.1)),
    ("camera_files/raw_camera.py pose_rows 2", "transforms", of_first(transform_matrix=[*SKEWED[:3], [0, 0, 0, 2]])),
    ("camera_files/raw_camera.py rigid_camera_from_world 5", "transforms", of_first(transform_matrix=SKEWED)),
    ("camera_files/colmap_models.py _read 2", "colmap", cut("cameras.txt", 0.2)),
    ("camera_files/colmap_models.py _read 3", "binary", cut("cameras.bin", 0.9)),
    ("calibration/files.py read_calibration 3", "qualisys", lambda f: (f / "a.qca.txt").write_text("<calibration/>")),
    ("scene/user_files.py read_toml", "toml", lambda f: (f / "Calib.toml").write_text("[a\n")),
]  # fmt: skip


def read(folder: Path, damage: Make | None, form: str) -> None:
    folder.mkdir()
    listed = MAKE[form](folder)
    if damage is not None:
        damage(folder)
    found = listed if form in ("egohumans", "harmony", "toml") else find_calibration(folder)
    found = found or tuple(folder.glob("*.bin"))
    assert len(read_calibration(found).cameras) > 1


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {place}" for n, (place, *_) in enumerate(ROWS)])
def test_a_calibration_made_again_as_advised_is_read(row: int, tmp_path: Path) -> None:
    place, form, damage = ROWS[row]
    follow(place, lambda: read(tmp_path / "brought", damage, form), lambda: read(tmp_path / "advised", None, form))


def no_table(folder: Path) -> None:
    (folder / "a.yml").write_text("- 1")
    load_storage(folder / "a.yml")


def unknown(folder: Path) -> None:
    (folder / "a.toml").write_text("a = 1\n")
    read_calibration([folder / "a.toml"])


CALLS: dict[str, tuple[Make, Make]] = {
    "calibration/files.py read_calibration 1": (lambda f: read_calibration([]), lambda f: read(f / "x", None, "sfm")),
    "calibration/files.py read_calibration 2": (lambda f: read_calibration([f / "gone.toml"]),
                                                lambda f: read(f / "x", None, "sfm")),
    "calibration/files.py read_calibration 4": (unknown, lambda f: read(f / "x", None, "transforms")),
    f"{FORMATS}/opencv_storage.py load_storage": (no_table,
                                                  lambda f: read(f / "x", None, "yaml")),
    "calibration/names.py pairings_in_order": (lambda _: pairings_in_order(["a", "b"], 3, "x"),
                                               lambda _: pairings_in_order(["a", "b", "c"], 3, "x")),
}  # fmt: skip


@pytest.mark.parametrize("place", CALLS)
def test_a_calibration_brought_as_advised_is_read(place: str, tmp_path: Path) -> None:
    brought, advised = CALLS[place]
    follow(place, lambda: brought(tmp_path), lambda: advised(tmp_path))
