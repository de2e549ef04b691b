# SPDX-License-Identifier: Apache-2.0
"""Weights: listed, fetched by stand-ins of the ordinary clients, pinned, verified, and held against what was
verified."""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models import weights
from studiorecon.models.catalogue.card import WeightFile
from studiorecon.models.catalogue.checksums import PINS, digest, read_pins, verify
from studiorecon.models.catalogue.fetching import fetch
from studiorecon.models.catalogue.pickles import require_safe_pickles
from studiorecon.models.catalogue.preflight import staged_weights
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.sandbox import ARRAYS_ONLY, OFFLINE, confine_process
from studiorecon.models.catalogue.selection import check_licences, licence_rows, select_networks


class Hub(ModuleType):
    """Stands in for huggingface_hub: a shelf of files, and what was asked of it."""

    def __init__(self, shelf: dict[str, bytes], stated: str | None = None) -> None:
        super().__init__("huggingface_hub")
        self.shelf, self.stated, self.requested = shelf, stated, []

    def hf_hub_download(self, repository: str, name: str, revision: str, local_dir: str) -> str:
        assert len(revision) == 40
        assert not any(os.environ.get(v) == "1" for v in OFFLINE), "the hub's client would refuse"
        self.requested.append((repository, name))
        if name not in self.shelf:
            raise OSError("401 Client Error: gated\nmore")
        path = Path(local_dir) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.shelf[name])
        return str(path)

    def snapshot_download(self, repository: str, revision: str, local_dir: str) -> None:
        for name in self.shelf:
            self.hf_hub_download(repository, name, revision, local_dir)

    def hf_hub_url(self, repository: str, name: str, revision: str) -> str:
        return name

    def HfApi(self) -> Hub:
        return self

    def model_info(self, repository: str, revision: str, files_metadata: bool) -> SimpleNamespace:
        return SimpleNamespace(siblings=[])

    def get_hf_file_metadata(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(etag=self.stated or hashlib.sha256(self.shelf[name]).hexdigest())


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in OFFLINE:
        monkeypatch.setenv(variable, "1")


def test_what_may_be_fetched_is_fetched_verified_and_pinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    hub = Hub({file.remote: b"fixer" for file in MODELS["fixer"].weights})
    monkeypatch.setitem(sys.modules, "huggingface_hub", hub)
    weights.run(["fixer"], tmp_path, "no")
    assert "MISSING" in capsys.readouterr().out
    assert not hub.requested, "a listing fetches nothing"
    weights.run(["fixer"], tmp_path, "yes")
    file = tmp_path / "fixer/base/tokenizer_fast.pth"
    assert file.read_bytes() == b"fixer"
    assert read_pins(tmp_path)["fixer/base/tokenizer_fast.pth"]["sha256"] == hashlib.sha256(b"fixer").hexdigest()
    weights.run(["fixer"], tmp_path, "yes")
    assert len(hub.requested) == len(hub.shelf)
    assert staged_weights(MODELS["fixer"], tmp_path) == tmp_path
    file.write_bytes(b"faked")
    with pytest.raises(UserError, match=r"has SHA-256 .*delete it and get it again"):
        staged_weights(MODELS["fixer"], tmp_path)
    with pytest.raises(UserError, match="1 of the files are missing or wrong"):
        weights.run(["fixer"], tmp_path, "yes")


def test_a_file_may_have_another_name_here_than_at_its_hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({"model.pt": b"moge"}))
    (wanted,) = MODELS["moge"].weights
    fetch(wanted, tmp_path)
    assert [p.name for p in (tmp_path / "moge").iterdir()] == [Path(wanted.path).name]
    # What its card says of it counts more than what the hub says of itself.
    with pytest.raises(UserError, match="expected 280741fd09bc"):
        staged_weights(MODELS["moge"], tmp_path)


def test_what_was_put_there_by_hand_is_held_to_what_it_was(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for file in MODELS["comotion"].weights:
        (tmp_path / file.path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file.path).write_bytes(b"by hand")
    staged_weights(MODELS["comotion"], tmp_path)
    assert "its checksum is recorded" in capsys.readouterr().out
    (tmp_path / "smpl/SMPL_NEUTRAL.pkl").write_bytes(b"another")
    with pytest.raises(UserError, match=r"SMPL_NEUTRAL\.pkl has SHA-256"):
        staged_weights(MODELS["comotion"], tmp_path)


def test_no_room_is_known_before_anything_is_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1_000_000_000))
    hub = Hub({})
    monkeypatch.setitem(sys.modules, "huggingface_hub", hub)
    with pytest.raises(UserError, match=r"has 3\.83 GB and .* has room for 1\.0; make room"):
        fetch(MODELS["pi3"].weights[0], tmp_path)
    assert not hub.requested


def test_a_run_is_asked_to_make_arrays_of_checkpoints_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    for variable in ARRAYS_ONLY:
        monkeypatch.setenv(variable, "0")
    confine_process()
    torch.save({"weights": torch.ones(2)}, tmp_path / "good.pt")
    torch.save({"code": Path("x")}, tmp_path / "bad.pt")
    # As GEN3C and Fixer ask for it.
    assert torch.load(tmp_path / "good.pt", weights_only=False)["weights"].sum() == 2
    with pytest.raises(Exception, match=r"pathlib"):
        torch.load(tmp_path / "bad.pt", weights_only=False)


def test_bodies_that_would_run_code_are_refused_before_upstream_unpickles_them(tmp_path: Path) -> None:
    np.savez(tmp_path / "plain.npz", vertices=np.ones(3), names=np.array([None, np.ones(2)], dtype=object))
    (tmp_path / "hands.pkl").write_bytes(pickle.dumps({"left": np.arange(3)}))
    require_safe_pickles(sorted(tmp_path.iterdir()))
    np.savez(tmp_path / "evil.npz", code=np.array([Path("x"), 1], dtype=object))
    with pytest.raises(UserError, match=r"evil\.npz is no file of plain or chumpy arrays .*asks for pathlib"):
        require_safe_pickles(sorted(tmp_path.iterdir()))


def test_a_snapshot_brings_small_files_along_and_a_wrong_body_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f.remote for f in MODELS["difix"].weights] + ["unet/code.py"]
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub(dict.fromkeys(names, b"x")))
    weights.run(["difix"], tmp_path, "yes")
    assert (tmp_path / "difix/difix_ref/unet/code.py").is_file()
    assert staged_weights(MODELS["difix"], tmp_path) == tmp_path
    # Its client runs what lies there: code that is not what was fetched, or was not fetched at all, is refused.
    (tmp_path / "difix/difix_ref/unet/code.py").write_bytes(b"another")
    with pytest.raises(UserError, match=r"unet/code\.py has SHA-256 .*delete it and get it again"):
        staged_weights(MODELS["difix"], tmp_path)
    (tmp_path / "difix/difix_ref/unet/code.py").write_bytes(b"x")
    (tmp_path / "difix/difix_ref/vae/more.py").write_bytes(b"y")
    with pytest.raises(UserError, match=r"vae/more\.py is code that Difix3D\+ .* would run"):
        staged_weights(MODELS["difix"], tmp_path)
    for stated in ("0" * 64, "0" * 40):
        monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({"model.safetensors": b"x"}, stated=stated))
        (tmp_path / "pi3/model.safetensors").unlink(missing_ok=True)
        with pytest.raises(UserError, match=r"is not what .* has|expected 33580e4702ac"):
            weights.run(["pi3"], tmp_path, "yes")
        assert "pi3/model.safetensors" not in read_pins(tmp_path)


def test_gates_and_missing_clients_are_sentences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({}))
    with pytest.raises(
        UserError, match=r"5 of the files.*could not be fetched.*401 Client Error: gated\); agree to its terms there"
    ):
        weights.run(["sam3"], tmp_path, "yes")
    with pytest.raises(UserError, match="cannot be fetched by a program: get it from SMPL"):
        weights.run(["smpl"], tmp_path, "yes")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(UserError, match="package huggingface_hub is needed"):
        weights.run(["moge"], tmp_path, "yes")


def test_files_of_packages_and_of_torchvision_come_through_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = tmp_path / "lpips/weights/v0.1"
    inner.mkdir(parents=True)
    (inner / "vgg.pth").write_bytes(b"heads")
    package = ModuleType("lpips")
    package.__file__ = str(tmp_path / "lpips/__init__.py")
    monkeypatch.setitem(sys.modules, "lpips", package)
    heads = next(f for f in MODELS["lpips"].weights if f.how == "package")
    fetch(heads, tmp_path / "w")
    assert (tmp_path / "w" / heads.path).read_bytes() == b"heads"

    flows = ModuleType("torchvision.models.optical_flow")
    flows.Raft_Large_Weights = SimpleNamespace(C_T_SKHT_V2=SimpleNamespace(url="there"))
    client = ModuleType("torch.hub")

    def download_url_to_file(address: str, place: str, hash_prefix: str, progress: bool) -> None:
        assert (address, hash_prefix) == ("there", "ff5fadd5")
        Path(place).write_bytes(b"flow")

    client.download_url_to_file = download_url_to_file
    monkeypatch.setitem(sys.modules, "torchvision.models.optical_flow", flows)
    monkeypatch.setitem(sys.modules, "torch.hub", client)
    (raft,) = MODELS["raft"].weights
    fetch(raft, tmp_path / "w")
    assert (tmp_path / "w" / raft.path).read_bytes() == b"flow"
    # The published first digits of the checksum are believed more than the client.
    with pytest.raises(UserError, match="expected ff5fadd5"):
        verify(tmp_path / "w", raft, {})


def test_published_checksums_count(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    right = WeightFile(
        "a", "nowhere", sha256=digest(tmp_path / "a")[:8], md5=hashlib.md5(b"abc").hexdigest(), how="hand"
    )
    assert verify(tmp_path, right, {})["bytes"] == 3
    with pytest.raises(UserError, match="another MD5"):
        verify(tmp_path, WeightFile("a", "nowhere", md5="0" * 32, how="hand"), {})
    (tmp_path / PINS).write_text("{")
    with pytest.raises(UserError, match=r"checksums\.json is not readable"):
        read_pins(tmp_path)


def test_a_configuration_says_which_networks_it_uses_and_commerce_refuses_some() -> None:
    config = {
        "licences": "any",
        "body": "resources/weights/smpl/SMPL_NEUTRAL.pkl",
        "depth": {"source": "pi3"},
        "masks": {"source": "embedded"},
        "enhance": {"enhancer": "residual", "flow": "raft"},
        "background": {"training": {"lpips": {"weight": 0.1}}},
    }
    assert select_networks(config) == [
        ("depth.source", "pi3"),
        ("enhance.flow", "raft"),
        ("background.training.lpips.weight", "lpips"),
        ("body", "smpl"),
    ]
    check_licences(config)
    with pytest.raises(UserError, match=r"depth\.source is pi3.*set it to the stage's own"):
        check_licences({**config, "licences": "commercial"})
    with pytest.raises(UserError, match=r"body is smpl.*the bundled body"):
        check_licences({**config, "licences": "commercial", "depth": {"source": "moge"}})
    rows = licence_rows(config)
    assert [r["commercial"] for r in rows] == ["no", "yes", "yes", "no"]
    assert rows[0]["weights"] == "CC BY-NC 4.0"
