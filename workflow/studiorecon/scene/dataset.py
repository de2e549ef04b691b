# SPDX-License-Identifier: Apache-2.0
"""A dataset directory: what a user has on disk, found by its conventional names or named in ``capture.yaml``.

Importable without numpy-heavy modules: the workflow reads it while it makes its plan.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studiorecon.errors import Refusal
from studiorecon.scene.capture_yaml import focal_lengths, frames_used, names_under, pixel_maps, read_description, starts_of, whole_number

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
# The first of these that exists is the calibration, when capture.yaml does not name one.
_CALIBRATIONS = (
    ("intri.yml", "extri.yml"),
    ("optimized/intri.yml", "optimized/extri.yml"),
    ("Intrinsic.yml", "Extrinsic.yml"),
    ("sparse/0/cameras.txt", "sparse/0/images.txt"),
    ("sparse/0/cameras.bin", "sparse/0/images.bin"),
    ("sparse/cameras.txt", "sparse/images.txt"),
    ("cameras.txt", "images.txt"),
    ("colmap/workplace/cameras.txt", "colmap/workplace/images.txt", "colmap/workplace/scale.npy"),
    ("colmap/workplace/cameras.txt", "colmap/workplace/images.txt", "colmap/workplace/colmap_from_aria_transforms.pkl"),
    ("transforms.json",),
    ("train_meta.json",),
    ("trajectory/Dy_train_meta.json",),
    ("Dy_train_meta.json",),
    ("gopro_calibs.csv",),
    ("trajectory/gopro_calibs.csv",),
    ("poses_bounds.npy",),
    ("annots.npy",),
)
# Where the footage lies in the captures that people have; the first that holds any counts.
_VIDEO_FOLDERS = ("videos", "frame_aligned_videos")
_PICTURE_FOLDERS = (("images", ""), ("ims", ""), ("exo", "images"))


@dataclass(frozen=True)
class Dataset:
    """Where everything of one capture lies. All paths exist unless the studio is still to make them.

    Attributes:
        folder: the dataset directory.
        footage: camera → video file, or folder of pictures.
        held_out: cameras that only ``report`` may look at.
        calibration: the calibration's file(s); empty when none was found.
        keypoints: camera → folder of JSON files, or one file. Cameras without recorded keypoints are absent.
        keypoint_layout: name of the layout, or ``"auto"``.
        keypoint_first_frame: the number in the keypoint files that belongs to the first frame of the videos.
        plates, masks, depth: camera → file or folder, where the user brings them.
        identities: a corrected ``identities.tsv`` (camera, track, person), or None.
        pixel_maps: camera → (scale, x, y) with p_video = scale · p_calibration + (x, y), pixel centres at +0.5, for
            footage that was resized or padded after the calibration.
        focal_px: camera → focal length in pixels of its footage, where capture.yaml gives one; only used without a calibration.
        starts: camera → the frame of its footage, maybe between two, that shows one moment, as ``capture.yaml`` says; empty: it does not.
        first_frame: of the moments that all cameras have, the first to use.
        frame_count: how many of them to use; 0 = to the end.
        people: False when ``capture.yaml`` says ``people: 0``: the room is known to be empty.
        truth: folder of exact truth (made studio only), else None.
    """

    folder: Path
    footage: Mapping[str, Path]
    held_out: tuple[str, ...]
    calibration: tuple[Path, ...]
    keypoints: Mapping[str, Path]
    keypoint_layout: str
    keypoint_first_frame: int
    plates: Mapping[str, Path]
    masks: Mapping[str, Path]
    depth: Mapping[str, Path]
    identities: Path | None
    pixel_maps: Mapping[str, tuple[float, float, float]]
    focal_px: Mapping[str, float]
    starts: Mapping[str, float]
    first_frame: int
    frame_count: int
    people: bool
    truth: Path | None

    @property
    def cameras(self) -> tuple[str, ...]:
        return tuple(self.footage)

    @property
    def training(self) -> tuple[str, ...]:
        return tuple(c for c in self.footage if c not in self.held_out)


def open_dataset(folder: Path, capture_yaml: Path | None = None) -> Dataset:
    """The dataset in ``folder``, described by ``capture_yaml`` (default: ``folder/capture.yaml`` if it is there).

    Paths inside ``capture.yaml`` are relative to ``folder``. Raises Refusal, naming the folder or key and the remedy.
    """
    if not folder.is_dir():
        raise Refusal(f"dataset folder {folder} does not exist; pass an existing one with --config dataset=DIR")
    description = read_description(folder, capture_yaml)
    footage = _find_footage(folder)
    starts = starts_of(description, footage)
    chosen = names_under(description, "train", footage) + names_under(description, "held_out", footage)
    held_out = tuple(names_under(description, "held_out", footage))
    if "train" in description:
        footage = {c: footage[c] for c in footage if c in chosen}
    if len(footage) - len(held_out) < 2:
        raise Refusal(f"dataset {folder} has {len(footage) - len(held_out)} training camera(s); at least 2 videos are needed in videos/")
    first, count = frames_used(description, folder)
    keypoints = _per_camera(folder, description.get("keypoints"), ("keypoints", "pose", "openpose", "annots"), footage)
    return Dataset(
        folder=folder,
        footage=footage,
        held_out=held_out,
        calibration=_find_calibration(folder, description),
        keypoints=keypoints,
        keypoint_layout=str(description.get("keypoint_layout", "auto")),
        keypoint_first_frame=whole_number(description, "keypoint_first_frame", folder),
        plates=_per_camera(folder, description.get("plates"), ("plates",), footage),
        masks=_per_camera(folder, description.get("masks"), ("masks",), footage),
        depth=_per_camera(folder, description.get("depth"), ("depth",), footage),
        identities=_identities(folder, description),
        pixel_maps=pixel_maps(description, footage),
        focal_px=focal_lengths(description, footage),
        starts={camera: starts[camera] for camera in footage} if starts else {},
        first_frame=first,
        frame_count=count,
        people=description.get("people", 1) not in (0, False, "none"),
        truth=None,
    )


def _find_footage(folder: Path) -> dict[str, Path]:
    videos = _first_non_empty(
        [p for p in sorted((folder / name).glob("*")) if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith(".")]
        for name in _VIDEO_FOLDERS
    )
    found = {} if videos else _picture_folders(folder)
    if not videos and not found:
        videos = [p for p in sorted(folder.glob("*")) if p.suffix.lower() in VIDEO_SUFFIXES and not p.name.startswith(".")]
    stems = [p.stem for p in videos]
    for stem in stems:
        if stems.count(stem) > 1:
            raise Refusal(f"{videos[0].parent} holds more than one video named {stem!r}; keep one per camera")
    if videos:
        return {p.stem: p for p in videos}
    if not found:
        raise Refusal(
            f"dataset {folder} has neither videos/*.mp4 (or mov, mkv) nor images/<camera>/*.png (or jpg): put one video per camera there"
        )
    return found


def _first_non_empty(lists: Iterable[list[Path]]) -> list[Path]:
    return next((found for found in lists if found), [])


def _picture_folders(folder: Path) -> dict[str, Path]:
    """camera → its folder of pictures: ``images/<camera>``, ``ims/<camera>`` or ``exo/<camera>/images``."""
    for outer, inner in _PICTURE_FOLDERS:
        places = {p.name: p / inner for p in sorted((folder / outer).glob("*")) if (p / inner).is_dir()}
        found = {name: p for name, p in places.items() if any(q.suffix.lower() in PICTURE_SUFFIXES for q in p.iterdir())}
        if found:
            return found
    return {}


def _find_calibration(folder: Path, description: dict[str, Any]) -> tuple[Path, ...]:
    named = description.get("calibration")
    if named is not None:
        paths = tuple(folder / p for p in ([named] if isinstance(named, str) else named))
        for path in paths:
            if not path.exists():
                raise Refusal(f"capture.yaml names the calibration {path}, which does not exist")
        return _with_rigs(paths)
    for names in _CALIBRATIONS:
        if all((folder / n).is_file() for n in names):
            return _with_rigs(tuple(folder / n for n in names))
    for pattern in ("*.toml", "calibration/*.toml", "*.qca.txt", "calibration/*.qca.txt"):
        found = [p for p in sorted(folder.glob(pattern)) if p.suffix != ".toml" or _holds_cameras(p)]
        if len(found) == 1:
            return (found[0],)
        if len(found) > 1:
            names = ", ".join(p.name for p in found)
            raise Refusal(f"{folder} holds {len(found)} calibrations ({names}); name one in capture.yaml: calibration: FILE")
    return ()


def colmap_files(images: Path) -> tuple[Path, ...]:
    """The files of the COLMAP model of an ``images.txt`` or ``images.bin`` that say where its cameras stand: its poses are only whole
    together with ``rigs`` and ``frames``, where there are some."""
    beside = [images.with_name(f"{part}{images.suffix}") for part in ("rigs", "frames")]
    return (images.with_name(f"cameras{images.suffix}"), images, *(path for path in beside if path.is_file()))


def _with_rigs(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The calibration's files, with rigs and frames of a COLMAP model that stand beside those named."""
    images = [path for path in paths if path.name in ("images.txt", "images.bin")]
    return tuple(dict.fromkeys([*paths, *(path for file in images for path in colmap_files(file) if path.is_file())]))


def _holds_cameras(path: Path) -> bool:
    """Whether a TOML file could be a calibration: Pose2Sim's Config.toml and Caliscope's charuco.toml lie beside it."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return "matrix" in text and "translation" in text


def _per_camera(folder: Path, named: Any, defaults: tuple[str, ...], footage: Mapping[str, Path]) -> dict[str, Path]:
    """camera → path inside the named (or first existing default) folder: ``<camera>``, ``<camera>_json``, ``<camera>.*``."""
    base = folder / str(named) if named is not None else next((folder / d for d in defaults if (folder / d).is_dir()), None)
    if base is None:
        return {}
    if not base.is_dir():
        raise Refusal(f"capture.yaml names {base}, which is not a folder")
    entries = sorted(base.iterdir())
    found = {}
    for camera in footage:
        for entry in entries:
            stem = entry.name if entry.is_dir() else entry.name.split(".")[0]
            if stem in (camera, f"{camera}_json", f"{camera}_ext"):
                found[camera] = entry
                break
    return found


def _identities(folder: Path, description: dict[str, Any]) -> Path | None:
    path = folder / str(description.get("identities", "identities.tsv"))
    if "identities" in description and not path.is_file():
        raise Refusal(f"capture.yaml names identities: {path}, which does not exist")
    return path if path.is_file() else None
