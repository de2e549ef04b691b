# SPDX-License-Identifier: Apache-2.0
"""Networks by kind and name: cards, settings, schema, README and Protocols say the same, and stages know no adapter."""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
import typing
from pathlib import Path

import pytest
import yaml
from studiorecon import code
from studiorecon.configuration.schema import find_schema
from studiorecon.models import loading
from studiorecon.models.catalogue.card import Card
from studiorecon.models.catalogue.registry import MODELS, adapter_module, cards_of_kind
from studiorecon.models.catalogue.selection import CHOICES, adapter_modules, select_networks
from studiorecon.models.loading import adapter, load
from studiorecon.stages import STAGES

from tests.models import networks_table

ROOT = Path(__file__).resolve().parents[2]
# What each overload of one kind promises: kind → Protocol.
PROMISED = {
    typing.get_args(hints["kind"])[0]: typing.get_args(hints["return"])[0]
    for hints in map(typing.get_type_hints, typing.get_overloads(adapter))
    if len(typing.get_args(hints["kind"])) == 1
}
LOADED = {
    typing.get_args(hints["kind"])[0]: hints["return"]
    for hints in map(typing.get_type_hints, typing.get_overloads(load))
}


@pytest.mark.parametrize("where", CHOICES)
def test_settings_and_schema_name_the_networks_that_have_a_card(where: str) -> None:
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    values = CHOICES[where].values
    assert find_schema(schema, where)["enum"] == list(values)
    for step in CHOICES[where].steps:
        hints = typing.get_type_hints(importlib.import_module(f"studiorecon.{step}").Settings)
        assert typing.get_args(hints[where.partition(".")[2]]) == values


def test_the_table_of_networks_is_the_cards() -> None:
    text = networks_table.PAGE.read_text(encoding="utf-8")
    assert text == networks_table.written(text), "run: python -m tests.models.networks_table"


def test_every_kind_that_is_loaded_has_a_protocol_and_networks() -> None:
    assert PROMISED == LOADED
    assert {kind for choice in CHOICES.values() for kind in choice.kinds} <= set(PROMISED)
    assert all(cards_of_kind(kind) for kind in PROMISED)


@pytest.mark.parametrize("name", [card.name for card in cards_of_kind(*PROMISED)])
def test_an_adapter_has_what_its_protocol_asks(name: str) -> None:
    protocol, made_by = PROMISED[MODELS[name].kind], adapter(MODELS[name].kind, name)
    assert list(inspect.signature(made_by).parameters)[:3] == ["card", "weights", "where"]
    for member in protocol.__annotations__:
        assert hasattr(made_by, member)
    for member, requested in inspect.getmembers(protocol, inspect.isfunction):
        if not member.startswith("_"):
            answers = getattr(made_by, member)
            assert list(inspect.signature(answers).parameters) == list(inspect.signature(requested).parameters)


def test_a_network_of_another_kind_or_name_is_not_loaded(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"RAFT.* is a network for flow, not for picture enhancer"):
        load("picture enhancer", "raft", tmp_path, "cpu", seed=0)
    with pytest.raises(KeyError, match="gen3c"):
        load("view synthesizer", "gen4c", tmp_path, "cpu")


@pytest.mark.parametrize(("device", "order"), [("cuda", ["claim", "upstream"]), ("auto", ["claim", "upstream"])])
def test_a_gpu_is_claimed_before_upstream_is_imported(
    device: str, order: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    done: list[str] = []

    class Upstream:
        def __init__(self, card: Card, weights: Path, where: str) -> None:
            assert (card.name, weights, where) == ("raft", tmp_path, device)
            done.append("upstream")

    monkeypatch.setattr(loading, "claim_gpu", lambda: done.append("claim"))
    monkeypatch.setattr(importlib.import_module("studiorecon.models.adapters.raft"), "ADAPTER", Upstream)
    load("flow", "raft", tmp_path, device)
    assert done == order


def test_a_cpu_claims_no_gpu(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(importlib.import_module("studiorecon.models.adapters.raft"), "ADAPTER", lambda *_: "network")
    monkeypatch.setattr(loading, "claim_gpu", lambda: pytest.fail("there is no GPU in this"))
    assert load("flow", "raft", tmp_path, "cpu") == "network"


def test_an_edited_adapter_reruns_the_steps_that_run_it_and_no_others() -> None:
    preset = yaml.safe_load((ROOT / "config/presets/networks.yaml").read_text())
    assert adapter_modules("masks.network", preset) == ["models.adapters.sam3"]
    assert adapter_modules("enhance.shot", preset) == ["models.adapters.difix", "models.adapters.raft"]
    assert adapter_modules("humans.canonical", {}) == ["models.adapters.lhm"]
    assert adapter_modules("depth.network", {"depth": {"source": "embedded"}}) == []
    assert adapter_modules("people.lift", {"depth": {"source": "moge"}}) == ["models.adapters.moge"]
    assert adapter_modules("report.page", preset) == sorted(
        {adapter_module(name) for _, name in select_networks(preset)}
    )
    without = code.digest("masks.network")
    assert code.digest("masks.network", ["models.adapters.sam3"]) != without
    # Nothing but the name leads there: else an edited adapter would rerun every step that runs some network.
    for choice in CHOICES.values():
        for step in choice.steps:
            assert not [name for name in code.dependencies([step]) if name.startswith("models.adapters.")]


def test_stages_know_kinds_and_not_adapters() -> None:
    for path in (path for stage in STAGES for path in (code.PACKAGE / stage).rglob("*.py")):
        known = {name for name in code.imports_of_file(path) if name.startswith("models.adapters.")}
        # LPIPS is read from a folder that its own settings name.
        assert known <= {"models.adapters.lpips"}, path


def test_cards_are_read_without_anything_heavy() -> None:
    heavy = {"torch", "torchvision", "cv2", "numba", "scipy", "kornia"}
    requested = f"import sys, studiorecon.models.choices; print(*({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", requested], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
