# SPDX-License-Identifier: Apache-2.0
"""The card of an upstream network: terms, weights, runtime, memory.

Sizes and checksums are the publishers'; an unknown one is left out, and pinned when the weights are first staged. GPU
memory comes with its source. Licences as of autumn 2026: read the licence itself before relying on one line of a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

HUB = "Hugging Face"
Kind = Literal[
    "pose and depth",
    "monocular depth",
    "inverse depth",
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
    """Licences in words; whether code and weights together allow commercial use, the condition, and an alternative."""

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
        source, repository: its origin, in words; owner/name of a hub, empty for a file from no hub.
        remote: its name there: path in the repository, ``module:Enum.MEMBER`` of torchvision, ``package:path``, or the
            file's name, in the archive where ``mirrors`` have one.
        mirrors: hosts and paths of the same bytes, tried in order.
        how: the way to get it: a hub's client (``snapshot``: the whole repository, with its remote code and small
            files), torchvision, an installed package, a download from ``mirrors``, or by ``hand``, where terms must be
            agreed to.
        size_gb: as published; None = not known.
        revision: of the hub's repository, as a commit, because ``main`` changes.
        gated: whether access must be requested, or an account registered.
        md5, sha256: as published, or as recorded by people who fetched this revision, the latter possibly its first
            digits only (torchvision's file names hold eight). Empty: the hub's own checksum for that revision counts
            when it is fetched, and the fetched file's from then on.
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
    """Runtime of a network: entry of envs/images.yaml, Python, torch ("" for none), further pins, commit or release.

    Pins of different models exclude each other, hence one image each.
    """

    image: str
    python: str
    torch: str
    pins: tuple[str, ...]
    commit: str


@dataclass(frozen=True)
class Memory:
    """GPU memory to have free before a call, in GB (None: it also runs on a CPU), for which setting, and the source."""

    gpu_gb: float | None
    note: str


@dataclass(frozen=True)
class Card:
    """One upstream network: its name in settings, its authors' title, its use, and its requirements.

    ``tried``: the extent of tests here. With "random weights" upstream's own code ran through the adapter, with "parts"
    some of it; real weights never did. ``unchecked``: the parts that need a GPU, a gated file or an unreachable source
    to check. ``instead``: what a user can do where the network fails or does not fit in memory.
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
    instead: str = ""
