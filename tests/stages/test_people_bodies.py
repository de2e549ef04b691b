# SPDX-License-Identifier: Apache-2.0
"""Detections from a network's bodies: points, poses and pelvis depth that the paper's association reads; files of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.images.video import write_lossless
from studiorecon.models import comotion
from studiorecon.models.protocols import Bodies
from studiorecon.people import bodies
from studiorecon.scene.capture import Footage, write_footage
from studiorecon.scene.people import read_detections
from studiorecon.settings import load

from tests.models.planted import room_views
from tests.models.test_comotion import slots

WH = (192, 108)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    camera = room_views(WH)[0][0]
    footage = Footage("cam1", False, WH, camera.intrinsics.tolist(), 24.0, 3, 0, "x", "", WH, 0, 0.0, [])
    write_footage(tmp_path / "cam1.json", footage)
    write_lossless(tmp_path / "cam1.mkv", np.zeros((3, *WH[::-1], 3), np.uint8), 24.0)
    return tmp_path


def run(folder: Path, settings: dict, given: list[Path]) -> object:
    values = load(bodies.Settings, settings, "people")
    bodies.run(values, "cam1", folder / "cam1.mkv", folder / "cam1.json", given, folder, "cpu", folder / "cam1.npz")
    return read_detections(folder / "cam1.npz")


def test_a_networks_bodies_become_detections(files: Path, default_settings: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    planted = slots([1, 2])

    class Planted:
        def __init__(self, weights: Path, where: str) -> None: ...

        def bodies(self, frames: Iterable[np.ndarray], intrinsics: np.ndarray) -> Iterator[Bodies]:
            assert intrinsics.shape == (3, 3)
            for _ in frames:
                yield comotion.post(planted, planted["pred_2d"], np.array([4.0, 4.0]))

    monkeypatch.setattr(bodies, "Comotion", Planted)
    found = run(files, default_settings("people", source="comotion"), [])
    assert found.layout == "comotion27"
    # The second stands two metres to the side, at least partly out of the picture: points out there are missing, not clipped.
    outside = (planted["pred_2d"] < 0).any(-1) | (planted["pred_2d"] > WH).any(-1)
    first = found.track == 0
    assert first.sum() == 3
    assert sorted(found.frame[first]) == [0, 1, 2]
    np.testing.assert_allclose(found.keypoints[first][0, ~outside[0], :2], planted["pred_2d"][0, ~outside[0]], atol=1e-4)
    assert not found.keypoints[first][0, outside[0], 2].any()
    np.testing.assert_allclose(found.pelvis[first][0], [*planted["pred_2d"][0, 0], planted["pred_3d"][0, 0, 2]], atol=1e-4)
    np.testing.assert_allclose(found.body_pose[first][0].ravel(), planted["pose"][0, 3:], atol=1e-6)


def rows(frames: list[int]) -> dict[str, np.ndarray]:
    planted = slots([1] * len(frames))
    planted["pred_2d"][:] = planted["pred_2d"][0]
    planted["pred_3d"][:] = planted["pred_3d"][0]
    return {**planted, "frame_idx": np.array(frames), "conf": np.full((len(frames), 1), 3.0)}


def test_files_of_its_rows_are_read(files: Path, default_settings: Callable) -> None:
    settings = default_settings("people", source="precomputed")
    np.savez(files / "given.npz", **rows([0, 2]))
    found = run(files, settings, [files / "given.npz"])
    assert found.frame.tolist() == [0, 2]
    assert found.keypoints[..., 2].max() == pytest.approx(0.9526, abs=1e-3)
    np.savez(files / "late.npz", **rows([0, 7]))
    with pytest.raises(Refusal, match="has bodies at frame 7, but 3 frames are in use"):
        run(files, settings, [files / "late.npz"])
    demo = {k: v for k, v in rows([0]).items() if not k.startswith("pred_")}
    np.savez(files / "demo.npz", **demo)
    with pytest.raises(Refusal, match="holds no pred_2d, pred_3d; write them too"):
        run(files, settings, [files / "demo.npz"])


def test_nobody_is_an_answer(
    files: Path, default_settings: Callable, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    class Blind:
        def __init__(self, *_: object) -> None: ...

        def bodies(self, frames: Iterable[np.ndarray], intrinsics: np.ndarray) -> Iterator[Bodies]:
            return (comotion.post(slots([0]), np.empty((0, 27, 2)), np.empty(0)) for _ in frames)

    monkeypatch.setattr(bodies, "Comotion", Blind)
    found = run(files, default_settings("people", source="comotion"), [])
    assert found.keypoints.shape == (0, 27, 3)
    assert "nobody in any of 3 frames" in capsys.readouterr().out
