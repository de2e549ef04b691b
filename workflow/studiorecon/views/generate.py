# SPDX-License-Identifier: Apache-2.0
"""``views.generate``: GEN3C's films of checked requests, lossless; the network is loaded once for all requests of a job."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.video import write_lossless
from studiorecon.models.gen3c import Gen3c, Options
from studiorecon.models.gen3c_request import check_form, read_request
from studiorecon.models.protocols import ViewSynthesizer
from studiorecon.progress import say

_FPS = 24.0


@dataclass(frozen=True)
class Settings:
    """How the network runs; see config.yaml."""

    gen3c: Options


def frames_of(network: ViewSynthesizer, request: dict[str, np.ndarray]) -> Iterator[np.ndarray]:
    """(704, 1280, 3) uint8 pictures of one request; Refusal when there are more or fewer than were asked for."""
    wanted, made = len(request["w2cs_all"]), 0
    for part in network.views(request):
        made += len(part)
        say(f"{made} of {wanted} views")
        yield from part
    if made != wanted:
        raise Refusal(f"GEN3C made {made} views of {wanted}; use upstream at the pin in the table of models")


def run(settings: Settings, requests: list[Path], films: list[Path], weights: Path) -> None:
    """Write one film per request, in order; a film that is finished stays when a later one fails."""
    if len(requests) != len(films):
        raise Refusal(f"{len(requests)} requests for {len(films)} films")
    asked = [read_request(path) for path in requests]
    for request in asked:
        check_form(request)
    network = Gen3c(weights, settings.gen3c)
    for request, film in zip(asked, films):
        say(f"{film.name}: {len(request['w2cs_all'])} views, {settings.gen3c.steps} steps, seed {settings.gen3c.seed}")
        write_lossless(film, frames_of(network, request), _FPS)
