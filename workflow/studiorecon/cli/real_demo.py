# SPDX-License-Identifier: Apache-2.0
"""``studiorecon demo --real``: a first look at a real take that Pose2Sim publishes (BSD 3-Clause, 4 MB of films).

It shows a person, so it is not part of this package: the user brings it, and it is read where it lies.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import yaml

from studiorecon.errors import UserError
from studiorecon.plan.discovery import find_calibration
from studiorecon.scene.files import write_text

# Where the take of one man on a treadmill is: in Pose2Sim's repository, in what it copies for a user, and alone.
_PLACES = (
    "",
    "Pose2Sim/Demo_SinglePerson",
    "Demo_SinglePerson",
    "pose2sim_balancing/single",
    "single",
)


def find_real_take(given: str) -> Path:
    """The folder of the take in ``given``, or by default in ``STUDIORECON_REAL_DATA``; UserError says how to get it."""
    place = given or os.environ.get("STUDIORECON_REAL_DATA")
    for name in _PLACES if place else ():
        if (Path(str(place)) / name / "videos").is_dir():
            return Path(str(place)) / name
    raise UserError(
        f"the real take is not {f'in {place}' if place else 'named'}; it is Pose2Sim/Demo_SinglePerson of the "
        "repository perfanalytics/pose2sim on GitHub (BSD 3-Clause): clone that, then: studiorecon demo --real pose2sim"
    )


def settings_of(take: Path, results: Path = Path("results")) -> Iterator[str]:
    """Settings for the take: the scene's name, and a calibration that lies outside of its folder."""
    yield "scene=real"
    beside = take.resolve().parent / "calibration"
    if not find_calibration(take) and beside.is_dir() and (files := find_calibration(beside)):
        described = {"calibration": [os.path.relpath(file, take.resolve()) for file in files]}
        write_text(results / "real/capture.yaml", yaml.safe_dump(described))
        yield f"capture_yaml={results / 'real/capture.yaml'}"
