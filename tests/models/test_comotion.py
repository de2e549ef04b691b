# SPDX-License-Identifier: Apache-2.0
"""CoMotion's ends: planted bodies with the camera's own intrinsics, empty slots, and how sure a body is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.models.comotion import JOINTS, UNSEEN, Comotion, estimated, post, pre

from tests.models.planted import room_views


def slots(ids: list[int], seed: int = 0) -> dict[str, np.ndarray]:
    """Track slots with people two metres apart in a camera's frame, seen by the first camera of the made room."""
    camera = room_views((192, 108))[0][0]
    rng = np.random.default_rng(seed)
    count = len(ids)
    joints = rng.normal(0, 0.25, (count, JOINTS, 3)) + np.array([0, 0, 5.0]) + 2.0 * np.arange(count)[:, None, None] * np.array([1, 0, 0])
    pixels = joints @ camera.intrinsics.T
    return {
        "id": np.array(ids, np.float32),
        "pose": rng.normal(0, 0.2, (count, 72)).astype(np.float32),
        "betas": rng.normal(0, 1, (count, 10)).astype(np.float32),
        "trans": rng.normal(0, 1, (count, 3)).astype(np.float32),
        "pred_3d": joints.astype(np.float32),
        "pred_2d": (pixels[..., :2] / pixels[..., 2:]).astype(np.float32),
    }


def test_planted_bodies_come_out_and_empty_slots_do_not() -> None:
    planted = slots([3, 0, 1])
    found = post(planted, np.empty((0, JOINTS, 2)), np.empty(0))
    assert found.tracks.tolist() == [2, 0], "upstream counts from 1, 0 is an empty slot"
    np.testing.assert_allclose(found.poses_rad[:, 0], planted["pose"][[0, 2], :3], atol=1e-6)
    np.testing.assert_allclose(found.poses_rad[1].ravel(), planted["pose"][2], atol=1e-6)
    np.testing.assert_allclose(found.pelvises_m, planted["pred_3d"][[0, 2], 0], atol=1e-6)
    assert not np.allclose(found.pelvises_m, found.translations_m), "SMPL's translation is not where the pelvis is"
    np.testing.assert_allclose(found.joints_px, planted["pred_2d"][[0, 2]], atol=1e-5)
    assert (found.confidences == UNSEEN).all()


def test_a_body_is_as_sure_as_the_detection_it_lies_on() -> None:
    planted = slots([1, 2])
    seen = planted["pred_2d"][[1]] + 1.0
    found = post(planted, seen, np.array([2.0]))
    # Naive: the logit itself, or the same for somebody who is only carried on behind a pillar.
    np.testing.assert_allclose(found.confidences, [UNSEEN, 1 / (1 + np.exp(-2.0))], atol=1e-6)
    assert post(slots([0, 0]), seen, np.array([2.0])).tracks.size == 0


def test_what_upstream_gets_wrong_is_a_sentence(tmp_path: Path) -> None:
    planted = slots([1])
    with pytest.raises(Refusal, match="as pose, expected"):
        post({**planted, "pose": planted["pose"].reshape(1, 24, 3)}, np.empty((0, JOINTS, 2)), np.empty(0))
    with pytest.raises(Refusal, match="hold nothing as trans"):
        post({k: v for k, v in planted.items() if k != "trans"}, np.empty((0, JOINTS, 2)), np.empty(0))
    with pytest.raises(Refusal, match="1 values of betas that are no numbers"):
        post({**planted, "betas": np.where(np.arange(10) == 3, np.nan, planted["betas"])}, np.empty((0, JOINTS, 2)), np.empty(0))
    with pytest.raises(Refusal, match="comotion_detection_checkpoint"):
        Comotion(tmp_path, "cpu")
    with pytest.raises(ValueError, match="expected uint8"):
        pre(np.zeros((4, 5, 3)), np.eye(3))


def test_the_network_is_given_the_cameras_own_intrinsics() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    camera = room_views((192, 108))[0][0]
    planted = slots([1, 0])
    asked = []

    def network(picture: object, intrinsics: object) -> tuple[dict, SimpleNamespace]:
        asked.append((tuple(picture.shape), picture.dtype, intrinsics.numpy()))
        state = {name: torch.from_numpy(values)[None] for name, values in planted.items()}
        state["id"] = state["id"][..., None]
        detections = {"pred_2d": torch.from_numpy(planted["pred_2d"][:1])[None], "conf": torch.full((1, 1, 1), 3.0)}
        return detections, SimpleNamespace(**state)

    found = post(*estimated(network, *pre(np.zeros((108, 192, 3), np.uint8), camera.intrinsics)))
    shape, kind, intrinsics = asked[0]
    assert shape == (3, 108, 192)
    assert kind == torch.uint8
    # Naive, as upstream's command line: a focal length of twice the longer side, and every depth with it.
    np.testing.assert_allclose(intrinsics, camera.intrinsics[:2], rtol=1e-6)
    assert found.confidences[0] == pytest.approx(0.9526, abs=1e-3)
