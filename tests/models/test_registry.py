# SPDX-License-Identifier: Apache-2.0
"""The table of models answers what licences, weights and images ask; pre-flight checks are sentences."""

import os
import pickle
import re
from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.models.catalogue.preflight import attribute, import_upstream, loading, staged_weights, torch_device
from studiorecon.models.catalogue.registry import MODELS, cards_of_kind, find_card


@pytest.mark.parametrize("name", MODELS)
def test_every_model_states_terms_weights_and_runtime(name: str) -> None:
    entry = find_card(name)
    assert entry.name == name
    assert entry.title
    assert entry.runtime.image
    assert entry.memory.note
    assert entry.terms.code
    assert entry.terms.weights
    assert (entry.terms.commercial == "yes") == (not entry.terms.condition)
    assert entry.weights, "a network without weights is none"
    for file in entry.weights:
        assert not Path(file.path).is_absolute()
        assert "://" not in file.source + file.repository + "".join(file.mirrors)
        assert len(file.mirrors) == (2 if file.how == "mirrors" else 0), "one host may be gone"
        assert file.how == "hand" or file.remote, f"{file.path} has no name where it is fetched"
        assert (file.how in ("hub", "snapshot")) == bool(file.repository) or file.how == "hand"
        assert bool(re.fullmatch(r"[0-9a-f]{40}", file.revision)) == bool(file.repository), f"{file.path} may change"
        held = (64,) if file.mirrors or file.how == "package" else (0, 64) if file.repository else (0, 8)
        assert len(file.sha256) in held
    assert entry.unchecked


def test_what_forbids_commercial_use_names_what_does_instead() -> None:
    for entry in MODELS.values():
        alternative = entry.terms.alternative
        if alternative in MODELS:
            assert find_card(alternative).kind == entry.kind
            assert find_card(alternative).terms.commercial != "no"
    assert find_card("difix").terms.alternative == "fixer"
    assert [m.name for m in cards_of_kind("monocular depth")] == ["moge", "moge_vits", "moge_vitb"]


def test_a_missing_weight_is_named_with_its_source_and_found_once_it_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "HF_DATASETS_OFFLINE"):
        monkeypatch.setenv(variable, "0")
        monkeypatch.delenv(variable)
    with pytest.raises(
        UserError, match=r"pi3/model\.safetensors, which is missing: get it from Hugging Face yyfz233/Pi3"
    ):
        staged_weights(find_card("pi3"), tmp_path)
    with pytest.raises(UserError, match="request access"):
        staged_weights(find_card("sam3"), tmp_path)
    (tmp_path / "smpl").mkdir()
    (tmp_path / "smpl/SMPL_NEUTRAL.pkl").write_bytes(b"weights")
    assert staged_weights(find_card("smpl"), tmp_path) == tmp_path
    assert os.environ["HF_HUB_OFFLINE"] == "1", "a run fetches nothing silently"


def test_a_missing_package_names_image_and_pins_and_another_version_its_commit() -> None:
    with pytest.raises(UserError, match=r"cosmos_nowhere.*image gen3c.*torch 2\.6\.0.*megatron-core==0\.10\.0"):
        import_upstream(find_card("gen3c"), "cosmos_nowhere")
    with pytest.raises(UserError, match=r"has no Gen3cPipeline.*db2ffe1"):
        attribute(find_card("gen3c"), os, "Gen3cPipeline")


def test_no_gpu_is_a_sentence_with_the_remedy() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    assert torch_device(find_card("gen3c"), "cpu").type == "cpu"
    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(UserError, match=r"sees none here.*views\.synthesizer to warp"):
        torch_device(find_card("gen3c"), "cuda")


def test_a_checkpoint_that_would_run_code_is_a_sentence() -> None:
    refused = pytest.raises(UserError, match=r"x\.pt holds no weights of Fixer \(Unsupported global.*delete it")
    with refused, loading(find_card("fixer"), Path("x.pt")):
        raise pickle.UnpicklingError("Unsupported global: pathlib.Path\nmore")


def test_a_lack_of_memory_blames_no_weights() -> None:
    with pytest.raises(RuntimeError, match="out of memory"), loading(find_card("fixer"), Path("x.pt")):
        raise RuntimeError("CUDA out of memory. Tried to allocate 2.00 GiB")
