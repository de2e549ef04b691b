# SPDX-License-Identifier: Apache-2.0
"""The one training loop: draw a target, render, add up the terms, step; with checkpoints, messages and previews.

Its subject is a ``Trainable``: a still set of Gaussians in blocks on the CPU (``blocked_set``) or in tensors on a CUDA
device (``cuda/tensor_set``), or a person posed at every step (``humans/training``).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np

from studiorecon.progress import progress, say
from studiorecon.splatting.train.checkpoint import Checkpoint
from studiorecon.splatting.train.previews import Feedback
from studiorecon.splatting.train.terms import PlaneView, TensorView, Term

if TYPE_CHECKING:
    from jaxtyping import Bool, Num, Shaped

View = TypeVar("View", PlaneView, TensorView)


@dataclass(frozen=True)
class Preview:
    """A preview of a training: ``count`` Gaussians, and a training view's ``name``, pictures and pixels.

    ``shown`` and ``wanted`` (H, W, 3) are the render and its target, ``used`` (H, W) the pixels that count.
    """

    count: int
    name: str
    shown: Num[np.ndarray, "H W 3"]
    wanted: Num[np.ndarray, "H W 3"]
    used: Bool[np.ndarray, "H W"]


class Trainable(Protocol, Generic[View]):
    """The subject of a training. A step is ``begin``, ``draw``, the terms, ``step``, in this order."""

    def threads(self) -> AbstractContextManager[object]:
        """The context of every step and preview: its share of the threads, float32 whatever the caller's autocast."""

    def begin(self, iteration: int) -> None:
        """A hook before the step, for parts that start at an iteration."""

    def draw(self, iteration: int) -> View:
        """A target of its choice, and the picture rendered for it."""

    def step(self, iteration: int, view: View, loss: Any) -> tuple[float, float]:
        """Move the parameters by the gradient of the view's loss; returns the loss and the PSNR of the drawn view."""

    def preview(self) -> Preview:
        """A current training view."""

    def snapshot(self) -> tuple[dict[str, Shaped[np.ndarray, " ..."]], dict[str, Any]]:
        """Everything except the generator that later steps depend on: arrays, and JSON facts."""

    def resume(self, arrays: dict[str, Shaped[np.ndarray, " ..."]], facts: dict[str, Any]) -> None:
        """Restore a ``snapshot``."""


def train(
    subject: Trainable[Any],
    terms: Sequence[Term],
    iterations: tuple[int, int],
    rng: np.random.Generator,
    *,
    label: str,
    checkpoint: Checkpoint | None = None,
    previews: Path | None = None,
) -> float:
    """Train ``subject`` in place over the iterations [first, last); returns the mean PSNR of the last tenth, dB.

    ``rng`` is the generator that the subject draws from: with it a killed run that resumes at its ``checkpoint`` ends
    with the same bytes. ``previews`` is the folder that receives a picture at every tenth of the way.
    """
    first, last = iterations
    feedback, begin = Feedback(label, first, last, previews), first
    if checkpoint is not None and (stored := checkpoint.load()) is not None:
        arrays, facts = stored
        subject.resume(arrays, facts)
        feedback.resume(arrays)
        begin, rng.bit_generator.state = facts["iteration"], facts["generator"]
        say(f"{label}: continues at iteration {begin}, after an interruption")
    for iteration in progress(range(begin, last), label, last - begin):
        with subject.threads():
            subject.begin(iteration)
            view = subject.draw(iteration)
            if feedback.add(*subject.step(iteration, view, view.total(terms))):
                seen = subject.preview()
                feedback.report_progress(seen.count, seen.name, seen.shown, seen.wanted, seen.used)
            feedback.show_latest(lambda: subject.preview().shown)
        if checkpoint is not None and checkpoint.due():
            arrays, facts = subject.snapshot()
            ours = {"iteration": iteration + 1, "generator": rng.bit_generator.state}
            checkpoint.save({**feedback.record(), **arrays}, {**facts, **ours})
    feedback.end()
    return feedback.last_psnr_db
