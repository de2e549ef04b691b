# SPDX-License-Identifier: Apache-2.0
"""Detections from a network's bodies: points, poses and pelvis depth that the paper's association reads; files of
them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.errors import UserError
from studiorecon.footage.video import write_lossless
from studiorecon.keypoints.resampling import at_working_moments
from studiorecon.models.adapters import comotion
from studiorecon.models.protocols import Bodies
from studiorecon.scene.capture import Footage, write_footage
from studiorecon.scene.clocks import Clock, Clocks, write_clocks
from studiorecon.scene.people import Detections, read_detections
from studiorecon.tracks import bodies

from tests.made.comotion import slots
from tests.made.networks import room_views

WH = (192, 108)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    camera = room_views(WH)[0][0]
    footage = Footage("cam1", False, WH, camera.intrinsics.tolist(), 24.0, 3, 0, "x", "", WH, 0, 0.0, [])
    write_footage(tmp_path / "cam1.json", footage)
    write_clocks(tmp_path / "clocks.json", Clocks(24.0, 0.0, 3, (Clock("cam1", 24.0, 3),)))
    write_lossless(tmp_path / "cam1.mkv", np.zeros((3, *WH[::-1], 3), np.uint8), 24.0)
    return tmp_path


def run(folder: Path, settings: dict, given: list[Path]) -> object:
    values = load(bodies.Settings, settings, "people")
    about = folder / "cam1.mkv", folder / "cam1.json", folder / "clocks.json"
    bodies.run(values, "cam1", *about, given, folder, "cpu", folder / "cam1.npz")
    return read_detections(folder / "cam1.npz")


def test_a_networks_bodies_become_detections(
    files: Path, default_settings: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    planted = slots([1, 2])

    class Planted(comotion.Comotion):
        def __init__(self, *_: object) -> None: ...

        def bodies(self, frames: Iterable[np.ndarray], intrinsics: np.ndarray) -> Iterator[Bodies]:
            assert intrinsics.shape == (3, 3)
            for _ in frames:
                yield comotion.postprocess(planted, planted["pred_2d"], np.array([4.0, 4.0]))

    monkeypatch.setattr(comotion, "ADAPTER", Planted)
    found = run(files, default_settings("tracks", source="comotion"), [])
    assert found.layout == "comotion27"
    # The second stands two metres to the side, at least partly out of the picture: points out there are missing, not
    # clipped.
    outside = (planted["pred_2d"] < 0).any(-1) | (planted["pred_2d"] > WH).any(-1)
    first = found.track == 0
    assert first.sum() == 3
    assert sorted(found.frame[first]) == [0, 1, 2]
    np.testing.assert_allclose(
        found.keypoints[first][0, ~outside[0], :2], planted["pred_2d"][0, ~outside[0]], atol=1e-4
    )
    assert not found.keypoints[first][0, outside[0], 2].any()
    np.testing.assert_allclose(
        found.pelvis[first][0], [*planted["pred_2d"][0, 0], planted["pred_3d"][0, 0, 2]], atol=1e-4
    )
    np.testing.assert_allclose(found.body_pose[first][0].ravel(), planted["pose"][0, 3:], atol=1e-6)


def test_bodies_of_pictures_that_come_late_are_moved_to_the_moment() -> None:
    """A camera 0.4 frames late sees somebody who goes 10 px a frame 4 px further on than they are at the moment."""
    frames = 6
    clocks = Clocks(24.0, 0.0, frames, (Clock("cam1", 24.0, frames, offset_s=0.4 / 24),))
    late = np.arange(frames) + clocks.late_frames("cam1")
    place = np.stack([100 + 10 * late, np.full(frames, 50.0), np.full(frames, 0.9)], axis=-1)
    keypoints = np.repeat(place[:, None], 27, axis=1)
    seen = Detections("cam1", "comotion27", np.arange(frames), np.zeros(frames, int), keypoints)
    moved = at_working_moments(seen, clocks, 108)
    np.testing.assert_allclose(moved.keypoints[1:, 0, 0], 100 + 10 * np.arange(1, frames), atol=1e-6)
    in_step = Clocks(24.0, 0.0, frames, (Clock("cam1", 24.0, frames),))
    assert at_working_moments(seen, in_step, 108) is seen


def rows(frames: list[int]) -> dict[str, np.ndarray]:
    planted = slots([1] * len(frames))
    planted["pred_2d"][:] = planted["pred_2d"][0]
    planted["pred_3d"][:] = planted["pred_3d"][0]
    return {**planted, "frame_idx": np.array(frames), "conf": np.full((len(frames), 1), 3.0)}


def test_files_of_its_rows_are_read(files: Path, default_settings: Callable) -> None:
    settings = default_settings("tracks", source="precomputed")
    np.savez(files / "given.npz", **rows([0, 2]))
    found = run(files, settings, [files / "given.npz"])
    assert found.frame.tolist() == [0, 2]
    assert found.keypoints[..., 2].max() == pytest.approx(0.9526, abs=1e-3)
    np.savez(files / "late.npz", **rows([0, 7]))
    with pytest.raises(UserError, match="has bodies at frame 7, but 3 frames are in use"):
        run(files, settings, [files / "late.npz"])
    demo = {k: v for k, v in rows([0]).items() if not k.startswith("pred_")}
    np.savez(files / "demo.npz", **demo)
    with pytest.raises(UserError, match="holds no pred_2d, pred_3d; write them too"):
        run(files, settings, [files / "demo.npz"])


def test_nobody_is_an_answer(
    files: Path, default_settings: Callable, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    class Blind(comotion.Comotion):
        def __init__(self, *_: object) -> None: ...

        def bodies(self, frames: Iterable[np.ndarray], intrinsics: np.ndarray) -> Iterator[Bodies]:
            return (comotion.postprocess(slots([0]), np.empty((0, 27, 2)), np.empty(0)) for _ in frames)

    monkeypatch.setattr(comotion, "ADAPTER", Blind)
    found = run(files, default_settings("tracks", source="comotion"), [])
    assert found.keypoints.shape == (0, 27, 3)
    assert "no person in 3 frames" in capsys.readouterr().out
