# SPDX-License-Identifier: Apache-2.0
"""The table of models answers what licences, weights and images ask; pre-flight checks are sentences."""

import os
from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import Refusal
from studiorecon.models.preflight import attribute, device, finite, staged, upstream
from studiorecon.models.registry import MODELS, model, of_kind


@pytest.mark.parametrize("name", MODELS)
def test_every_model_states_terms_weights_and_runtime(name: str) -> None:
    entry = model(name)
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
        assert "://" not in file.source + file.repository
        assert file.how == "hand" or file.remote, f"{file.path} has no name where it is fetched"
        assert (file.how in ("hub", "snapshot")) == bool(file.repository) or file.how == "hand"


def test_what_forbids_commercial_use_names_what_does_instead() -> None:
    for entry in MODELS.values():
        alternative = entry.terms.alternative
        if alternative in MODELS:
            assert model(alternative).kind == entry.kind
            assert model(alternative).terms.commercial != "no"
    assert model("pi3").terms.alternative == "mapanything"
    assert model("difix").terms.alternative == "fixer"
    assert [m.name for m in of_kind("monocular depth")] == ["moge", "moge3"]


def test_an_unknown_model_lists_the_known() -> None:
    with pytest.raises(KeyError, match="gen3c"):
        model("gen4c")


def test_a_missing_weight_is_named_with_its_source_and_found_once_it_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "HF_DATASETS_OFFLINE"):
        monkeypatch.setenv(variable, "0")
        monkeypatch.delenv(variable)
    with pytest.raises(Refusal, match=r"pi3/model\.safetensors, which is missing: get it from Hugging Face yyfz233/Pi3"):
        staged("pi3", tmp_path)
    with pytest.raises(Refusal, match="access must be asked for"):
        staged("sam3", tmp_path)
    (tmp_path / "pi3").mkdir()
    (tmp_path / "pi3/model.safetensors").write_bytes(b"weights")
    assert staged("pi3", tmp_path) == tmp_path
    assert os.environ["HF_HUB_OFFLINE"] == "1", "a run fetches nothing silently"


def test_a_missing_package_names_image_and_pins_and_another_version_its_commit() -> None:
    with pytest.raises(Refusal, match=r"cosmos_nowhere.*image gen3c.*torch 2\.6\.0.*megatron-core==0\.10\.0"):
        upstream("gen3c", "cosmos_nowhere")
    with pytest.raises(Refusal, match=r"has no Gen3cPipeline.*db2ffe1"):
        attribute("gen3c", os, "Gen3cPipeline")


def test_no_gpu_is_a_sentence_with_the_remedy() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    assert device("gen3c", "cpu", "x").type == "cpu"
    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(Refusal, match=r"sees none here.*set views\.synthesizer to warp"):
        device("gen3c", "cuda", "set views.synthesizer to warp")


def test_numbers_that_are_none_are_refused() -> None:
    with pytest.raises(Refusal, match="Pi3 returned 2 values of poses"):
        finite("pi3", "poses", np.array([1.0, np.nan, np.inf]))
    assert finite("pi3", "poses", np.ones(2)).sum() == 2
