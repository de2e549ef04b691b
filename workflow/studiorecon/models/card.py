# SPDX-License-Identifier: Apache-2.0
"""What has to be known about an upstream network before anybody runs it: terms, weights, runtime, memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "pose and depth",
    "monocular depth",
    "person segmenter",
    "body estimator",
    "body model",
    "view synthesizer",
    "picture enhancer",
    "flow",
    "perceptual distance",
    "canonical avatar",
]


@dataclass(frozen=True)
class Terms:
    """Licences in words; whether code and weights together allow commercial use, under which condition, and what does instead."""

    code: str
    weights: str
    commercial: Literal["yes", "with conditions", "no"]
    condition: str = ""
    alternative: str = ""


@dataclass(frozen=True)
class WeightFile:
    """One file to be staged before a run.

    Attributes:
        path: below the weights folder.
        source: where it comes from, in words; ``repository`` of a hub as owner/name, empty when it is no hub's.
        size_gb: as published; None = not known. ``md5``: as published; empty = not published.
        gated: whether access must be asked for, or an account registered.
        fetchable: whether a program may download it without anybody agreeing to terms on a page.
    """

    path: str
    source: str
    repository: str = ""
    size_gb: float | None = None
    gated: bool = False
    fetchable: bool = True
    md5: str = ""


@dataclass(frozen=True)
class Runtime:
    """What it runs in: entry of envs/images.yaml, Python, torch, upstream's further pins, the commit or release the adapter follows.

    Pins of different models exclude one another, hence one image each.
    """

    image: str
    python: str
    torch: str
    pins: tuple[str, ...]
    commit: str


@dataclass(frozen=True)
class Memory:
    """GPU memory to have free before a call, in GB (None: it runs on a CPU as well), and for which setting, according to whom."""

    gpu_gb: float | None
    note: str


@dataclass(frozen=True)
class Model:
    """One upstream network: its name in settings, its authors' title, the Protocol of ``models.protocols`` it satisfies, and its terms."""

    name: str
    title: str
    kind: Kind
    terms: Terms
    weights: tuple[WeightFile, ...]
    runtime: Runtime
    memory: Memory
