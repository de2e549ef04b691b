# SPDX-License-Identifier: Apache-2.0
"""``calibration.files``: reads the user's calibration files; a read one is in the files' own world and unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.calibration.formats import FORMATS, accepted_formats
from studiorecon.calibration.formats.reading import Reading, write_reading
from studiorecon.calibration.names import Pairing, pairings, pairings_in_order
from studiorecon.calibration.world import metres_per_unit, refuse_wrong_places, to_metric_world, z_up_from_world
from studiorecon.camera_files.raw_camera import check_camera
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.geometry.lens import apply_pixel_map
from studiorecon.progress import say
from studiorecon.rig.lens_model import LensReading, add_radial_term, reinterpret_lens
from studiorecon.scene.camera import Lens
from studiorecon.scene.user_files import file_size, user_file_context
from studiorecon.signature import Written

LengthUnit = Literal["auto", "m", "cm", "mm"]
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

if TYPE_CHECKING:
    from jaxtyping import Float

    FormatName = str
else:
    FormatName = Literal[("auto", *FORMATS)]


@dataclass(frozen=True)
class Settings:
    """Properties of the calibration that its files do not contain."""

    format: FormatName = setting("auto", "Format of the calibration files; auto = the first that recognises them.")
    poses: Literal["as_read", "world_from_camera", "opengl", "world_from_camera_opengl"] = setting(
        "as_read",
        "Convention of the poses, if it differs from the format's; the doctor reports which one fits people.",
    )
    lens: LensReading = setting("as_read", "Lens model of the distortion coefficients, if the files do not state it.")
    radial: dict[str, float] = setting(
        {},
        "Added to k1 of these cameras, {camera: number}; the refinement's log suggests values.",
    )
    unit: LengthUnit = setting("auto", "Unit of lengths; auto = the format's, else mm if cameras are over 100 apart.")
    up: Literal["auto", "x", "-x", "y", "-y", "z", "-z"] = setting(
        "auto", "World axis that points up; auto = from the cameras."
    )
    scale: float = setting(1.0, "Factor on all lengths, for models of arbitrary scale.", above=0)


def read_calibration(files: Sequence[Path], wanted: str = "auto") -> Reading:
    """The calibration in the format ``wanted``, or in any; raises UserError when there is none or it is unreadable."""
    if not files:
        raise UserError(
            "the dataset has no calibration, and cameras this far apart cannot be "
            f"calibrated from their pictures; bring {accepted_formats()}"
        )
    for file in files:
        if not file.exists():
            raise UserError(f"calibration {file} is missing")
        if file == files[0] or not file.is_dir():
            file_size(file)
    for name, form in FORMATS.items():
        with user_file_context(files[0], "a calibration"):
            chosen = name == wanted or (wanted == "auto" and form.recognises(list(files)))
        if chosen:
            with user_file_context(files[0], f"a calibration of {form.made_by}"):
                reading = form.read(list(files))
            if not reading.cameras:
                raise UserError(f"{files[0]} holds no cameras; it was read as {reading.format}")
            return reading
    raise UserError(
        f"{', '.join(f.name for f in files)} is not a calibration of a known format; bring {accepted_formats()}"
    )


def possible_pairings(reading: Reading, cameras: Sequence[str], source: str) -> list[Pairing]:
    """Every way to match a calibration's names to the footage's, the likeliest first; UserError where none fits."""
    names = [c.name for c in reading.cameras]
    return pairings(cameras, names, source) if reading.named else pairings_in_order(cameras, len(names), source)


def paired_lenses(
    reading: Reading,
    source: str,
    cameras: Sequence[str],
    pixel_maps: Mapping[str, Sequence[float]],
    settings: Settings,
    pairing: Pairing | None = None,
) -> tuple[list[Lens], list[str], bool]:
    """Lenses in the order of ``cameras`` by ``pairing``, sentences about changes, and whether z = 0 is the floor.

    ``pairing`` is the likeliest by default.
    """
    pairing = pairing or possible_pairings(reading, cameras, source)[0]
    matched, note = pairing.calibrated, pairing.sentence(source) if pairing.how else ""
    by_name = {c.name: c for c in reading.cameras}
    checked = [check_camera(c, by_name[matched[c]], source) for c in cameras]
    chosen = [camera for camera, _ in checked]
    notes = [*reading.notes, *(n for _, described in checked for n in described), *([note] if note else [])]
    if sizeless := [name for name, c in zip(cameras, chosen, strict=True) if 0 in c.wh]:
        notes.append(f"{source} has no picture size of {', '.join(sizeless)}: the films' size is used")
    left_out = [c.name for c in reading.cameras if c.name not in matched.values()]
    if left_out:
        notes.append(f"the calibration also has {', '.join(left_out)}, without footage")
    poses = [normalise_pose(c.camera_from_world, settings.poses) for c in chosen]
    if settings.poses != "as_read":
        notes.append(f"the poses were read as {settings.poses} (calibration.poses)")
    if settings.lens != "as_read":
        notes.append(f"the distortion coefficients were read as {settings.lens} (calibration.lens)")
    if unknown := [c for c in settings.radial if c not in cameras]:
        raise UserError(f"calibration.radial names camera {unknown[0]}, but the footage has {', '.join(cameras)}")
    changed = {c: k1 for c, k1 in settings.radial.items() if k1}
    notes += [f"the k1 of camera {c} was changed by {k1:+g} (calibration.radial)" for c, k1 in changed.items()]
    centres = np.array([-p[:3, :3].T @ p[:3, 3] for p in poses])
    refuse_wrong_places(cameras, poses, centres, source)
    factor, unit_note = metres_per_unit(centres, reading.unit, settings.unit)
    z_up, up_note = z_up_from_world(np.array([p[:3, :3] for p in poses]), settings.up)
    if settings.scale != 1.0:
        notes.append(f"all lengths were multiplied by {settings.scale:g} (calibration.scale)")
    floor_known = bool(np.array_equal(z_up, np.eye(3))) and reading.has_floor
    poses, moves = to_metric_world(poses, z_up, factor * settings.scale, floor_known)
    notes += [n for n in (unit_note, up_note) if n] + moves
    lenses = []
    for name, raw, pose in zip(cameras, chosen, poses):
        lens = Lens(name, raw.wh, raw.intrinsics, raw.model, raw.distortion, pose, np.eye(2, 3))
        lens = apply_pixel_map(lens, pixel_maps.get(name))
        lenses.append(add_radial_term(reinterpret_lens(lens, settings.lens), settings.radial.get(name, 0.0)))
    return lenses, notes, floor_known


def normalise_pose(pose: Float[np.ndarray, "4 4"], poses: str) -> Float[np.ndarray, "4 4"]:
    """``camera_from_world`` with OpenCV axes of a pose in the convention ``poses`` (see ``Settings``)."""
    turned = _OPENGL @ pose if poses == "opengl" else pose
    if poses.startswith("world_from_camera"):
        turned = np.linalg.inv(pose @ _OPENGL if poses.endswith("opengl") else pose)
    return turned


def run(settings: Settings, files: list[Path], cameras: list[str], read: Written) -> None:
    """Read the calibration ``files`` for the footage names ``cameras``; write ``read`` (JSON) in the files' own
    world."""
    reading = read_calibration(files, settings.format)
    paired_lenses(reading, files[0].name, cameras, {}, settings)
    say(f"{len(reading.cameras)} cameras from {files[0].name} ({reading.format})")
    write_reading(read, reading, files[0].name)
