# SPDX-License-Identifier: Apache-2.0
"""What has to be known about an upstream network before anybody runs it: terms, weights, runtime, memory.

Sizes and checksums are what publishers state; one that nobody here has seen is absent rather than guessed, and whoever
stages the weights pins it. GPU memory comes with who says so. Licences as read in autumn 2026: read the licence itself
before relying on one line of a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

HUB = "Hugging Face"
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
    "point detector",
]


@dataclass(frozen=True)
class Terms:
    """Licences in words; whether code and weights together allow commercial use, under which condition, and what does
    instead."""

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
        remote: its name there: path in the repository, ``module:Enum.MEMBER`` of torchvision, ``package:path``, or the
            file's name, in the archive where ``mirrors`` have one.
        mirrors: hosts and paths where the same bytes lie, asked one after the other.
        how: who may get it: a hub's client (``snapshot``: the whole repository, whose remote code and small files come
            along), torchvision, an installed package, anybody from ``mirrors``, or a person, by ``hand``, where terms
            must be agreed to.
        size_gb: as published; None = not known.
        revision: of the hub's repository, as a commit: what ``main`` is there next year is another matter.
        gated: whether access must be asked for, or an account registered.
        md5, sha256: as published, or as people who fetched this revision have written down, the latter possibly its
            first digits only (torchvision's file names hold eight); empty = nobody has said. Then the hub's own word
            for that revision counts when it is fetched, and what was fetched from then on.
    """

    path: str
    source: str
    repository: str = ""
    size_gb: float | None = None
    remote: str = ""
    how: Literal["hub", "snapshot", "torchvision", "package", "mirrors", "hand"] = "hub"
    mirrors: tuple[str, ...] = ()
    gated: bool = False
    revision: str = ""
    md5: str = ""
    sha256: str = ""


@dataclass(frozen=True)
class Runtime:
    """What it runs in: entry of envs/images.yaml, Python, torch (empty: none), upstream's further pins, the commit or
    release that is followed.

    Pins of different models exclude one another, hence one image each.
    """

    image: str
    python: str
    torch: str
    pins: tuple[str, ...]
    commit: str


@dataclass(frozen=True)
class Memory:
    """GPU memory to have free before a call, in GB (None: it runs on a CPU as well), and for which setting, according
    to whom."""

    gpu_gb: float | None
    note: str


@dataclass(frozen=True)
class Card:
    """One upstream network: its name in settings, its authors' title, what it is for, and what running it takes.

    ``tried``: how far it has come here. With "random weights" upstream's own code ran through the adapter, with "parts"
    some of it; real weights never did. ``unchecked``: what of it cannot be checked without a GPU, a gated file or a
    source that is out of reach.
    """

    name: str
    title: str
    kind: Kind
    terms: Terms
    weights: tuple[WeightFile, ...]
    runtime: Runtime
    memory: Memory
    tried: Literal["random weights", "parts", "never"]
    unchecked: str
