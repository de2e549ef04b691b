# SPDX-License-Identifier: Apache-2.0
"""MapAnything: confidence that can be doubted, and an encoder that nothing is fetched for."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.adapters import mapanything
from studiorecon.models.adapters.mapanything import CARD, encoder_from, infer
from studiorecon.models.adapters.pi3 import CONFIDENT
from studiorecon.models.loading import load

torch = pytest.importorskip("torch", reason="torch is not installed")
CODE = """
def tiny(pretrained=True, width=3):
    import torch
    assert not pretrained, "weights would be fetched"
    return torch.nn.Linear(width, width)
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout as torch's hub reads it."""
    (tmp_path / "dino/dinov2").mkdir(parents=True)
    (tmp_path / "dino/dinov2/__init__.py").touch()
    (tmp_path / "dino/hubconf.py").write_text(CODE)
    return tmp_path / "dino"


def test_confidence_is_a_probability_below_a_half_too(monkeypatch: pytest.MonkeyPatch) -> None:
    image = ModuleType("mapanything.utils.image")
    image.preprocess_inputs = lambda views, **_: views
    monkeypatch.setitem(sys.modules, "mapanything", ModuleType("mapanything"))
    monkeypatch.setitem(sys.modules, "mapanything.utils", ModuleType("mapanything.utils"))
    monkeypatch.setitem(sys.modules, "mapanything.utils.image", image)
    logits = torch.tensor([[-4.0, 0.0, 3.0]])
    messages = {
        "pts3d_cam": torch.ones(1, 1, 3, 3),
        "conf": (1 + torch.exp(logits))[None],
        "non_ambiguous_mask": torch.tensor([[[True, True, False]]]),
        "camera_poses": torch.eye(4)[None],
    }
    network = SimpleNamespace(infer=lambda *_, **__: [messages])
    _, sure, _ = infer(network, np.zeros((1, 3, 1, 3), np.float32), "cpu")
    # Naive, c / (1 + c): never below a half, so that nothing is ever left out.
    np.testing.assert_allclose(sure[0], [[1 / (1 + np.exp(4)), 0.5, 0]], atol=1e-6)
    assert (sure[0, 0] > CONFIDENT).tolist() == [False, True, False]


def test_the_encoder_is_built_from_the_checkout_and_without_weights(checkout: Path) -> None:
    fetched = torch.hub.load
    with encoder_from(checkout):
        made = torch.hub.load("facebookresearch/dinov2", "tiny", force_reload=False, pretrained=True, width=5)
    assert made.in_features == 5
    assert torch.hub.load is fetched


def test_a_file_that_lacks_entries_is_refused(tmp_path: Path, checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def from_pretrained(folder: str, strict: bool) -> None:
        assert strict
        raise RuntimeError("Missing key(s) in state_dict: encoder")

    models = ModuleType("mapanything.models")
    models.MapAnything = SimpleNamespace(from_pretrained=from_pretrained)
    monkeypatch.setitem(sys.modules, "mapanything", ModuleType("mapanything"))
    monkeypatch.setitem(sys.modules, "mapanything.models", models)
    monkeypatch.syspath_prepend(checkout)
    monkeypatch.setattr(
        mapanything, "staged_weights", lambda _, folder: folder
    )  # these files are not what is published
    for file in CARD.weights:
        (tmp_path / file.path).parent.mkdir(exist_ok=True)
        (tmp_path / file.path).touch()
    with pytest.raises(UserError, match=r"mapanything holds no weights of MapAnything .*Missing key"):
        load("pose and depth", "mapanything", tmp_path, "cpu")
    monkeypatch.delitem(sys.modules, "dinov2")
