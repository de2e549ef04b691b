# SPDX-License-Identifier: Apache-2.0
"""A configuration and the skeleton of a dataset: enough to plan with."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
_DEFAULTS = yaml.safe_load((ROOT / "config/config.yaml").read_text(encoding="utf-8"))


@pytest.fixture
def home() -> Path:
    return ROOT


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Three cameras with footage, keypoints and a calibration."""
    folder = tmp_path / "capture"
    (folder / "videos").mkdir(parents=True)
    for camera in ("left", "right", "back"):
        (folder / "videos" / f"{camera}.mp4").touch()
        (folder / "keypoints" / camera).mkdir(parents=True)
    for name in ("intri.yml", "extri.yml"):
        (folder / name).touch()
    return folder


@pytest.fixture
def configured(capture: Path) -> Callable[..., dict[str, Any]]:
    """The default configuration of that dataset; sections are changed by keyword, their settings by mapping."""

    def make(**changes: Any) -> dict[str, Any]:
        config = copy.deepcopy(_DEFAULTS) | {"dataset": str(capture)}
        for name, value in changes.items():
            config[name] = {**config[name], **value} if isinstance(value, dict) else value
        return config

    return make
