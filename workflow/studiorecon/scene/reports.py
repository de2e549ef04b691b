# SPDX-License-Identifier: Apache-2.0
"""What steps report about their decisions, as pages and tables show it: association.json, refinement.json and
metrics.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from studiorecon.scene.schema import (
    Anything,
    AtLeast,
    ListOf,
    MappingOf,
    OptionalField,
    flag,
    real,
    seconds,
    text,
    whole,
)
from studiorecon.scene.step_files import read

_TRACK = {
    "camera": text(), "track": whole(), "first": whole(low=0), "last": whole(low=0), "detections": whole(low=1),
    "person": text(), "margin": OptionalField(real()), "reason": text(),
}  # fmt: skip
_LEFT_OUT = {
    "name": text(), "seconds": seconds(low=0), "cameras": ListOf(text()), "reason": text(), "lines": ListOf(text()),
    "tracks": ListOf(Anything()),
}  # fmt: skip
_ASSOCIATION = AtLeast({"corrected": flag(), "tracks": ListOf(_TRACK), "left_out": ListOf(_LEFT_OUT)})
_PER_CAMERA_PX = OptionalField(real("N", low=0, gaps=True, unit="px"))
_REFINEMENT = AtLeast(
    {
        "cameras": ListOf(text()),
        "before_px_per_camera": _PER_CAMERA_PX,
        "after_px_per_camera": _PER_CAMERA_PX,
        "calibration": OptionalField(AtLeast({"doubts": OptionalField(ListOf(text()))})),
        "edges": OptionalField(AtLeast({"cameras": ListOf(text()), "off_deg": real(), "believed": flag()})),
    }
)
# Null where it is not measured, with a reason.
_MEASURED = real(gaps=True)
_MEASURE = AtLeast({"value": _MEASURED, "reason": OptionalField(text())})
_ERRORS = {f"mpjpe_{how}_mm": real(low=0, gaps=True, unit="mm") for how in ("world", "pelvis", "similarity")}
_METRICS = AtLeast(
    {
        "pictures": MappingOf(MappingOf(_MEASURE)),
        "bodies": AtLeast(
            {
                **_ERRORS,
                "people": MappingOf(AtLeast({"true_person": text(), "frames": whole(low=0), **_ERRORS})),
                "missed": ListOf(text()),
                "invented": ListOf(text()),
                "reason": OptionalField(text()),
            }
        ),
        "jitter": MappingOf(AtLeast({"joints_mm_f2": _MEASURED, "pose_deg_f2": _MEASURED})),
        "coverage": MappingOf(MappingOf(OptionalField(real(low=0, high=1)))),
        "rig": AtLeast({"position_deg": _MEASURED, "viewing_deg": _MEASURED, "training_cameras": whole(low=1)}),
        "held_out_cameras": ListOf(AtLeast({"sentence": text(), "turned_deg": real(), "is_verified": flag()})),
        "identities": MappingOf(Anything()),
        "provenance": AtLeast({"libraries": MappingOf(text()), "revision": OptionalField(text()), "masks": text()}),
    }
)
_RECOGNITION = AtLeast({version: OptionalField(MappingOf(Anything())) for version in ("raw", "enhanced")})


def read_association(path: Path) -> dict[str, Any]:
    """Who every track is and why, and the people who were left out; raises UserError as ``step_files.read`` does."""
    return read(path, _ASSOCIATION)


def read_refinement(path: Path) -> dict[str, Any]:
    """How well the cameras explain people, as calibrated and as used; raises UserError as ``step_files.read`` does."""
    return read(path, _REFINEMENT)


def read_metrics(path: Path) -> dict[str, Any]:
    """The measures of pictures, bodies and cameras; raises UserError as ``step_files.read`` does."""
    return read(path, _METRICS)


def read_recognition(path: Path) -> dict[str, Any]:
    """How well a detector recognises the rendered people; raises UserError as ``step_files.read`` does."""
    return read(path, _RECOGNITION)
