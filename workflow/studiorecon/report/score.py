# SPDX-License-Identifier: Apache-2.0
"""``report.score``: scores any method's pictures against photos: ``python -m studiorecon report.score --renders DIR
--truth DIR``.

Each folder holds one video (``<camera>.mkv``, ``.mp4``, …) or one folder of pictures (``<camera>/*.png``) per camera,
or just one sequence; frames are compared in order. ``--masks DIR`` gives masks of people for the true pictures (not
black = person), ``--lpips DIR`` the weights of LPIPS (``alexnet.pth`` of torchvision, ``lpips_alex.pth`` of the package
lpips). Prints the measures; ``--output FILE`` writes them as JSON with every raw value. A measure that these inputs do
not allow is null with the reason.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.errors import UserError
from studiorecon.images.flow import one_thread
from studiorecon.models.protocols import PerceptualDistance
from studiorecon.progress import progress, say
from studiorecon.report.metrics.bootstrap import Bootstrap
from studiorecon.report.metrics.definitions import PROTOCOL, definitions, provenance
from studiorecon.report.metrics.distance import TOO_SMALL, open_lpips
from studiorecon.report.metrics.folders import cameras_in, digest, read_folder_frames, read_masks
from studiorecon.report.metrics.measures import (
    FLIP_EVERY,
    NAMES,
    TEMPORAL,
    measure_sequence,
    null_reasons,
    summaries,
)
from studiorecon.scene.files import write_json

if TYPE_CHECKING:
    from jaxtyping import Bool

_NO_MASKS = "no masks of people were given: add --masks DIR"
_NO_WEIGHTS = "no weights of its network were given: add --lpips DIR"
_NO_DEPTH = "needs the depth of the true pictures and of the training cameras, which folders of pictures do not have"
_NO_BODIES = "needs fitted and true bodies, which folders of pictures do not have"
# The defaults of config/config.yaml, so that this command and a run print the same numbers.
_FLOW_PRESET = "fast"
_BOOTSTRAP = Bootstrap(samples=1000, seed=0)


def people_regions(mask: Bool[np.ndarray, "H W"]) -> dict[str, Bool[np.ndarray, "H W"]]:
    """The regions of measurement from a mask (H, W) bool of people."""
    return {"people": mask, "background": ~mask}


def score_camera(
    camera: str, renders: Path, truth: Path, masks: Path | None, distance: PerceptualDistance | None = None
) -> dict[str, list[dict[str, float | None]]]:
    """version → measures per frame; raises UserError, naming the folders, when sizes or numbers of frames differ."""
    sources = {"renders": renders, "photos": truth} | ({} if masks is None else {"masks": masks})
    streams = {
        name: (read_masks if name == "masks" else read_folder_frames)(source) for name, source in sources.items()
    }

    def together() -> Iterator[tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]]:
        for frame in count():
            found = {name: next(stream, None) for name, stream in streams.items()}
            ended = [name for name, value in found.items() if value is None]
            if ended and len(ended) < len(found):
                longer = next(name for name in found if name not in ended)
                raise UserError(
                    f"{sources[ended[0]]} ends after {frame} frames and {sources[longer]} does not (camera {camera}): "
                    "they have different numbers of frames; cut the longer one"
                )
            if ended:
                return
            pictures = {name: value for name, value in found.items() if value is not None}
            for name, value in pictures.items():
                if value.shape[:2] != pictures["photos"].shape[:2]:
                    sizes = " and ".join(f"{v.shape[1]}×{v.shape[0]}" for v in (value, pictures["photos"]))
                    raise UserError(
                        f"frame {frame} of {sources[name]} and {truth} differ in size ({sizes}); resize one of them"
                    )
            yield (
                pictures["photos"],
                {"renders": pictures["renders"]},
                people_regions(pictures["masks"]) if "masks" in pictures else {},
            )

    return measure_sequence(together(), _FLOW_PRESET, distance)


def score(renders: Path, truth: Path, masks: Path | None, lpips: Path | None = None) -> dict[str, Any]:
    """All measures that the folders allow, as written to the JSON."""
    left, right = cameras_in(renders), cameras_in(truth)
    covers = cameras_in(masks) if masks is not None else {}
    common = [camera for camera in left if camera in right]
    if not common:
        raise UserError(
            f"no camera of {renders} ({', '.join(left)}) is in {truth} ({', '.join(right)}); give the files the same "
            "names"
        )
    if masks is not None and (bare := [camera for camera in common if camera not in covers]):
        raise UserError(f"{masks} has no masks of camera {bare[0]}; add them, or leave --masks out")
    alone = sorted(set(left) ^ set(right))
    for camera in alone:
        say(f"camera {camera} is in one folder only and is left out")
    net: Literal["none", "alex"] = "none" if lpips is None else "alex"
    distance = None if lpips is None else open_lpips(net, lpips, 1, "leave --lpips out")
    with one_thread(), ThreadPoolExecutor(max_workers=max(1, min(len(common), os.cpu_count() or 1))) as pool:
        jobs = {c: pool.submit(score_camera, c, left[c], right[c], covers.get(c), distance) for c in common}
        measured = {camera: job.result() for camera, job in progress(list(jobs.items()), "cameras")}
    versions: dict[str, dict[str, Any]] = {}
    people = _NO_MASKS if masks is None else "no frame shows at least 256 pixels of it"
    why = null_reasons(people, _NO_DEPTH, _NO_DEPTH, _NO_WEIGHTS if lpips is None else TOO_SMALL)
    for version, names in (("renders", NAMES), ("photo", TEMPORAL)):
        versions[version] = summaries({c: found[version] for c, found in measured.items()}, names, why, _BOOTSTRAP)
    used = {
        "lpips": net,
        "flip_every": FLIP_EVERY,
        "flow_preset": _FLOW_PRESET,
        "bootstrap_samples": _BOOTSTRAP.samples,
        "seed": _BOOTSTRAP.seed,
    }
    nothing = {f"mpjpe_{kind}_mm": None for kind in ("world", "pelvis", "similarity")}
    return {
        "pictures": versions,
        "bodies": {**nothing, "reason": _NO_BODIES},
        "identities": {"accuracy": None, "precision": None, "idf1": None, "reason": _NO_BODIES},
        "definitions": definitions(net),
        "provenance": provenance(used, "none" if masks is None else "given masks of people, not black = person"),
        "inputs": {
            "renders": {c: digest(left[c]) for c in common},
            "truth": {c: digest(right[c]) for c in common},
            "masks": {c: digest(covers[c]) for c in common if c in covers},
            "left_out": alone,
        },
        "protocol": PROTOCOL,
    }


def run(
    renders: Path, truth: Path, masks: Path | None = None, output: Path | None = None, lpips: Path | None = None
) -> None:
    """Score every camera that both folders have."""
    result = score(renders, truth, masks, lpips)
    for name, entry in result["pictures"]["renders"].items():
        if entry["value"] is not None:
            each = ", ".join(f"{camera} {_number(found['value'])}" for camera, found in entry["cameras"].items())
            say(f"{name}: {_shown(entry)} ({each})")
    missing: dict[str, list[str]] = {}
    for name, entry in result["pictures"]["renders"].items():
        if entry["value"] is None:
            missing.setdefault(entry["reason"], []).append(name)
    for reason, names in missing.items():
        say(f"not measured: {', '.join(names)}: {reason}")
    if output is not None:
        write_json(output, result)


def _shown(entry: Mapping[str, Any]) -> str:
    if entry["interval"] is None:
        return _number(entry["value"])
    return f"{_number(entry['value'])} [{_number(entry['interval'][0])}, {_number(entry['interval'][1])}]"


def _number(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.4f}"
