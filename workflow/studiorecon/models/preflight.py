# SPDX-License-Identifier: Apache-2.0
"""What is checked before a network is loaded: its weights, its package, the memory; each in one sentence that says what to do.

Nothing is fetched here: hubs are told to stay offline, so a missing file is a sentence and never a download.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.gpu import claim
from studiorecon.models.checksums import read_pins, verified
from studiorecon.models.offline import stay_offline
from studiorecon.models.registry import model


def staged(name: str, folder: Path) -> Path:
    """The weights folder, when every file of model ``name`` lies in it as it was verified; else Refusal with the first that does not.

    A file is hashed only when it has changed since ``snakemake weights`` saw it. Also tells hub clients of this process to stay offline.
    """
    entry = model(name)
    pins = read_pins(folder)
    for file in entry.weights:
        if (folder / file.path).is_file():
            if file.path in pins:
                verified(folder, file, pins)
        else:
            where = f"{file.source} {file.repository}".strip()
            gate = "; access must be asked for there" if file.gated else ""
            raise Refusal(
                f"{entry.title} needs {folder / file.path}, which is missing: get it from {where}{gate} (snakemake weights does what a "
                f"program may; licence: {entry.terms.weights}), or choose another back end"
            )
    stay_offline()
    return folder


def upstream(name: str, module: str) -> Any:
    """The upstream module, imported; Refusal that names image and pins when it is not there or is of another version."""
    entry = model(name)
    pins = ", ".join((f"Python {entry.runtime.python}", f"torch {entry.runtime.torch}", *entry.runtime.pins))
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise Refusal(
            f"{entry.title} needs the module {module}, which cannot be imported here ({str(error).splitlines()[0]}); run in the image "
            f"{entry.runtime.image} (--sdm apptainer), which has {pins}, upstream at {entry.runtime.commit}"
        ) from None


def attribute(name: str, module: Any, wanted: str) -> Any:
    """``module.wanted``; Refusal with the pin when upstream has changed and it is not there."""
    if not hasattr(module, wanted):
        entry = model(name)
        raise Refusal(
            f"{module.__name__} has no {wanted}, so this is another version than the one {entry.title}'s adapter follows; "
            f"use upstream at {entry.runtime.commit}"
        )
    return getattr(module, wanted)


def device(name: str, wanted: str, lower: str) -> Any:
    """The torch device to run model ``name`` on, after a look at the memory; ``wanted``: "auto", "cuda" or "cpu".

    "auto" takes a GPU, and the CPU only for networks that need none. Raises Refusal when there is no such GPU, or less memory is free
    than the model needs; ``lower`` says which setting would help.
    """
    if wanted != "cpu":
        claim()
    import torch

    entry = model(name)
    needed = entry.memory.gpu_gb
    if wanted == "cpu" or (wanted == "auto" and needed is None and not torch.cuda.is_available()):
        return torch.device("cpu")
    if not torch.cuda.is_available():
        raise Refusal(
            f"{entry.title} runs on a GPU and torch sees none here; run this job where there is one, set device to cpu and wait, or {lower}"
        )
    free_gb = torch.cuda.mem_get_info()[0] / 1e9
    if needed is not None and free_gb < needed:
        raise Refusal(f"{entry.title} needs {needed:.0f} GB of GPU memory ({entry.memory.note}) and {free_gb:.0f} GB are free; {lower}")
    return torch.device("cuda")


def finite(name: str, what: str, values: np.ndarray) -> np.ndarray:
    """``values``; Refusal when a network has returned something that is no number."""
    bad = int(np.size(values) - np.isfinite(values).sum())
    if bad:
        raise Refusal(
            f"{model(name).title} returned {bad} values of {what} that are no numbers; run it in full precision or on other input"
        )
    return values
