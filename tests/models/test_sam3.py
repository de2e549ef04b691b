# SPDX-License-Identifier: Apache-2.0
"""SAM 3's ends: overlapping masks, chunks of a clip, people who keep their number, and upstream's own network, tiny and
random."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.models.adapters import sam3
from studiorecon.models.adapters.sam3 import CARD, join_chunks, match_labels, postprocess, preprocess, session_labels
from studiorecon.models.loading import load

HW = (12, 20)


def person(column: int) -> np.ndarray:
    mask = np.zeros(HW, bool)
    mask[2:10, column : column + 4] = True
    return mask


@pytest.mark.parametrize("count", [1, 2, 4, 5, 6, 9, 10])
@pytest.mark.parametrize("chunk", [1, 2, 4, 100])
def test_chunks_share_one_frame_and_lose_none(count: int, chunk: int) -> None:
    frames = [np.full((*HW, 3), t, np.uint8) for t in range(count)]
    parts = [[int(f[0, 0, 0]) for f in part] for part in preprocess(iter(frames), chunk)]
    assert all(len(part) <= chunk + 1 for part in parts)
    for before, after in itertools.pairwise(parts):
        assert before[-1] == after[0]
    assert parts[0] + [t for part in parts[1:] for t in part[1:]] == list(range(count))


def test_frames_of_another_kind_are_refused() -> None:
    with pytest.raises(ValueError, match="expected uint8"):
        list(preprocess([np.zeros((*HW, 3), np.float32)], 4))
    with pytest.raises(ValueError, match="chunk is 0"):
        list(preprocess([], 0))


def test_where_masks_overlap_the_surer_one_is_in_front() -> None:
    masks = np.stack([person(3), person(5)])
    # Ids count from 0: naive, the first person becomes background.
    labels = postprocess(np.array([0, 4]), np.array([0.9, 0.6]), masks, HW)
    assert labels[5, 3] == labels[5, 6] == 1
    assert labels[5, 8] == 5
    assert postprocess(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, *HW), bool), HW).max() == 0
    with pytest.raises(UserError, match="SAM 3 returned masks"):
        postprocess(np.array([0]), np.array([1.0]), np.zeros((1, 5, 5), bool), HW)


def labels_of(**columns: int) -> np.ndarray:
    labels = np.zeros(HW, np.int64)
    for name, column in columns.items():
        labels[person(column)] = int(name[1:])
    return labels


def test_people_keep_their_number_when_a_chunk_names_them_anew() -> None:
    first = [labels_of(n1=0, n2=10), labels_of(n1=1, n2=9)]
    # The next session counts the other way round, and somebody else comes in.
    second = [labels_of(n2=1, n1=9), labels_of(n2=2, n1=8, n3=15)]
    maps = list(join_chunks([first, second]))
    assert len(maps) == 3
    assert maps[0][5, 1] == maps[1][5, 2] == maps[2][5, 3] == 1
    assert maps[0][5, 11] == maps[1][5, 11] == maps[2][5, 10] == 2
    assert maps[2][5, 16] == 3
    assert maps[0].dtype == np.uint16


def test_who_is_elsewhere_is_somebody_else() -> None:
    assert match_labels(labels_of(n1=0), labels_of(n7=3)) == {}
    assert match_labels(labels_of(n1=0), labels_of(n7=1)) == {7: 1}
    # Two new ones on one known: the better fit takes the number, the other a new one.
    again = labels_of(n7=0)
    again[2:4, 0:4] = 8
    assert match_labels(labels_of(n1=0), again) == {7: 1}
    assert list(join_chunks([[labels_of(n1=0)], [labels_of(n1=10), labels_of(n1=10)]]))[1].max() == 2


def test_late_and_silent_frames_have_their_place() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    outputs = [SimpleNamespace(frame_idx=t) for t in (0, 3, 1)]
    network = SimpleNamespace(propagate_in_video_iterator=lambda session, start_frame_idx: iter(outputs))

    def postprocess_outputs(session: object, output: SimpleNamespace, original_sizes: list) -> dict:
        assert original_sizes == [list(HW)]
        mask = torch.from_numpy(np.stack([person(output.frame_idx)]))
        return {"object_ids": torch.tensor([0]), "scores": torch.tensor([0.8]), "masks": mask}

    processor = SimpleNamespace(postprocess_outputs=postprocess_outputs)
    maps = session_labels(network, processor, None, 4, HW, torch)
    assert [int(m.max()) for m in maps] == [1, 1, 0, 1]
    assert maps[3][5, 3] == 1


@pytest.mark.weights
def test_upstreams_video_network_with_random_weights_keeps_its_contract() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pytest.importorskip("transformers.models.sam3_video", reason="transformers with SAM 3 is not installed")
    from transformers.models.sam3_video.processing_sam3_video import Sam3VideoProcessor

    from tests.models.tiny_sam3 import tiny_session

    network, session, hw = tiny_session()
    # Postprocessing needs nothing of the processor itself.
    processor = Sam3VideoProcessor.__new__(Sam3VideoProcessor)
    maps = session_labels(network, processor, session, 4, hw, torch)
    assert [m.shape for m in maps] == [hw] * 4
    numbers = list(join_chunks([maps]))
    assert len(numbers) == 4
    assert all(n.dtype == np.uint16 for n in numbers)


def test_what_upstream_leaves_out_without_its_kernels_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")

    class Upstream:
        @staticmethod
        def from_pretrained(folder: str, **options: object) -> torch.nn.Module:
            assert options["local_files_only"]
            return torch.nn.Identity()

    planted = SimpleNamespace(Sam3VideoModel=Upstream, Sam3VideoProcessor=Upstream, __name__="transformers")
    monkeypatch.setitem(sys.modules, "transformers", planted)
    monkeypatch.setattr(sam3, "staged_weights", lambda _, folder: folder)  # these files are not what is published
    for file in CARD.weights:
        (tmp_path / file.path).parent.mkdir(exist_ok=True)
        (tmp_path / file.path).touch()
    load("person segmenter", "sam3", tmp_path, "cpu", chunk=200, prompt="person")
    assert "SAM 3 does not remove duplicates and holes" in capsys.readouterr().out
