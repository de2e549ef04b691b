# SPDX-License-Identifier: Apache-2.0
"""Loads an upstream network by its kind and its name in settings, so that stages know only kinds and Protocols."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, overload

from studiorecon.machine.gpu import claim_gpu
from studiorecon.models import protocols
from studiorecon.models.catalogue.card import Kind
from studiorecon.models.catalogue.registry import adapter_module, find_card


@overload
def adapter(kind: Literal["pose and depth"], name: str) -> type[protocols.PoseAndDepth]: ...
@overload
def adapter(kind: Literal["monocular depth"], name: str) -> type[protocols.MonocularDepth]: ...
@overload
def adapter(kind: Literal["inverse depth"], name: str) -> type[protocols.MonocularDepth]: ...
@overload
def adapter(kind: Literal["person segmenter"], name: str) -> type[protocols.PersonSegmenter]: ...
@overload
def adapter(kind: Literal["body estimator"], name: str) -> type[protocols.BodyEstimator]: ...
@overload
def adapter(kind: Literal["view synthesizer"], name: str) -> type[protocols.ViewSynthesizer]: ...
@overload
def adapter(kind: Literal["picture enhancer"], name: str) -> type[protocols.Enhancer]: ...
@overload
def adapter(kind: Literal["flow"], name: str) -> type[protocols.Flow]: ...
@overload
def adapter(kind: Literal["canonical avatar"], name: str) -> type[protocols.CanonicalAvatar]: ...
@overload
def adapter(kind: Kind, name: str) -> Callable[..., Any]: ...


def adapter(kind: Kind, name: str) -> Any:
    """The class that runs network ``name``, not loaded, for questions that need no weights.

    Raises KeyError for an unknown name, ValueError for a network of another kind.
    """
    card = find_card(name)
    if card.kind != kind:
        raise ValueError(f"{card.title} is a network for {card.kind}, not for {kind}")
    return importlib.import_module(f"studiorecon.{adapter_module(name)}").ADAPTER


@overload
def load(kind: Literal["pose and depth"], name: str, weights: Path, device: str) -> protocols.PoseAndDepth: ...
@overload
def load(kind: Literal["monocular depth"], name: str, weights: Path, device: str) -> protocols.MonocularDepth: ...
@overload
def load(kind: Literal["inverse depth"], name: str, weights: Path, device: str) -> protocols.MonocularDepth: ...
@overload
def load(
    kind: Literal["person segmenter"], name: str, weights: Path, device: str, **options: Any
) -> protocols.PersonSegmenter: ...
@overload
def load(kind: Literal["body estimator"], name: str, weights: Path, device: str) -> protocols.BodyEstimator: ...
@overload
def load(
    kind: Literal["view synthesizer"], name: str, weights: Path, device: str, **options: Any
) -> protocols.ViewSynthesizer: ...
@overload
def load(
    kind: Literal["picture enhancer"], name: str, weights: Path, device: str, *, seed: int
) -> protocols.Enhancer: ...
@overload
def load(kind: Literal["flow"], name: str, weights: Path, device: str) -> protocols.Flow: ...
@overload
def load(kind: Literal["canonical avatar"], name: str, weights: Path, device: str) -> protocols.CanonicalAvatar: ...


def load(kind: Kind, name: str, weights: Path, device: str, **options: Any) -> Any:
    """Network ``name``, ready to run on ``device`` ("auto", "cuda" or "cpu") with its files below ``weights``.

    ``options`` are the settings of this network alone. Raises UserError when weights, package or memory are missing,
    and what ``adapter`` raises.
    """
    run_by: Callable[..., Any] = adapter(kind, name)
    # Before upstream's import, which may already query CUDA.
    if device != "cpu":
        claim_gpu()
    return run_by(find_card(name), weights, device, **options)
