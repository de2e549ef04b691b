# SPDX-License-Identifier: Apache-2.0
"""Assigns files and folders to cameras by their names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.footage.kinds import film_suffixes
from studiorecon.scene.names import fold_name, is_system_file

# Suffixes that programs for keypoints and masks append to the name of a film.
_TAIL = "(?:_json|_ext|_keypoints|_pose|dlc_.*)"


def camera_stem(path: Path) -> str:
    """The name without its suffix and without the suffix of a film before it (``cam1.mp4.json``); other dots stay."""
    stem = path.name if path.is_dir() else path.stem
    return Path(stem).stem if Path(stem).suffix.lower() in film_suffixes() else stem


def _holds(name: str, word: str) -> bool:
    return re.search(rf"(?<![^\W_]){re.escape(fold_name(word))}(?![^\W_])", fold_name(name)) is not None


def _words(name: str) -> tuple[str, ...]:
    """The words and numbers of a name, the latter without leading zeros: those of cam01 and Cam_1 are the same."""
    return tuple(word.lstrip("0") or "0" for word in re.findall(r"\d+|[^\W\d_]+", fold_name(name)))


def _have_same_number(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether all words of one name, a number among them, are in the other: 2 and cam2."""
    fewer, more = sorted((set(one), set(other)), key=len)
    return fewer <= more and any(word.isdigit() for word in fewer)


def _longer(pair: tuple[str, str], other: tuple[str, str]) -> bool:
    """Whether both pairs share one name, and the other name of ``other`` is longer and contains that of ``pair``."""
    return any(
        pair[k] == other[k] and _holds(pair[k], other[1 - k]) and _holds(other[1 - k], pair[1 - k])
        for k in (0, 1)
        if fold_name(pair[1 - k]) != fold_name(other[1 - k])
    )


# Strongest first: a weaker rule applies only to entries that stronger ones leave.
_RULES: tuple[Callable[[str, str], bool], ...] = (
    lambda camera, entry: camera == entry,
    lambda camera, entry: fold_name(camera) == fold_name(entry),
    lambda camera, entry: _words(camera) == _words(entry),
    lambda camera, entry: re.fullmatch(re.escape(fold_name(camera)) + _TAIL, fold_name(entry)) is not None,
    lambda camera, entry: _holds(entry, camera) or _holds(camera, entry),
    lambda camera, entry: _have_same_number(_words(camera), _words(entry)),
)


def pair_by_name(cameras: Sequence[str], entries: Iterable[Path]) -> dict[str, Path]:
    """camera → the entry that its name selects; of several entries of one name the first.

    A weaker match (one name contains the other as a whole word, or they differ in case, Unicode form, separators or
    leading zeros) counts only where exactly one camera and one entry fit.
    """
    left = {entry: camera_stem(entry) for entry in entries}
    found: dict[str, Path] = {}
    for rule in _RULES:
        pairs = [(c, e) for c in cameras if c not in found for e, stem in left.items() if rule(c, stem)]
        # Of names that contain each other (cam1, cam1_b) the longest that fits counts.
        sure = [(c, e) for c, e in pairs if not any(_longer((c, left[e]), (o, left[f])) for o, f in pairs)]
        for camera, entry in sure:
            stems = {fold_name(left[e]) for c, e in sure if c == camera}
            if camera not in found and len(stems) == 1 and {c for c, e in sure if e == entry} == {camera}:
                found[camera] = entry
        taken = {fold_name(left[entry]) for entry in found.values() if entry in left}
        left = {entry: stem for entry, stem in left.items() if fold_name(stem) not in taken}
    return {camera: found[camera] for camera in cameras if camera in found}


def files_by_camera(
    folder: Path, name: str, required: bool, cameras: Iterable[str], suffixes: Sequence[str]
) -> dict[str, Path]:
    """camera → its entry in the folder ``name`` with one of these suffixes; empty without the folder.

    Where it is ``required``, raises UserError unless it is a folder with an entry for a camera.
    """
    base = folder / name
    if not base.is_dir():
        if required:
            raise UserError(f"capture.yaml names {base}, which is not a folder")
        return {}
    kinds = {path: "" if path.is_dir() else path.suffix.lower() for path in sorted(base.iterdir())}
    entries = [path for path, kind in kinds.items() if kind in suffixes and not is_system_file(path)]
    found = pair_by_name(list(cameras), sorted(entries, key=lambda path: suffixes.index(kinds[path])))
    if required and not found:
        raise UserError(
            f"capture.yaml names {base}, which holds nothing for a camera; name its entries after the cameras "
            f"({', '.join(cameras)}), or take the line out"
        )
    return found
