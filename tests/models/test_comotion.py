# SPDX-License-Identifier: Apache-2.0
"""CoMotion's ends: planted bodies with the camera's own intrinsics, empty slots, and how sure a body is."""

from __future__ import annotations

import pickle
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.footage.video import to_bytes
from studiorecon.models import smpl
from studiorecon.models.adapters import comotion
from studiorecon.models.adapters.comotion import CARD, JOINTS, UNSEEN, estimate_frame, postprocess, preprocess
from studiorecon.models.loading import load

from tests.made.comotion import slots
from tests.made.networks import room_views, upstream_sources
from tests.made.smpl import write_smpl


def test_planted_bodies_come_out_and_empty_slots_do_not() -> None:
    planted = slots([3, 0, 1])
    found = postprocess(planted, np.empty((0, JOINTS, 2)), np.empty(0))
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
    found = postprocess(planted, seen, np.array([2.0]))
    # Naive: the logit itself, or the same for somebody who is only carried on behind a pillar.
    np.testing.assert_allclose(found.confidences, [UNSEEN, 1 / (1 + np.exp(-2.0))], atol=1e-6)
    assert postprocess(slots([0, 0]), seen, np.array([2.0])).tracks.size == 0


def test_what_upstream_gets_wrong_is_a_sentence(tmp_path: Path) -> None:
    planted = slots([1])
    with pytest.raises(UserError, match="as pose, expected"):
        postprocess({**planted, "pose": planted["pose"].reshape(1, 24, 3)}, np.empty((0, JOINTS, 2)), np.empty(0))
    with pytest.raises(UserError, match="returned nothing as trans"):
        postprocess({k: v for k, v in planted.items() if k != "trans"}, np.empty((0, JOINTS, 2)), np.empty(0))
    with pytest.raises(UserError, match="1 values of betas that are no numbers"):
        postprocess(
            {**planted, "betas": np.where(np.arange(10) == 3, np.nan, planted["betas"])},
            np.empty((0, JOINTS, 2)),
            np.empty(0),
        )
    with pytest.raises(UserError, match="comotion_detection_checkpoint"):
        load("body estimator", "comotion", tmp_path, "cpu")
    with pytest.raises(ValueError, match="expected uint8"):
        preprocess(np.zeros((4, 5, 3)), np.eye(3))


def test_the_network_is_given_the_cameras_own_intrinsics() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    camera = room_views((192, 108))[0][0]
    planted = slots([1, 0])
    requested = []

    def network(picture: object, intrinsics: object) -> tuple[dict, SimpleNamespace]:
        requested.append((tuple(picture.shape), picture.dtype, intrinsics.numpy()))
        state = {name: torch.from_numpy(values)[None] for name, values in planted.items()}
        state["id"] = state["id"][..., None]
        detections = {"pred_2d": torch.from_numpy(planted["pred_2d"][:1])[None], "conf": torch.full((1, 1, 1), 3.0)}
        return detections, SimpleNamespace(**state)

    found = postprocess(*estimate_frame(network, *preprocess(np.zeros((108, 192, 3), np.uint8), camera.intrinsics)))
    shape, kind, intrinsics = requested[0]
    assert shape == (3, 108, 192)
    assert kind == torch.uint8
    # Naive, as upstream's command line: a focal length of twice the longer side, and every depth with it.
    np.testing.assert_allclose(intrinsics, camera.intrinsics[:2], rtol=1e-6)
    assert found.confidences[0] == pytest.approx(0.9526, abs=1e-3)


def test_upstreams_clean_up_says_where_a_track_begins_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    camera = room_views((192, 108))[0][0]
    planted = slots([1, 2])
    given = {}

    def cleanup_tracks(preds: dict, intrinsics: object, decoder: object, min_matched_frames: int) -> dict:
        given.update(preds["tracks"], detections=len(preds["detections"]["conf"]), least=min_matched_frames)
        return {2: [1, 2]}

    def network(*_: object) -> tuple[dict, SimpleNamespace]:
        state = {name: torch.from_numpy(values)[None] for name, values in planted.items()}
        state["id"] = state["id"][..., None]
        detections = {"pred_2d": torch.from_numpy(planted["pred_2d"])[None], "conf": torch.full((1, 2, 1), 3.0)}
        return detections, SimpleNamespace(**state)

    network.init_tracks, network.smpl_decoder = lambda size: None, torch.nn.Identity()  # type: ignore[attr-defined]
    track = SimpleNamespace(cleanup_tracks=cleanup_tracks)
    monkeypatch.setattr(comotion, "import_upstream", lambda card, name: track)
    estimator = comotion.Comotion.__new__(comotion.Comotion)
    estimator._network = network
    frames = [np.zeros((108, 192, 3), np.uint8)] * 3
    found = list(estimator.bodies(frames, camera.intrinsics))
    assert [bodies.tracks.tolist() for bodies in found] == [[], [1], []]
    assert given["least"] == 1
    assert given["detections"] == 3
    assert [given[name].shape for name in ("id", "pose")] == [(1, 3, 2, 1), (1, 3, 2, 72)]
    assert list(estimator.bodies([], camera.intrinsics)) == []


def test_smpls_file_that_upstream_misses_at_import_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in CARD.weights:
        (tmp_path / "weights" / file.path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "weights" / file.path).write_bytes(b"x")
    package = tmp_path / "comotion_demo/models"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").touch()
    (package / "comotion.py").write_text("assert False, 'Please download the neutral SMPL body model'\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match=r"neutral SMPL body model\); link .*SMPL_NEUTRAL\.pkl to comotion_demo/data"):
        load("body estimator", "comotion", tmp_path / "weights", "cpu")
    for name in [name for name in sys.modules if name.partition(".")[0] == "comotion_demo"]:
        monkeypatch.delitem(sys.modules, name)


def test_smpls_file_is_read_without_running_what_it_names(tmp_path: Path) -> None:
    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"v_template": Path("x")}))
    with open(tmp_path / "evil.pkl", "rb") as stream, pytest.raises(UserError, match="asks for pathlib"):
        comotion._Arrays(tmp_path / "evil.pkl").load(stream, encoding="latin1")


@pytest.mark.weights
def test_upstreams_network_with_random_weights_follows_bodies(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Upstream's own code whole, from checkpoints and a body in SMPL's format: what it says is in our conventions."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    for package in ("pypose", "scenedetect", "tensordict", "timm", "einops"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    source = upstream_sources("apple+ml-comotion", "src")
    inner = Path(shutil.copytree(source / "comotion_demo", tmp_path / "src/comotion_demo"))
    monkeypatch.syspath_prepend(tmp_path / "src")
    # Its arrays are read by our own reader: of the package nothing but the class is asked for.
    monkeypatch.setitem(sys.modules, "chumpy", SimpleNamespace(ch=SimpleNamespace(Ch=type("Ch", (), {}))))
    weights = tmp_path / "weights"
    write_smpl(weights / "smpl/SMPL_NEUTRAL.pkl", BodyModel.load(root / "resources/body.npz"))
    (inner / "data/smpl/SMPL_NEUTRAL.pkl").symlink_to(weights / "smpl/SMPL_NEUTRAL.pkl")
    monkeypatch.setattr(comotion, "staged_weights", lambda _, folder: folder)  # these files are not what is published
    camera, rgb, _ = room_views((640, 360))[0]
    try:
        from comotion_demo.models.comotion import CoMotion

        torch.manual_seed(0)
        made = CoMotion(pretrained=False)
        # Bodies that a random refinement throws anywhere are no tracks: the last layers hardly move them.
        last = [made.update_step.get_pose_update, made.update_step.pose_decoder, made.detection_model.pose_decoder]
        for head in (*last, *made.detection_model.detection_head.decoders):
            for parameter in head[-1].parameters():
                parameter.data *= 0.05
        torch.save(made.detection_model.state_dict(), inner / "data/comotion_detection_checkpoint.pt")
        torch.save(made.update_step.state_dict(), inner / "data/comotion_refine_checkpoint.pt")
        del made
        estimator = load("body estimator", "comotion", weights, "cpu")
        found = list(estimator.bodies([to_bytes(rgb)] * 2, camera.intrinsics))
    finally:
        for name in [name for name in sys.modules if name.split(".")[0] == "comotion_demo"]:
            del sys.modules[name]
    assert len(found) == 2
    bodies = found[-1]
    assert len(bodies.tracks) > 0
    assert len(set(bodies.tracks)) == len(bodies.tracks)
    assert set(found[0].tracks) & set(bodies.tracks), "tracks go on"
    # Its points are those of its bodies through the camera that it was given.
    seen = bodies.pelvises_m @ camera.intrinsics.T
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], bodies.joints_px[:, 0], rtol=1e-3, atol=0.1)
    # And its bodies are SMPL's as we read them: pose, shape and place give the same pelvis.
    smpl.run(weights / "smpl/SMPL_NEUTRAL.pkl", tmp_path / "body.npz")
    model = BodyModel.load(tmp_path / "body.npz")
    for shape, pose, place, pelvis in zip(
        bodies.shapes, bodies.poses_rad, bodies.translations_m, bodies.pelvises_m, strict=True
    ):
        assert np.abs(model.rest_joints(shape)[0] + place - pelvis).max() < 2e-3
        assert np.isfinite(pose).all()
