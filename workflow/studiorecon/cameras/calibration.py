# SPDX-License-Identifier: Apache-2.0
"""``cameras.calibration``: the user's calibration files → lenses in the metric world, z up, pixel centres at +0.5."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon.cameras.formats import (
    caliscope,
    colmap_files,
    easymocap,
    egoexo,
    egohumans,
    llff,
    nerfstudio,
    pose2sim,
    qualisys,
    train_meta,
    zju,
)
from studiorecon.cameras.formats.raw import Reading
from studiorecon.cameras.lens_model import LensReading, as_model, with_radial
from studiorecon.cameras.names import match_in_order, match_names
from studiorecon.cameras.world import metres_per_unit, settled, z_up_from_world
from studiorecon.errors import Refusal
from studiorecon.geometry.lens import calibration_from_video
from studiorecon.progress import say
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_json

# Asked in this order; the first that recognises the files reads them.
_READERS = {
    "egohumans": egohumans,
    "colmap": colmap_files,
    "easymocap": easymocap,
    "qualisys": qualisys,
    "caliscope": caliscope,
    "pose2sim": pose2sim,
    "train_meta": train_meta,
    "nerfstudio": nerfstudio,
    "egoexo": egoexo,
    "llff": llff,
    "zju": zju,
}
_ACCEPTED = (
    "intri.yml + extri.yml (EasyMocap, EasyVolcap), sparse/0 (COLMAP text or binary), a Pose2Sim or Caliscope .toml, "
    "a Qualisys .qca.txt, a nerfstudio transforms.json, colmap/workplace (EgoHumans, Harmony4D), a train_meta.json (Dynamic 3D "
    "Gaussians, MonoFusion), gopro_calibs.csv (Ego-Exo4D), poses_bounds.npy (LLFF) or annots.npy (ZJU-MoCap)"
)
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Settings:
    """What the file cannot say.

    Attributes:
        format: "auto" (the first reader that recognises the files), or a reader's name.
        poses: "as_read" (as the format defines them), or what they really are: "world_from_camera", "opengl" axes, or both.
        lens: "as_read", or the model that the distortion numbers really belong to: "opencv" or "fisheye".
        radial: camera → what is added to its k1; what ``cameras.refine`` says when people call for it.
        unit: "auto", or the unit of the calibration's lengths.
        up: "auto", or the signed axis of the calibration's world that points up.
        scale: factor on all lengths after that, for models of arbitrary scale (COLMAP without a known distance).
    """

    format: Literal[
        "auto", "egohumans", "colmap", "easymocap", "qualisys", "caliscope", "pose2sim", "train_meta", "nerfstudio", "egoexo", "llff", "zju"
    ]
    poses: Literal["as_read", "world_from_camera", "opengl", "world_from_camera_opengl"]
    lens: LensReading
    radial: dict[str, float]
    unit: Literal["auto", "m", "cm", "mm"]
    up: Literal["auto", "x", "-x", "y", "-y", "z", "-z"]
    scale: float


def read_calibration(files: Sequence[Path], wanted: str = "auto") -> Reading:
    """The calibration in the format ``wanted``, or whatever format it is; raises Refusal when there is none or nobody can read it."""
    if not files:
        raise Refusal(
            f"the dataset has no calibration, and cameras this far apart cannot be calibrated from their pictures; bring {_ACCEPTED}"
        )
    for file in files:
        if not file.is_file():
            raise Refusal(f"calibration {file} is missing")
    for name, reader in _READERS.items():
        if name == wanted or (wanted == "auto" and reader.recognises(list(files))):
            reading = reader.read(list(files))
            if not reading.cameras:
                raise Refusal(f"{files[0]} holds no cameras; it was read as {reading.format}")
            return reading
    raise Refusal(f"{', '.join(f.name for f in files)} is not a calibration of a known format; bring {_ACCEPTED}")


def lenses_of(
    reading: Reading, source: str, cameras: Sequence[str], pixel_maps: Mapping[str, Sequence[float]], settings: Settings
) -> tuple[list[Lens], list[str], bool]:
    """Lenses in the order of ``cameras``, the sentences about every change, and whether z = 0 is known to be the floor."""
    names = [c.name for c in reading.cameras]
    matched, note = match_names(cameras, names, source) if reading.named else match_in_order(cameras, len(names), source)
    by_name = {c.name: c for c in reading.cameras}
    chosen = [by_name[matched[c]] for c in cameras]
    notes = [*reading.notes, *([note] if note else [])]
    left_out = [c.name for c in reading.cameras if c.name not in matched.values()]
    if left_out:
        notes.append(f"the calibration also has {', '.join(left_out)}, without footage")
    poses = [meant(c.camera_from_world, settings.poses) for c in chosen]
    if settings.poses != "as_read":
        notes.append(f"the poses were read as {settings.poses}, as the setting cameras.poses says")
    if settings.lens != "as_read":
        notes.append(f"the distortion numbers were read as those of the model {settings.lens}, as the setting cameras.lens says")
    if unknown := [c for c in settings.radial if c not in cameras]:
        raise Refusal(f"cameras.radial names camera {unknown[0]}, but the footage has {', '.join(cameras)}")
    notes += [f"the k1 of camera {c} was changed by {k1:+g}, as the setting cameras.radial says" for c, k1 in settings.radial.items()]
    centres = np.array([-p[:3, :3].T @ p[:3, 3] for p in poses])
    factor, unit_note = metres_per_unit(centres, reading.unit, settings.unit)
    z_up, up_note = z_up_from_world(np.array([p[:3, :3] for p in poses]), settings.up)
    if settings.scale != 1.0:
        notes.append(f"all lengths were multiplied by {settings.scale:g}, as the setting cameras.scale says")
    floor_known = bool(np.array_equal(z_up, np.eye(3))) and reading.format != "COLMAP"
    poses, moves = settled(poses, z_up, factor * settings.scale, floor_known)
    notes += [n for n in (unit_note, up_note) if n] + moves
    lenses = []
    for name, raw, pose in zip(cameras, chosen, poses):
        intrinsics = raw.intrinsics
        if not (intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0 and np.isfinite(intrinsics).all()):
            raise Refusal(f"camera {name} in {source}: its focal length is {intrinsics[0, 0]:g}; calibrate this camera again")
        lens = Lens(name, raw.wh, intrinsics, raw.model, raw.distortion, pose, calibration_from_video(pixel_maps.get(name)))
        lenses.append(with_radial(as_model(lens, settings.lens), settings.radial.get(name, 0.0)))
    return lenses, notes, floor_known


def meant(pose: np.ndarray, poses: str) -> np.ndarray:
    """(4, 4) ``camera_from_world`` with OpenCV axes of a pose that is really ``poses`` (see ``Settings``)."""
    turned = _OPENGL @ pose if poses == "opengl" else pose
    if poses.startswith("world_from_camera"):
        turned = np.linalg.inv(pose @ _OPENGL if poses.endswith("opengl") else pose)
    return turned


def run(settings: Settings, files: list[Path], cameras: list[str], pixel_maps: str, calibration: Path) -> None:
    """Read the calibration ``files`` for the footage names ``cameras``; write ``calibration`` (JSON)."""
    reading = read_calibration(files, settings.format)
    lenses, notes, floor_known = lenses_of(reading, files[0].name, cameras, json.loads(pixel_maps or "{}"), settings)
    say(f"{len(lenses)} cameras from {files[0].name} ({reading.format})")
    for note in notes:
        say(note)
    write_json(
        calibration,
        {
            "source": files[0].name,
            "format": reading.format,
            "lenses": [lens.as_json() for lens in lenses],
            "floor_known": floor_known,
            "notes": notes,
        },
    )
