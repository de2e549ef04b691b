# SPDX-License-Identifier: Apache-2.0
"""The main memory that jobs ask for, in megabytes: as measured at the default sizes, plus the room's targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from studiorecon.plan.decisions import Plan

ROOM_MB = 3000
"""A training of the room beside its targets: Gaussians, gradients, moments, LPIPS on the CPU (the demo: 790 MB)."""
FILMED_PX = 1920
"""Width of pictures where ``capture.width`` is 0: a plan opens no film."""
_CUDA_MB = 2000
"""Main memory of torch, CUDA and gsplat beside a job's arrays: estimated; ``tests/gpu/run.sh --paper`` compares it."""
_COMPILER_MB = 1000
"""One nvcc on one of gsplat's sources: estimated likewise."""
_FIT_MB = 1000
"""A fit on surface points; the demo's takes 160 MB."""
_FIT_ALL_VERTICES_MB = 2000
"""A fit on all of SMPL's 6,890 vertices."""


def memory(mb: int) -> Callable[[Any, int], int]:
    """A rule's resource function: ``mb`` at the first attempt and twice as much at each further one."""
    return lambda wildcards, attempt: mb * 2 ** (attempt - 1)


def room_mb(plan: Plan, config: Mapping[str, Any]) -> int:
    """Memory of a training of the room, which holds every target: photos, synthesised and refined views."""
    width = config["capture"]["width"] or FILMED_PX
    views = len(plan.segments) * config["views"]["views_per_segment"] if config["background"]["views_share"] else 0
    targets = len(plan.training) + views + config["background"]["refinement"]["views"]
    # 16 bytes a pixel: three colours and a weight. Taller films than 16:9 have the doubled memory of a second attempt.
    return ROOM_MB + round(targets * 16 * (9 / 16) * width**2 / 1e6)


def drawn_mb(plan: Plan, mb: int, compilers: int = 0) -> int:
    """``mb``, and on a GPU what torch takes there, beside ``compilers`` of gsplat's kernels."""
    return mb + (_CUDA_MB + compilers * _COMPILER_MB) * plan.networks.rasteriser_gpus


def fit_mb(config: Mapping[str, Any]) -> int:
    """Memory of one person's fit; ``people.fit.vertices: 0`` fits all vertices."""
    return _FIT_MB if config["people"]["fit"]["vertices"] else _FIT_ALL_VERTICES_MB
