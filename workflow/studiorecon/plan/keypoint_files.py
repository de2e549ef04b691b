# SPDX-License-Identifier: Apache-2.0
"""The folder of a capture that holds recorded 2D keypoints, and the camera of each entry."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.keypoints.readers import REFUSED
from studiorecon.plan.inventory import LIKE_KEYPOINTS
from studiorecon.plan.pairing import files_by_camera
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.names import fold_name

# A folder ("") or a file with such a suffix, likelier ones first.
_KEYPOINTS = ("", ".json", ".csv", ".npz", *REFUSED)
# Folders of 2D keypoints, in order of precedence; a folder of another name counts if it is the only one.
_KEYPOINT_FOLDERS = ("keypoints", "pose", "openpose", "annots")
_NOT_LIKE_KEYPOINTS = re.compile(r"3d|calib")


def keypoint_files(folder: Path, named: str | None, cameras: Sequence[str]) -> tuple[dict[str, Path], list[str]]:
    """camera → its recorded keypoints, and sentences about the choice among folders that may hold them.

    The folder ``named`` in capture.yaml takes precedence, then the first usual one, then the only folder whose name
    mentions poses or keypoints and whose entries carry the cameras' names.
    """
    if named is not None:
        return files_by_camera(folder, named, True, cameras, _KEYPOINTS), []
    usual = next((name for name in _KEYPOINT_FOLDERS if (folder / name).is_dir()), None)
    if usual is not None:
        return files_by_camera(folder, usual, False, cameras, _KEYPOINTS), []
    held = {
        path.relative_to(folder).as_posix(): entries
        for path in sorted([*folder.glob("*"), *folder.glob("*/*")])
        if path.is_dir()
        and LIKE_KEYPOINTS.search(fold_name(path.name))
        and not _NOT_LIKE_KEYPOINTS.search(fold_name(path.relative_to(folder).as_posix()))
        and (entries := files_by_camera(folder, path.relative_to(folder).as_posix(), False, cameras, _KEYPOINTS))
    }
    if len(held) == 1:
        name, entries = next(iter(held.items()))
        return entries, [f"keypoints are taken from {name}/"]
    if held:
        return {}, [
            f"{' and '.join(f'{name}/' for name in held)} may each hold keypoints, and none is used; choose one in "
            f"capture.yaml: keypoints: {next(iter(held))}"
        ]
    return {}, []


def keypoints_of_chapters(dataset: Dataset) -> dict[str, tuple[Path, ...]]:
    """camera → its keypoints by chapter, where every chapter has its own; UserError where only some have."""
    found = {}
    for camera, parts in dataset.chapters.items():
        if camera not in dataset.keypoints:
            continue
        place = dataset.keypoints[camera].parent.relative_to(dataset.folder).as_posix()
        entries = files_by_camera(dataset.folder, place, False, [part.stem for part in parts], _KEYPOINTS)
        if len(entries) == len(parts):
            found[camera] = tuple(entries[part.stem] for part in parts)
        elif len(entries) > 1:
            lacking = next(part.stem for part in parts if part.stem not in entries)
            raise UserError(
                f"{dataset.folder / place} has keypoints of {len(entries)} of the {len(parts)} chapters of camera "
                f"{camera}, and none of {lacking}; bring those too, or one file of the whole recording"
            )
    return found
