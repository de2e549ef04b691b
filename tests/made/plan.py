# SPDX-License-Identifier: Apache-2.0
"""What tests of plan and their neighbours share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.workflow.conftest import House


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The skeleton of a user's dataset: enough to plan with."""
    folder = tmp_path_factory.mktemp("capture")
    (folder / "videos").mkdir()
    for camera in ("left", "right", "back"):
        (folder / "videos" / f"{camera}.mp4").touch()
        (folder / "keypoints" / camera).mkdir(parents=True)
    for name in ("intri.yml", "extri.yml"):
        (folder / name).touch()
    return folder


def on(house: House, dataset: Path) -> House:
    return House(house.folder, str(dataset))
