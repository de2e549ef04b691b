# SPDX-License-Identifier: Apache-2.0
"""``studiorecon demo --real``: a first look at a real take, which comes with the Python package Pose2Sim.

The take shows a person, so it is not part of this package: pip or uv fetches that one, and the take's files are kept.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from studiorecon.errors import UserError

TAKE = "treadmill"
_PACKAGE = "pose2sim==0.10.49"
_LICENCE = "pose2sim-0.10.49.dist-info/licenses/LICENSE"
# The take's files in the package and the SHA-256 of their bytes.
_FILES = {
    "videos/cam01.mp4": "cf4f2816c86bea4bfbea255333d8626ff32a3ecabdab8b0fb147cea9167fde3a",
    "videos/cam02.mp4": "94ff87cf978b8406e8aa36ab3c5362e72848994e87652f0dc7a33c315e8e0442",
    "videos/cam03.mp4": "b8b329f832f178f27ecb78d024d5026b96c6adb36c387bfe2c0af85eab8a11ca",
    "videos/cam04.mp4": "b5c0e7863fd70d008e7178d3c556b045b0ea5f78fcd61ca548a0b2e807e641f7",
    "calibration/Calib.qca.txt": "fd90e4bbae3278ef1dc0cdd42a34ee06bf88286f628a02c00a29407aa39e34c5",
}


def fetch_take(take: Path) -> None:
    """Make the folder ``take`` with the films of one man on a treadmill; one that holds ``videos/`` stays as it is.

    Raises UserError without a network or an installer, for other bytes than expected, and where ``take`` is in use.
    """
    if (take / "videos").is_dir():
        return
    if take.exists() or take.is_symlink():
        raise UserError(f"{take} is there already and holds no videos/; remove it, or name another folder")
    print(
        f"{take}: one man on a treadmill, four films of Pose2Sim (perfanalytics/pose2sim on GitHub, BSD 3-Clause); "
        "its package of 51 MB is fetched",
        flush=True,
    )
    take.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=take.parent, prefix=f".{take.name}-") as made:
        package, whole = Path(made) / "package", Path(made) / "take"
        _install(package)
        for name, expected in _FILES.items():
            file = package / "Pose2Sim/Demo_SinglePerson" / name
            if not file.is_file() or hashlib.sha256(file.read_bytes()).hexdigest() != expected:
                raise UserError(f"{_PACKAGE} came with another {name} than expected; look at your package mirror")
            (whole / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, whole / name)
        shutil.copyfile(package / _LICENCE, whole / "LICENSE")
        whole.rename(take)


def _install(folder: Path) -> None:
    """Install the package into ``folder`` with pip, or with uv, whose environments have no pip."""
    uv = os.environ.get("UV") or shutil.which("uv")
    pip = [sys.executable, "-m", "pip", "install", "--no-compile"]
    command = pip if importlib.util.find_spec("pip") or not uv else [uv, "pip", "install", "--python", sys.executable]
    command += ["--quiet", "--no-deps", "--only-binary", ":all:", "--target", str(folder), _PACKAGE]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        reason = (done.stderr.strip() or f"exit status {done.returncode}").splitlines()[-1].strip()
        raise UserError(
            f"{_PACKAGE} could not be fetched ({reason}); it needs pip or uv, and the network once. Otherwise copy "
            f"the folder {TAKE} from a machine that has it"
        )
