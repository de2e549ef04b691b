# SPDX-License-Identifier: Apache-2.0
"""A network's masks: films of numbers, and which fitted person each number is."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration.settings import load
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.images.palette import UNASSIGNED
from studiorecon.masks import network
from studiorecon.masks.tracks import assign_people
from studiorecon.masks.user_masks import label_given_masks
from studiorecon.models.adapters import sam3
from studiorecon.models.catalogue.card import Card
from studiorecon.scene.capture import Footage, write_footage

from tests.made.scene import ring

HW = (30, 40)


def body(column: int) -> np.ndarray:
    depth = np.zeros(HW, np.float32)
    depth[5:25, column : column + 6] = 3.0
    return depth


def test_a_person_may_be_several_numbers_in_turn_and_strangers_stay_strangers() -> None:
    depths = [np.stack([body(4), body(20)]) for _ in range(4)]
    labels = np.zeros((4, *HW), np.uint8)
    for t in range(4):
        labels[t][body(4) > 0] = 3 if t < 2 else 9
        labels[t, 3:27, 19:27] = 5
        labels[t, 2:8, 34:38] = 7
    found, reported = assign_people(labels, depths, 2)
    masks = np.stack(list(found))
    # Naive, one number to one person: from the third frame on p0 is nobody.
    assert (masks[:, 10, 6] == 1).all()
    assert (masks[:, 10, 22] == 2).all()
    assert (masks[:, 4, 35] == UNASSIGNED).all()
    assert masks[:, 3:27, 19:27].all(), "what a person wears beyond the body is theirs"
    assert "3 = p0, 5 = p1, 9 = p0; 1 overlap no fitted person" in reported


@pytest.mark.parametrize(
    ("people", "word"), [(2, "follows 2 people"), (0, "sees no person in any frame"), (300, "only the first 254")]
)
def test_the_film_of_numbers(
    tmp_path: Path,
    default_settings: Callable,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    people: int,
    word: str,
) -> None:
    class Planted:
        def __init__(self, card: Card, weights: Path, where: str, chunk: int, prompt: str) -> None:
            assert (where, chunk, prompt) == ("cpu", 200, "person")

        def segment(self, frames: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
            for frame in frames:
                labels = np.zeros(frame.shape[:2], np.uint16)
                labels.ravel()[:people] = np.arange(1, people + 1)
                yield labels

    monkeypatch.setattr(sam3, "ADAPTER", Planted)
    write_lossless(tmp_path / "cam1.mkv", np.zeros((3, *HW, 3), np.uint8), 24.0)
    lens = [[40.0, 0, 20], [0, 40.0, 15], [0, 0, 1]]
    write_footage(
        tmp_path / "cam1.json", Footage("cam1", False, (40, 30), lens, 24.0, 3, 0, "x", "", (40, 30), 0, 0.0, [])
    )
    settings = load(network.Settings, default_settings("masks", source="sam3"), "masks")
    network.run(
        settings, "cam1", tmp_path / "cam1.mkv", tmp_path / "cam1.json", tmp_path, "cpu", tmp_path / "cam1.tracks.mkv"
    )
    assert word in capsys.readouterr().out
    numbers = read_stack(tmp_path / "cam1.tracks.mkv")
    assert numbers.shape == (3, *HW)
    assert numbers.max() == min(people, 254)


def test_memory_does_not_grow_with_the_film() -> None:
    """A thousand frames go through both passes one by one."""

    class Again:
        def __init__(self, make: Callable[[], np.ndarray]) -> None:
            self.make = make

        def __iter__(self) -> Iterator[np.ndarray]:
            return (self.make() for _ in range(1000))

    import scipy.optimize  # what it takes to import is not the film's

    assert scipy.optimize
    labels = Again(lambda: (body(4) > 0).astype(np.uint8))
    tracemalloc.start()
    for match in (
        lambda: assign_people(labels, Again(lambda: body(4)[None]), 1),
        lambda: label_given_masks(labels, Again(lambda: body(4)[None]), 1, 0.2, ring([0], "cam", wh=HW[::-1])[0]),
    ):
        masks, _ = match()
        assert all((mask[10, 6], mask[0, 0]) == (1, 0) for mask in masks)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1000 * HW[0] * HW[1] / 5
