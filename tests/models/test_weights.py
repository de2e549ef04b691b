# SPDX-License-Identifier: Apache-2.0
"""Weights: listed, fetched by stand-ins of the ordinary clients, pinned, verified, and held against what was verified."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from studiorecon.errors import Refusal
from studiorecon.models import weights
from studiorecon.models.card import WeightFile
from studiorecon.models.checksums import PINS, digest, read_pins, verified
from studiorecon.models.fetching import fetch
from studiorecon.models.offline import OFFLINE
from studiorecon.models.preflight import staged
from studiorecon.models.registry import MODELS
from studiorecon.models.selection import check_licences, licence_rows, selected


class Hub(ModuleType):
    """Stands in for huggingface_hub: a shelf of files, and what was asked of it."""

    def __init__(self, shelf: dict[str, bytes], stated: str | None = None) -> None:
        super().__init__("huggingface_hub")
        self.shelf, self.stated, self.asked = shelf, stated, []

    def hf_hub_download(self, repository: str, name: str, local_dir: str) -> str:
        assert not any(os.environ.get(v) == "1" for v in OFFLINE), "the hub's client would refuse"
        self.asked.append((repository, name))
        if name not in self.shelf:
            raise OSError("401 Client Error: gated\nmore")
        path = Path(local_dir) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.shelf[name])
        return str(path)

    def snapshot_download(self, repository: str, local_dir: str) -> None:
        for name in self.shelf:
            self.hf_hub_download(repository, name, local_dir)

    def hf_hub_url(self, repository: str, name: str) -> str:
        return name

    def get_hf_file_metadata(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(etag=self.stated or hashlib.sha256(self.shelf[name]).hexdigest())


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in OFFLINE:
        monkeypatch.setenv(variable, "1")


def test_what_may_be_fetched_is_fetched_verified_and_pinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    hub = Hub({"model.pt": b"moge"})
    monkeypatch.setitem(sys.modules, "huggingface_hub", hub)
    weights.run(["moge"], tmp_path, "no")
    assert "MISSING" in capsys.readouterr().out
    assert not hub.asked, "a listing fetches nothing"
    weights.run(["moge"], tmp_path, "yes")
    file = tmp_path / "moge/moge-2-vitl-normal.pt"
    assert file.read_bytes() == b"moge"
    assert [p.name for p in file.parent.iterdir()] == [file.name]
    assert read_pins(tmp_path)["moge/moge-2-vitl-normal.pt"]["sha256"] == hashlib.sha256(b"moge").hexdigest()
    weights.run(["moge"], tmp_path, "yes")
    assert len(hub.asked) == 1
    assert staged("moge", tmp_path) == tmp_path
    file.write_bytes(b"fake")
    with pytest.raises(Refusal, match=r"has SHA-256 .*delete it and get it again"):
        staged("moge", tmp_path)
    with pytest.raises(Refusal, match="1 of the files are not in place"):
        weights.run(["moge"], tmp_path, "yes")


def test_a_snapshot_brings_small_files_along_and_a_wrong_body_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f.remote for f in MODELS["difix"].weights] + ["unet/code.py"]
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub(dict.fromkeys(names, b"x")))
    weights.run(["difix"], tmp_path, "yes")
    assert (tmp_path / "difix/difix_ref/unet/code.py").is_file()
    assert staged("difix", tmp_path) == tmp_path
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({"model.safetensors": b"x"}, stated="0" * 64))
    with pytest.raises(Refusal, match="is not what its publisher has"):
        weights.run(["pi3"], tmp_path, "yes")
    assert "pi3/model.safetensors" not in read_pins(tmp_path)


def test_gates_and_missing_clients_are_sentences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({}))
    with pytest.raises(Refusal, match=r"5 of the files.*could not be fetched.*401 Client Error: gated\); ask for access there"):
        weights.run(["sam3"], tmp_path, "yes")
    with pytest.raises(Refusal, match="cannot be fetched by a program: get it from SMPL"):
        weights.run(["smpl"], tmp_path, "yes")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(Refusal, match="package huggingface_hub is needed"):
        weights.run(["moge"], tmp_path, "yes")


def test_files_of_packages_and_of_torchvision_come_through_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    with pytest.raises(Refusal, match="expected ff5fadd5"):
        verified(tmp_path / "w", raft, {})


def test_published_checksums_count(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    right = WeightFile("a", "nowhere", sha256=digest(tmp_path / "a")[:8], md5=hashlib.md5(b"abc").hexdigest(), how="hand")
    assert verified(tmp_path, right, {})["bytes"] == 3
    with pytest.raises(Refusal, match="another MD5"):
        verified(tmp_path, WeightFile("a", "nowhere", md5="0" * 32, how="hand"), {})
    (tmp_path / PINS).write_text("{")
    with pytest.raises(Refusal, match=r"checksums\.json is not readable"):
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
    assert selected(config) == [
        ("depth.source", "pi3"),
        ("enhance.flow", "raft"),
        ("background.training.lpips.weight", "lpips"),
        ("body", "smpl"),
    ]
    check_licences(config)
    with pytest.raises(Refusal, match=r"depth\.source is pi3.*set it to mapanything"):
        check_licences({**config, "licences": "commercial"})
    with pytest.raises(Refusal, match=r"body is smpl.*the bundled body"):
        check_licences({**config, "licences": "commercial", "depth": {"source": "mapanything"}})
    rows = licence_rows(config)
    assert [r["commercial"] for r in rows] == ["no", "yes", "yes", "no"]
    assert rows[0]["weights"] == "CC BY-NC 4.0"
