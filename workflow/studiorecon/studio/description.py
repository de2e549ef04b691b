# SPDX-License-Identifier: Apache-2.0
"""The description of a synthetic studio: a YAML file over ``resources/studio/defaults.yaml`` → a frozen dataclass.

Importable without numpy: the workflow reads it while it makes its plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from studiorecon.configuration import settings
from studiorecon.errors import UserError
from studiorecon.home import RESOURCES
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.user_files import read_yaml

DEFAULTS = RESOURCES / "studio" / "defaults.yaml"
# Side that H.264 in 8 bits encodes everywhere; pictures of it are drawn in about 4 GB of memory.
_MAX_SIDE_PX = 8192
_MAX_DRAWN_PX = 8192 * 8192

Format = Literal["easymocap", "colmap", "pose2sim", "caliscope", "nerfstudio"]
CALIBRATION_FILES: Mapping[str, tuple[str, ...]] = {
    "easymocap": ("intri.yml", "extri.yml"),
    "colmap": ("sparse/0/cameras.txt", "sparse/0/images.txt"),
    "pose2sim": ("calibration/Calib.toml",),
    "caliscope": ("camera_array_aniposelib.toml",),
    "nerfstudio": ("transforms.json",),
}


@dataclass(frozen=True)
class RigDescription:
    """Positions of the cameras; see ``resources/studio/defaults.yaml`` for every key."""

    training: int
    held_out: int
    layout: Literal["ring", "arc"]
    arc_deg: float
    radius_m: float
    height_m: tuple[float, float]
    look_at_m: tuple[float, float, float]
    hfov_deg: float
    jitter_deg: float


@dataclass(frozen=True)
class Faults:
    """Faults of the training footage."""

    exposure: float
    white_balance: float
    radial_distortion: float
    sync_offset_frames: float
    noise_levels: float


@dataclass(frozen=True)
class Effects:
    """Effects in the room other than people's motion."""

    moving_shadows: bool
    contact_shading: float
    ball: bool
    stick: bool
    glossy_floor: float
    changing_light: float


@dataclass(frozen=True)
class DetectionOptions:
    """Whether 2D keypoints are recorded, and their quality."""

    recorded: bool
    noise_px: float
    drop_outs: float
    false_positives: float
    shuffled: bool


@dataclass(frozen=True)
class CalibrationOptions:
    """Format of the calibration, and its errors."""

    format: Format
    rotation_error_deg: float
    position_error_m: float


@dataclass(frozen=True)
class TruthOptions:
    """Large, rarely needed parts of the truth."""

    depth_frames: bool
    flow: bool


@dataclass(frozen=True)
class Description:
    """The full definition of one synthetic capture; the same description gives the same bytes."""

    seed: int
    frames: int
    fps: float
    size: tuple[int, int]
    supersampling: int
    crf: int
    people: int
    hands: bool
    cameras: RigDescription
    faults: Faults
    effects: Effects
    detections: DetectionOptions
    calibration: CalibrationOptions
    plates: bool
    truth: TruthOptions

    @property
    def keypoints(self) -> bool:
        """Whether keypoint files are written."""
        return self.people > 0 and self.detections.recorded

    @property
    def training(self) -> tuple[str, ...]:
        """Names of the training cameras."""
        return tuple(f"cam{k}" for k in range(1, self.cameras.training + 1))

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the held-out cameras."""
        return tuple(f"view{k}" for k in range(1, self.cameras.held_out + 1))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all cameras, training first, which is also their alphabetical order."""
        return self.training + self.held_out


def read_description(path: Path) -> Description:
    """The description in ``path`` over the defaults; raises UserError with the file, the key and the allowed values."""
    defaults = _mapping(DEFAULTS)
    merged = _merge(defaults, _mapping(path), path, "")
    try:
        description = settings.load(Description, merged, path.name)
    except UserError as refusal:
        raise UserError(f"{path}: {refusal}") from None
    _check_ranges(description, path)
    return description


def planned_dataset(description: Description, folder: Path, truth: Path) -> Dataset:
    """The dataset that ``studio.capture`` will write into ``folder``, without making it."""
    training, names = description.training, description.names
    return Dataset(
        folder=folder,
        footage={name: folder / "videos" / f"{name}.mp4" for name in names},
        held_out=description.held_out,
        calibration=tuple(folder / name for name in CALIBRATION_FILES[description.calibration.format]),
        keypoints={name: folder / "keypoints" / name for name in training} if description.keypoints else {},
        keypoint_layout="body_25",
        keypoint_first_frame={},
        plates={name: folder / "plates" / f"{name}.png" for name in training} if description.plates else {},
        masks={},
        depth={},
        identities=None,
        pixel_maps={},
        focal_px={},
        lengths={},
        starts={},
        first_frame=0,
        frame_count=0,
        people=description.people > 0,
        truth=truth,
    )


def _mapping(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise UserError(f"studio description {path} does not exist; resources/studio/demo.yaml is one to start from")
    value = read_yaml(path)
    value = {} if value is None else value
    if not isinstance(value, dict):
        raise UserError(f"{path} must be a mapping of options; resources/studio/defaults.yaml lists them all")
    return value


def _merge(defaults: Mapping[str, Any], given: Mapping[str, Any], path: Path, section: str) -> dict[str, Any]:
    merged = dict(defaults)
    for key, value in given.items():
        if key not in defaults:
            known = ", ".join(sorted(defaults))
            raise UserError(f"{path} has the unknown option {section}{key}; known options there are {known}")
        if isinstance(defaults[key], dict):
            if not isinstance(value, dict):
                raise UserError(f"{path}: {section}{key} must be a section with keys, not {value!r}")
            merged[key] = _merge(defaults[key], value, path, f"{section}{key}.")
        else:
            merged[key] = value
    return merged


def _check_ranges(d: Description, path: Path) -> None:
    share = [
        ("effects.contact_shading", d.effects.contact_shading),
        ("effects.glossy_floor", d.effects.glossy_floor),
        ("effects.changing_light", d.effects.changing_light),
        ("detections.drop_outs", d.detections.drop_outs),
        ("detections.false_positives", d.detections.false_positives),
    ]
    between = [
        ("seed", d.seed, 0, 2**63 - 1),
        ("frames", d.frames, 1, 100_000),
        ("fps", d.fps, 1, 1000),
        ("supersampling", d.supersampling, 1, 8),
        ("crf", d.crf, 0, 51),
        ("people", d.people, 0, 4),
        ("cameras.training", d.cameras.training, 3, 8),
        ("cameras.held_out", d.cameras.held_out, 0, 8),
        ("cameras.arc_deg", d.cameras.arc_deg, 20, 330),
        ("cameras.radius_m", d.cameras.radius_m, 1.5, 3.4),
        ("cameras.hfov_deg", d.cameras.hfov_deg, 20, 120),
        ("cameras.jitter_deg", d.cameras.jitter_deg, 0, 10),
        *(("cameras.height_m", height, 0.2, 2.8) for height in d.cameras.height_m),
        *(("cameras.look_at_m", place, -1, most) for place, most in zip(d.cameras.look_at_m, (1, 1, 2))),
        ("faults.exposure", d.faults.exposure, 0, 0.9),
        ("faults.white_balance", d.faults.white_balance, 0, 0.9),
        ("faults.radial_distortion", d.faults.radial_distortion, -0.3, 0.3),
        ("faults.sync_offset_frames", d.faults.sync_offset_frames, 0, 100),
        ("faults.noise_levels", d.faults.noise_levels, 0, 64),
        ("detections.noise_px", d.detections.noise_px, 0, 100),
        ("calibration.rotation_error_deg", d.calibration.rotation_error_deg, 0, 180),
        ("calibration.position_error_m", d.calibration.position_error_m, 0, 100),
        *((name, value, 0, 1) for name, value in share),
    ]
    for name, value, low, high in between:
        if not low <= value <= high:
            raise UserError(f"{path}: {name} is {value}; it must be between {low} and {high}")
    if d.size[0] % 2 or d.size[1] % 2 or min(d.size) < 32:
        raise UserError(
            f"{path}: size is {list(d.size)}; width and height must be even and at least 32, as H.264 needs"
        )
    drawn = d.size[0] * d.size[1] * d.supersampling**2
    if max(d.size) > _MAX_SIDE_PX or drawn > _MAX_DRAWN_PX:
        raise UserError(
            f"{path}: size {list(d.size)} with supersampling {d.supersampling} is {drawn / 1e6:,.0f} million pixels "
            f"a picture; at most {_MAX_DRAWN_PX / 1e6:,.0f} million are drawn, no side longer than {_MAX_SIDE_PX}"
        )
    gaps = d.cameras.training - (d.cameras.layout == "arc")
    if d.cameras.held_out > gaps:
        raise UserError(
            f"{path}: cameras.held_out is {d.cameras.held_out}, and between {d.cameras.training} cameras in a "
            f"{d.cameras.layout} there is room for {gaps}; set it to at most that"
        )
