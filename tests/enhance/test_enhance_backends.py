# SPDX-License-Identifier: Apache-2.0
"""enhance: back ends are chosen by name, refuse in one sentence, and any flow and enhancer of the Protocols fits into
the recursion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.enhance.backends import Unchanged, load_enhancer
from studiorecon.errors import UserError
from studiorecon.images.flow import one_thread
from studiorecon.models.adapters.raft import postprocess, preprocess
from studiorecon.recursive.flows import DisFlow, load_flow
from studiorecon.recursive.sequence import enhance_sequence
from studiorecon.scene.path import PathStep

from tests.made.enhance_limits import PAPER, textured
from tests.made.enhance_sequence import VIEW, panning


@pytest.mark.parametrize("name", ["raft", "difix", "fixer"])
def test_a_network_without_weights_is_refused_by_the_file_that_is_missing(name: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=rf"needs {tmp_path}/{name}.*is missing"):
        load_flow(name, "medium", tmp_path, "cpu") if name == "raft" else load_enhancer(name, tmp_path, "cpu", 0)


def test_the_embedded_back_ends_need_no_weights(tmp_path: Path) -> None:
    assert isinstance(load_enhancer("none", tmp_path / "nowhere", "cpu", 0), Unchanged)
    search = load_flow("dis", "medium", tmp_path / "nowhere", "cpu")
    first = np.repeat(textured((96, 128), 1)[..., None], 3, axis=2)
    with one_thread():
        found = search.flow(first, np.roll(first, 5, axis=1))
    assert np.abs(np.median(found[16:-16, 16:-16], axis=(0, 1)) - (5, 0)).max() < 0.1


class Network:
    """A flow network of the size rules of RAFT: it answers, at the size it is given, with the motion it was told."""

    def __init__(self, motion_px: float) -> None:
        self.motion_px = motion_px
        self.sizes: list[tuple[int, ...]] = []

    def flow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        pair, fitted = preprocess(first, second)
        self.sizes.append(pair.shape[2:])
        answer = np.zeros((2, *pair.shape[2:]), np.float32)
        moved = np.abs(first.astype(int) - second).mean() > 0
        # Panning pictures move left by 1.5 px each: the later picture is found again to the right in the earlier one.
        answer[0] = self.motion_px * fitted.enlarged * (1 if moved else 0)
        return postprocess(answer, fitted)


def test_pictures_too_small_for_the_network_are_enlarged_and_steadied() -> None:
    """E12: below 128 px RAFT divides by zero; 96 x 64 pictures go in enlarged and the flow comes back in their own
    pixels."""
    pictures, search = panning(6), Network(1.5)
    steps = [PathStep(VIEW, float(k), "a") for k in range(6)]
    depths = [np.full(VIEW.hw, 2000, np.uint16)] * 6
    reading = replace(PAPER, history=1, check=False, strength=0.8, error_threshold=60.0)
    outputs = list(enhance_sequence(steps, pictures, depths, lambda step: pictures[0], Unchanged(), reading, search))
    assert all(min(size) >= 128 for size in search.sizes)
    still = list(
        enhance_sequence(steps, pictures, depths, lambda step: pictures[0], Unchanged(), reading, Network(-1.5))
    )
    truth = panning(6, noise=0.0)
    error = [
        float(np.abs(o[-1][:, 12:-12].astype(int) - truth[-1][:, 12:-12]).mean()) for o in (outputs, pictures, still)
    ]
    assert error[0] < 0.85 * error[1] < error[2], (
        "along the right flow noise averages out; along the wrong one pictures blur"
    )


def test_dis_is_a_flow_of_the_protocol() -> None:
    with pytest.raises(UserError, match="at least 24"):
        DisFlow("fast").flow(np.zeros((20, 20, 3), np.uint8), np.zeros((20, 20, 3), np.uint8))
