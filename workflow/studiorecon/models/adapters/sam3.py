# SPDX-License-Identifier: Apache-2.0
"""SAM 3 (Carion et al. 2025) through transformers: masks of all people in every frame of a clip, from a text prompt.

A clip is processed in chunks, so that memory does not grow with its length (3,000 frames at once ran out of 80 GB
upstream). Chunks share one frame, on which the people of both are matched. Identities are the network's own, per
camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    import_upstream,
    other_version,
    staged_weights,
    torch_device,
)
from studiorecon.progress import warn

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Shaped

_REVISION = "3c879f39826c281e95690f02c7821c4de09afae7"
CARD = Card(
    name="sam3",
    title="SAM 3",
    kind="person segmenter",
    terms=Terms(
        code="Apache-2.0 (transformers)",
        weights="SAM License",
        commercial="with conditions",
        condition="pass the licence on, acknowledge in publications, no military, weapons or espionage use",
    ),
    weights=(
        WeightFile(
            "sam3/model.safetensors",
            HUB,
            "facebook/sam3",
            3.44,
            "model.safetensors",
            gated=True,
            revision=_REVISION,
            sha256="6d06f0a5f84e435071fe6603e61d0b4cc7b40e0d39d487cfd4d67d8cc11cc14a",
        ),
        *(
            WeightFile(f"sam3/{name}", HUB, "facebook/sam3", remote=name, gated=True, revision=_REVISION)
            for name in ("config.json", "processor_config.json", "tokenizer.json", "tokenizer_config.json")
        ),
    ),
    runtime=Runtime(
        image="sam3", python=">=3.10", torch=">=2.7", pins=("transformers>=5.23,<6",), commit="transformers 5.23.0"
    ),
    memory=Memory(
        16.0, "chunks of 200 frames stored on the CPU; 3000 frames at once ran out of 80 GB (upstream issue 481)"
    ),
    tried="random weights",
    unchecked="its processor's files; kernels",
    instead="lower masks.sam3.chunk, or set masks.source to embedded",
)
CARDS = (CARD,)


PROMPT = "person"
"""The paper's prompt."""
# Two masks of the shared frame are one person when they share this part of their union.
_SAME = 0.5


def preprocess(
    frames: Iterable[Integer[np.ndarray, "H W 3"]], chunk: int
) -> Iterator[list[Integer[np.ndarray, "H W 3"]]]:
    """Lists of at most ``chunk`` + 1 uint8 RGB frames; each starts with the last frame of the one before."""
    if chunk < 1:
        raise ValueError(f"chunk is {chunk}, expected at least 1")
    held: list[np.ndarray] = []
    fresh = False
    for frame in frames:
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise ValueError(f"frame is {frame.dtype} of shape {frame.shape}, expected uint8 (H, W, 3)")
        held.append(frame)
        fresh = True
        if len(held) == chunk + 1:
            yield held
            held, fresh = held[-1:], False
    if fresh:
        yield held


def postprocess(
    ids: Integer[np.ndarray, " P"],
    scores: Float[np.ndarray, " P"],
    masks: Shaped[np.ndarray, "P h w"],
    hw: tuple[int, int],
) -> Integer[np.ndarray, "H W"]:
    """0 = nobody, else 1 + the network's id; where masks overlap the more confident one is in front.

    Raises UserError for another size.
    """
    if masks.shape != (len(ids), *hw) or scores.shape != ids.shape:
        raise other_version(CARD, f"returned masks {masks.shape} for {len(ids)} objects in frames of {hw}")
    labels = np.zeros(hw, np.int64)
    for k in np.argsort(scores, kind="stable"):
        labels[masks[k]] = ids[k] + 1
    return labels


def match_labels(known: Integer[np.ndarray, "H W"], again: Integer[np.ndarray, "H W"]) -> dict[int, int]:
    """Label in ``again`` → label in ``known`` for people of one frame in two chunks, best agreement first."""
    pairs = []
    for new in np.unique(again[again > 0]):
        for old in np.unique(known[(again == new) & (known > 0)]):
            both = np.sum((again == new) & (known == old))
            pairs.append((both / np.sum((again == new) | (known == old)), int(new), int(old)))
    found: dict[int, int] = {}
    for share, new, old in sorted(pairs, reverse=True):
        if share >= _SAME and new not in found and old not in found.values():
            found[new] = old
    return found


def join_chunks(chunks: Iterable[list[Integer[np.ndarray, "H W"]]]) -> Iterator[Integer[np.ndarray, "H W"]]:
    """Uint16 per frame from label maps of chunks that share a frame: 0 = nobody, else the person's number from 1."""
    last, numbered = None, 0
    for chunk in chunks:
        names = match_labels(last, chunk[0]) if last is not None else {}
        for index, labels in enumerate(chunk):
            table = np.zeros(int(labels.max()) + 1, np.uint16)
            for label in np.unique(labels[labels > 0]).tolist():
                if label not in names:
                    numbered += 1
                    names[label] = numbered
                table[label] = names[label]
            own = table[labels]
            if index == 0 and last is not None:
                continue
            yield own
        last = own


class Sam3:
    """The video model, loaded once; satisfies ``PersonSegmenter``. Weights: ``sam3/`` below ``weights``."""

    def __init__(self, card: Card, weights: Path, where: str, chunk: int, prompt: str = PROMPT) -> None:
        folder = str(staged_weights(card, weights) / "sam3")
        module = import_upstream(card, "transformers")
        network, processor = (attribute(card, module, name) for name in ("Sam3VideoModel", "Sam3VideoProcessor"))
        import torch

        self._device, self._chunk, self._prompt = torch_device(card, where), chunk, prompt
        kind = torch.bfloat16 if self._device.type == "cuda" else torch.float32
        self._network = network.from_pretrained(folder, dtype=kind, local_files_only=True).to(self._device).eval()
        self._processor = processor.from_pretrained(folder, local_files_only=True)
        warn(
            f"{card.title} does not remove duplicates and holes, because it would fetch code from a hub: a person "
            "may have two numbers, which are joined by the body below them"
        )

    def segment(self, frames: Iterable[Integer[np.ndarray, "H W 3"]]) -> Iterator[Integer[np.ndarray, "H W"]]:
        """Masks of people; see ``models.protocols.PersonSegmenter``."""
        return join_chunks(
            track_people(self._network, self._processor, part, self._prompt, self._device)
            for part in preprocess(frames, self._chunk)
        )


def track_people(
    network: Any, processor: Any, frames: list[Integer[np.ndarray, "H W 3"]], prompt: str, where: Any
) -> list[Integer[np.ndarray, "H W"]]:
    """Int64 label map of every frame of one chunk, by upstream's video session; its frames stay in main memory."""
    import torch

    kind = next(iter(network.parameters())).dtype
    session = processor.init_video_session(
        video=frames, inference_device=where, inference_state_device="cpu", video_storage_device="cpu", dtype=kind
    )
    processor.add_text_prompt(session, prompt)
    return session_labels(network, processor, session, len(frames), frames[0].shape[:2], torch)


def session_labels(
    network: Any, processor: Any, session: Any, count: int, hw: tuple[int, int], torch: Any
) -> list[Integer[np.ndarray, "H W"]]:
    """Label maps of a session's ``count`` frames in order; the network may report them late, or not without people."""
    labels = [np.zeros(hw, np.int64) for _ in range(count)]
    with torch.inference_mode():
        for output in network.propagate_in_video_iterator(session, start_frame_idx=0):
            made = processor.postprocess_outputs(session, output, original_sizes=[list(hw)])
            ids, scores, masks = (made[key].float().cpu().numpy() for key in ("object_ids", "scores", "masks"))
            labels[int(output.frame_idx)] = postprocess(ids.astype(np.int64), scores, masks > 0.5, hw)
    return labels


ADAPTER = Sam3
