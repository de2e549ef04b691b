# SPDX-License-Identifier: Apache-2.0
"""RAFT's network between our two ends, with random weights where torchvision is installed, and its refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.adapters import raft
from studiorecon.models.adapters.raft import estimate_flow, postprocess, preprocess
from studiorecon.models.loading import load


@pytest.mark.parametrize("hw", [(128, 160), (90, 161)])
def test_a_network_that_knows_the_flow_gives_it_back_at_the_pictures_size(hw: tuple[int, int]) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")

    def network(first: object, second: object, num_flow_updates: int) -> list[object]:
        assert num_flow_updates == 12
        assert first.min() >= -1
        assert first.max() > 0.9
        return [
            torch.zeros(1),
            torch.stack([torch.full(first.shape[2:], 4.0), torch.full(first.shape[2:], -2.0)])[None],
        ]

    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2, *hw, 3), dtype=np.uint8)
    pair, fitted = preprocess(*frames)
    flow = postprocess(estimate_flow(network, pair, "cpu"), fitted)
    assert flow.shape == (*hw, 2)
    np.testing.assert_allclose(flow, np.broadcast_to(np.array([4.0, -2.0]) / fitted.enlarged, flow.shape), atol=1e-6)


def test_torchvisions_network_with_random_weights_runs_from_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flows = pytest.importorskip("torchvision.models.optical_flow", reason="torchvision is not installed")
    import torch

    torch.manual_seed(0)
    (tmp_path / "raft").mkdir()
    # The published checksum is that of the real weights.
    monkeypatch.setattr(raft, "staged_weights", lambda _card, weights: weights)
    file = tmp_path / "raft/raft_large_C_T_SKHT_V2.pth"
    file.write_bytes(b"no weights")
    with pytest.raises(UserError, match="holds no weights of RAFT"):
        load("flow", "raft", tmp_path, "cpu")
    torch.save(flows.raft_large(weights=None, progress=False).state_dict(), file)
    rng = np.random.default_rng(0)
    first = rng.integers(0, 256, (132, 150, 3), dtype=np.uint8)
    network = load("flow", "raft", tmp_path, "cpu")
    flow = network.flow(first, np.roll(first, 3, axis=1))
    assert flow.shape == (132, 150, 2)
    assert np.isfinite(flow).all()
    np.testing.assert_array_equal(flow, network.flow(first, np.roll(first, 3, axis=1)))
