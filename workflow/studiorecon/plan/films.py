# SPDX-License-Identifier: Apache-2.0
"""The films in a capture's folder, grouped into the chapters of one recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.footage.kinds import is_film
from studiorecon.scene.dataset import PICTURE_SUFFIXES
from studiorecon.scene.names import fold_name, is_system_file
from studiorecon.scene.numbered_files import natural_sort_key

# Folders that hold the footage in common captures; the first with films counts.
VIDEO_FOLDERS = ("videos", "video", "frame_aligned_videos")
_PICTURE_FOLDERS = (("images", ""), ("ims", ""), ("exo", "images"))
# Chapters with a number in the name: GoPro since HERO6 (GX010123, GX020123), GoPro before (GOPR0123, GP010123),
# Insta360.
_GOPRO = re.compile(r"(?P<before>(?:.*[^A-Za-z0-9])?)G(?P<kind>[HXL])(?P<chapter>\d\d)(?P<number>\d{4})", re.IGNORECASE)
_OLD_GOPRO = re.compile(r"(?P<before>(?:.*[^A-Za-z0-9])?)G(?:OPR|P(?P<chapter>\d\d))(?P<number>\d{4})", re.IGNORECASE)
_INSTA360 = re.compile(r"(?P<before>VID_\d{8}_\d{6}_\d\d)_(?P<chapter>\d{3})", re.IGNORECASE)
# Names with a running number: Sony's C0001, DJI_0001, AVCHD's 00001, Canon's MVI_0001, Panasonic's.
_COUNTED = re.compile(r"(?P<before>C|DJI_(?:\d+_)?|MVI_|DSC_?|MOV|CLIP|P|)(?P<chapter>\d{4,7})(?:_D)?", re.IGNORECASE)
_PART = re.compile(r"(?P<before>.*?)[-_ .]?(?:part|teil)?[-_ .]?(?P<chapter>\d{1,3})", re.IGNORECASE)
_PREVIEWS = {".lrv", ".lrf", ".thm", ".insv", ".360"}
# Bytes at which recorders begin the next file: 2 and 4 GB, by every definition of GB.
_FULL_BYTES = ((1_930_000_000, 2_200_000_000), (3_400_000_000, 4_400_000_000))


def is_preview(path: Path) -> bool:
    """Whether a file is a preview or raw data that GoPro, DJI and Insta360 write next to a film."""
    return path.suffix.lower() in _PREVIEWS or path.name.startswith("LRV_")


@dataclass(frozen=True)
class Recordings:
    """The footage of a folder.

    Attributes:
        films: camera → its film, its chapters in order, or its one folder of pictures.
        place: the folder that holds them.
        notes: sentences about films that were joined, and films that may have to be.
    """

    films: Mapping[str, tuple[Path, ...]]
    place: Path
    notes: tuple[str, ...]


def find_recordings(folder: Path, chapters: Mapping[str, Sequence[str]]) -> Recordings:
    """The footage in ``folder``; ``chapters`` of capture.yaml maps a camera to its films there.

    Raises UserError when there is no footage, when two films share a name, or when a chapter is missing.
    """
    folders = {fold_name(p.name): p for p in sorted(folder.iterdir()) if p.is_dir()}
    places = [folders[name] for name in VIDEO_FOLDERS if name in folders]
    for place in places:
        if films := _films(place):
            return _recordings(films, place, folder, chapters)
        if found := _film_per_folder(place, folder, chapters):
            return found
    if pictures := _picture_folders(folder):
        place = next(iter(pictures.values())).parent
        return Recordings({camera: (path,) for camera, path in pictures.items()}, place, ())
    if films := _films(folder):
        return _recordings(films, folder, folder, chapters)
    if found := _film_per_folder(folder, folder, chapters):
        return found
    others = [path for path in folders.values() if len(_films(path)) > 1 and not is_system_file(path)]
    if len(others) == 1:
        found = _recordings(_films(others[0]), others[0], folder, chapters)
        return Recordings(found.films, found.place, (f"films are taken from {others[0].name}/", *found.notes))
    several = f"; {', '.join(p.name + '/' for p in others)} hold films: name the right one videos/" if others else ""
    for path in folder.iterdir():
        if fold_name(path.name) in VIDEO_FOLDERS and not path.is_dir():
            to = f"a link to {path.readlink()}, which is no folder" if path.is_symlink() else "no folder"
            several = f"; {path.name} is {to}"
        elif path.suffix.lower() == ".zip":
            several = f"; {path.name} is packed: unpack it"
    raise UserError(
        f"dataset {folder} has neither videos/*.mp4 (or mov, mkv, …) nor images/<camera>/*.png (or jpg): put one video "
        f"per camera there{several}"
    )


def _films(folder: Path) -> list[Path]:
    if waiting := next((p for p in sorted(folder.glob(".*.icloud")) if is_film(Path(p.stem[1:]))), None):
        raise UserError(f"{waiting} is a placeholder: download {waiting.stem[1:]} from iCloud first, or delete it")
    return [p for p in sorted(folder.iterdir()) if not is_system_file(p) and not is_preview(p) and is_film(p)]


def _only_films(folder: Path) -> list[Path]:
    """The films of a folder, or of the only folder below it that holds some, as in OpenCap's Cam0/InputMedia/TRIAL/."""
    own = _films(folder)
    below = [] if own else [films for p in sorted(folder.iterdir()) if p.is_dir() and (films := _only_films(p))]
    return below[0] if len(below) == 1 else own


def _film_per_folder(place: Path, folder: Path, chapters: Mapping[str, Sequence[str]]) -> Recordings | None:
    """Recordings of ``<camera>/*.mp4``, one per folder; None unless two or more folders hold films."""
    inside = {
        p.name: films
        for p in sorted(place.iterdir())
        if p.is_dir() and not is_system_file(p) and (films := _films(p) if place == folder else _only_films(p))
    }
    if len(inside) < 2:
        return None
    found, notes = {}, [f"cameras are named by the folders of their films in {place.name}/"]
    for camera, films in inside.items():
        several = _recordings(films, films[0].parent, folder, chapters)
        if len(several.films) > 1:
            listed = ", ".join(path.relative_to(folder).as_posix() for path in films)
            raise UserError(
                f"{place / camera} holds {len(several.films)} films; names and sizes do not show whether they are one "
                f"recording; keep one of them, or write into capture.yaml: chapters: {{{camera}: [{listed}]}}"
            )
        found[camera] = next(iter(several.films.values()))
        notes += several.notes
    return Recordings(found, place, tuple(notes))


def _picture_folders(folder: Path) -> dict[str, Path]:
    """camera → its folder of pictures: ``images/<camera>``, ``ims/<camera>`` or ``exo/<camera>/images``."""
    for outer, inner in _PICTURE_FOLDERS:
        places = {p.name: p / inner for p in sorted((folder / outer).glob("*")) if (p / inner).is_dir()}
        held = {n: p for n, p in places.items() if any(q.suffix.lower() in PICTURE_SUFFIXES for q in p.iterdir())}
        if held:
            return held
    return {}


def _recordings(films: Sequence[Path], place: Path, folder: Path, chapters: Mapping[str, Sequence[str]]) -> Recordings:
    named: dict[str, tuple[Path, ...]] = {}
    for camera, names in chapters.items():
        listed = tuple(next((f for f in films if f in (folder / name, place / name)), folder / name) for name in names)
        if set(listed) & set(films):
            named[camera] = listed
            if strange := [path for path in listed if path not in films]:
                raise UserError(f"capture.yaml: chapters of {camera} names {strange[0]}, which is no film of {place}")
    taken = [film for listed in named.values() for film in listed]
    if again := [film for film in taken if taken.count(film) > 1]:
        raise UserError(f"capture.yaml: chapters names {again[0]} twice; keep one")
    joined = _joined([film for film in films if film not in taken])
    stems = [parts[0].stem for parts in joined]
    if twice := next((stem for stem in [*stems, *named] if [*stems, *named].count(stem) > 1), None):
        raise UserError(f"{place} holds more than one video named {twice!r}; keep one per camera")
    found = {parts[0].stem: parts for parts in joined} | named
    notes = [
        f"{', '.join(path.name for path in parts)} are chapters of one recording: camera {camera}"
        for camera, parts in found.items()
        if len(parts) > 1
    ]
    return Recordings(
        dict(sorted(found.items(), key=lambda item: item[1][0])), place, (*notes, *_perhaps(found, folder))
    )


def _joined(films: Sequence[Path]) -> list[tuple[Path, ...]]:
    """The films, with those that are surely chapters of one recording grouped, in order."""
    found: list[tuple[Path, ...]] = []
    for _, numbered in groupby(sorted(films, key=_place_in_recording), lambda film: _place_in_recording(film)[0]):
        parts = list(numbered)
        numbers = [_place_in_recording(part)[1] for part in parts]
        if len(set(numbers)) == len(numbers):
            if gap := next((a for a, b in pairwise(numbers) if b != a + 1), None):
                raise UserError(
                    f"{parts[0].parent} has chapters {', '.join(map(str, numbers))} of the recording {parts[0].stem}: "
                    f"chapter {gap + 1} is missing; copy it from the camera, or take the later ones out of the folder"
                )
            found.append(tuple(parts))
        else:
            found += [(part,) for part in parts]
    singles = sorted((parts[0] for parts in found if len(parts) == 1), key=lambda film: natural_sort_key(film.stem))
    others = [parts for parts in found if len(parts) > 1]
    split: list[list[Path]] = []
    for film in singles:
        if split and _full(split[-1][-1]) and _follows(split[-1][-1], film, _COUNTED):
            split[-1].append(film)
        else:
            split.append([film])
    return [*others, *map(tuple, split)]


def _place_in_recording(film: Path) -> tuple[str, int]:
    """The part of the name that chapters of one recording share, and the chapter's number, where the name has both."""
    for pattern in (_GOPRO, _OLD_GOPRO, _INSTA360):
        if found := pattern.fullmatch(film.stem):
            parts = found.groupdict()
            of = (pattern.pattern, parts["before"], parts.get("kind", ""), parts.get("number", ""), film.suffix.lower())
            return "\0".join(of).casefold(), int(parts["chapter"] or 0)
    return f"~{film.name}", 0


def _follows(before: Path, after: Path, pattern: re.Pattern[str]) -> bool:
    one, two = pattern.fullmatch(before.stem), pattern.fullmatch(after.stem)
    return bool(
        one
        and two
        and before.suffix.lower() == after.suffix.lower()
        and one["before"].casefold() == two["before"].casefold()
        and int(two["chapter"]) == int(one["chapter"]) + 1
    )


def _full(film: Path) -> bool:
    return film.is_file() and any(low <= film.stat().st_size <= high for low, high in _FULL_BYTES)


def _perhaps(found: Mapping[str, tuple[Path, ...]], folder: Path) -> list[str]:
    """A sentence when two or more sets of films share a numbering: cam1-1, cam1-2, cam2-1, cam2-2."""
    runs: dict[str, list[Path]] = {}
    for parts in found.values():
        if len(parts) == 1 and (match := _PART.fullmatch(parts[0].stem)) and match["before"]:
            runs.setdefault(match["before"].casefold(), []).append(parts[0])
    sets = [sorted(run, key=lambda film: natural_sort_key(film.stem)) for run in runs.values() if len(run) > 1]
    if len(sets) < 2 or not all(_follows(a, b, _PART) for run in sets for a, b in pairwise(run)):
        return []
    example = ", ".join(film.relative_to(folder).as_posix() for film in sets[0])
    return [
        f"{' and '.join(film.name for film in sets[0])} are used as different cameras; if they are parts of one "
        f"recording, write into capture.yaml: chapters: {{{sets[0][0].stem}: [{example}]}}, and likewise for the others"
    ]


def unreadable_footage(films: Mapping[str, Sequence[Path]]) -> list[str]:
    """A sentence for every camera (camera → films) whose footage holds no picture that can be decoded."""
    from studiorecon.footage.source import check_readable  # loads OpenCV, which other plans do not need

    found = []
    for camera, parts in films.items():
        try:
            for part in parts:
                check_readable(part)
        except UserError as refusal:
            found.append(f"camera {camera}: {refusal}; or leave the camera out with train: [...] in capture.yaml")
    return found
