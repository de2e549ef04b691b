# SPDX-License-Identifier: Apache-2.0
"""What lies between two steps is opened by the reader of its noun, and by nothing else."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.made.sources import tree

PACKAGE = Path(__file__).resolve().parents[2] / "workflow" / "studiorecon"
OPENERS = {
    "np.load", "np.fromfile", "np.loadtxt", "np.genfromtxt", "json.load", "yaml.load", "cv2.imread",
    "cv2.VideoCapture", "OpenEXR.File", "av.open", "zipfile.ZipFile", "read_bytes", "read_text", "open",
    "np.memmap", "yaml.safe_load", "cv2.FileStorage", "torch.load", "pickle.load", "tomllib.load",
    "ElementTree.parse", "cv2.imreadmulti",
}  # fmt: skip
DOORS = {"read_json", "read_yaml", "read_toml", "read_xml", "read_rows", "read_table", "read_npz", "read_npy"}
READERS = {
    "scene": "nouns and the doors themselves",
    "footage": "films, plates and depth",
    "camera_files": "cameras",
    "body/avatar/avatar_files.py": "also looks whether a killed run's file is still good, and makes it again if not",
    "splatting/train/checkpoint.py": "the same of checkpoints, which no other step reads",
}
NO_NOUN = {
    "calibration/formats": "calibrations of users",
    "board": "boards of users",
    "keypoints": "keypoints of users",
    "models": "weights of networks",
    "plan": "datasets, presets and what the workflow keeps for itself",
    "configuration": "settings",
    "cli": "what runs keep for themselves",
    "window": "what its runs keep for themselves, settings, and results that it shows as they are",
    "machine": "locks and caches",
    "sweep": "records of its own, and tables of users",
    "studio": "descriptions of studios",
    "report/sections": "tables that come with the project, logs and times of Snakemake",
    "pages": "templates that come with the project",
    "report/metrics/folders.py": "pictures and films of users",
    "detector/network_files.py": "the confidence table that comes with the detector",
    "depth/estimates.py": "depth of users and networks",
    "tracks/bodies.py": "bodies of networks that ran elsewhere",
    "body/model.py": "body models of users",
    "deliver": "finished files that are packed as they are",
    "code.py": "the program's own files",
    "__main__.py": "a configuration file given by hand",
}


def called(node: ast.AST) -> str:
    """``np.load``, ``open`` or the last word of what is called, as ``OPENERS`` has it; empty for another node."""
    if not isinstance(node, ast.Call):
        return ""
    name = ast.unparse(node.func)
    return name if name in OPENERS | DOORS else name.rsplit(".", 1)[-1]


def opened(path: Path) -> set[str]:
    return {name for node in ast.walk(tree(path)) if (name := called(node)) in OPENERS | DOORS}


def within(path: Path, places: dict[str, str]) -> set[str]:
    name = path.relative_to(PACKAGE).as_posix()
    return {place for place in places if name == place or name.startswith(f"{place}/")}


def test_no_step_opens_what_lies_between_steps_but_by_its_reader() -> None:
    places = READERS | NO_NOUN
    opening = {path: names for path in sorted(PACKAGE.rglob("*.py")) if (names := opened(path))}
    past = {str(path.relative_to(PACKAGE)): names for path, names in opening.items() if not within(path, places)}
    assert not past, "read it with scene.step_files.read and a schema"
    used = {place for path in opening for place in within(path, places)}
    assert used == set(places), "what opens nothing needs no excuse"


def test_a_file_between_steps_is_read_by_its_schema() -> None:
    """No reader takes any mapping, or anything at all, for a whole file."""
    untyped = {
        path.relative_to(PACKAGE).as_posix()
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(tree(path))
        for schema in (node.args if called(node) == "read" else [getattr(node, "value", None)])
        if isinstance(schema, ast.Call) and re.fullmatch(r"(\w+\()?Anything\(\)+", ast.unparse(schema))
    }
    assert not untyped
