# SPDX-License-Identifier: Apache-2.0
"""``views.generate``: makes a network's films of checked requests, lossless; the network is loaded once for all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.video import write_lossless
from studiorecon.models.loading import adapter, load
from studiorecon.models.protocols import ViewSynthesizer
from studiorecon.progress import say
from studiorecon.scene.schema import MappingOf, real
from studiorecon.scene.step_files import read, step_file_context
from studiorecon.signature import Place, Written
from studiorecon.views.warp_settings import ViewSource

if TYPE_CHECKING:
    from jaxtyping import Integer, Shaped


@dataclass(frozen=True)
class Gen3cSettings:
    """Settings of GEN3C, with the defaults of upstream's command for several views."""

    steps: int = 35
    guidance: float = 1.0
    seed: int = 0
    offload: bool = setting(
        True,
        "Keep idle parts in main memory: 48 GB of GPU memory instead of 80, minutes slower.",
    )
    filter_points_threshold: float = setting(
        0.05,
        "Pixels whose depth differs from their neighbours' by a larger share are not warped; 1 = all are.",
        minimum=0,
        maximum=1,
    )
    foreground_masking: bool = setting(
        True, "Near surfaces hide far points in the warps: their pixels are meshed, and points behind are dropped."
    )


@dataclass(frozen=True)
class Settings(ViewSource):
    """The network and its settings."""

    gen3c: Gen3cSettings = setting(Gen3cSettings(), "How GEN3C runs.")


def read_request(path: Path) -> dict[str, Shaped[np.ndarray, " ..."]]:
    """The arrays of a request (npz), which its network checks; raises UserError as ``step_files.read`` does."""
    return read(path, MappingOf(real("...")))


def request_frames(
    network: ViewSynthesizer, request: dict[str, Shaped[np.ndarray, " ..."]]
) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """Pictures of one request; raises UserError when their number differs from the requested one."""
    wanted, made = len(request["w2cs_all"]), 0
    for part in network.views(request):
        made += len(part)
        say(f"{made} of {wanted} views")
        yield from part
    if made != wanted:
        raise UserError(f"the network made {made} views of {wanted}")


def run(settings: Settings, requests: list[Path], films: list[Written], weights: Place) -> None:
    """Write one film per request, in order; a finished film stays when a later one fails."""
    if len(requests) != len(films):
        raise UserError(f"{len(requests)} requests for {len(films)} films")
    contents = [read_request(path) for path in requests]
    for path, request in zip(requests, contents):
        with step_file_context(path):
            adapter("view synthesizer", settings.synthesizer).check(request)
    network = load("view synthesizer", settings.synthesizer, weights, "cuda", **asdict(settings.gen3c))
    for request, film in zip(contents, films):
        say(f"{film.name}: {len(request['w2cs_all'])} views, {settings.gen3c.steps} steps, seed {settings.gen3c.seed}")
        write_lossless(film, request_frames(network, request), 24.0)
