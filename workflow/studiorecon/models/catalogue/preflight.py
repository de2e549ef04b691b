# SPDX-License-Identifier: Apache-2.0
"""Checks before a network is loaded: its weights, its package, the memory. Each failure is one sentence with a remedy.

It fetches nothing: hubs are set offline, so a missing file gives an error and never a download.
"""

from __future__ import annotations

import importlib
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.machine.resource_errors import is_memory_error
from studiorecon.models.catalogue.card import Card
from studiorecon.models.catalogue.checksums import PINS, read_pins, repository_code, verify, write_pins
from studiorecon.models.catalogue.sandbox import confine_process
from studiorecon.progress import say, warn
from studiorecon.scene.user_files import first_line

if TYPE_CHECKING:
    from jaxtyping import Num


def missing_weights(card: Card, folder: Path) -> str:
    """The sentence on the first file of the ``card`` that is not in the weights ``folder``; empty where all are."""
    for file in card.weights:
        if not (folder / file.path).is_file():
            where = f"{file.source} {file.repository}".strip()
            gate = "; request access there" if file.gated else ""
            return (
                f"{card.title} needs {folder / file.path}, which is missing: get it from {where}{gate} (snakemake "
                f"weights fetches files that need no registration; licence: {card.terms.weights}), or choose "
                "another back end"
            )
    return ""


def staged_weights(card: Card, folder: Path) -> Path:
    """The weights folder, if every file of the ``card`` is in it and verified; raises UserError with the first wrong
    one.

    A file is hashed only when it has changed since the last check; a file added by hand is compared with its published
    checksum and then pinned. Also confines this process (``sandbox``).
    """
    if missing := missing_weights(card, folder):
        raise UserError(missing)
    known = read_pins(folder)
    pins = dict(known)
    for file in card.weights:
        if file.path not in pins and not (file.sha256 or file.md5):
            say(f"{folder / file.path} is new: its checksum is recorded and verified from now on")
        pins[file.path] = verify(folder, file, pins)
    for file in repository_code(folder, card.weights):
        if file.path not in pins:
            raise UserError(
                f"{folder / file.path} is code that {card.title} would run, and its checksum is not recorded; read "
                "it, then run snakemake weights, which records it"
            )
        verify(folder, file, pins)
    if pins != known:
        try:
            write_pins(folder, pins)
        except OSError as error:
            warn(f"{folder / PINS} cannot be written ({error.strerror}): files are hashed again next time")
    confine_process()
    return folder


def import_upstream(card: Card, module: str) -> Any:
    """The upstream module, imported; raises UserError with image and pins when it is missing or of another version."""
    pins = ", ".join((f"Python {card.runtime.python}", f"torch {card.runtime.torch}", *card.runtime.pins))
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise UserError(
            f"{card.title} needs the module {module}, which cannot be imported here "
            f"({first_line(error)}); run in the image "
            f"{card.runtime.image} (--sdm apptainer), which has {pins}, upstream at {card.runtime.commit}"
        ) from None


def attribute(card: Card, module: Any, wanted: str) -> Any:
    """``module.wanted``; raises UserError with the pin when upstream no longer has it."""
    if not hasattr(module, wanted):
        raise other_version(card, f"has no {wanted} in {module.__name__}")
    return getattr(module, wanted)


def other_version(card: Card, found: str) -> UserError:
    """The refusal of a package, or of an answer, that is not as the adapter expects it."""
    return UserError(
        f"{card.title} {found}: its adapter follows another version; use upstream at {card.runtime.commit}"
    )


def failed(card: Card, found: str) -> UserError:
    """The refusal of an unusable answer."""
    return UserError(f"{card.title} {found}; {card.instead}")


@contextmanager
def loading(card: Card, path: Path) -> Iterator[None]:
    """Context for loading ``path``: weights of another network, or more than arrays (``sandbox``), give a UserError."""
    try:
        yield
    except (pickle.UnpicklingError, KeyError, TypeError, RuntimeError) as error:
        # torch's lack of memory is a RuntimeError, and no fault of the file.
        if "out of memory" in str(error) or is_memory_error(error):
            raise
        raise UserError(
            f"{path} holds no weights of {card.title} ({first_line(error)}); delete it and run snakemake weights"
        ) from None


def torch_device(card: Card, wanted: str, needed: float | None = None) -> Any:
    """The torch device to run a network on, after a check of its free memory; ``wanted``: "auto", "cuda" or "cpu".

    "auto" takes a GPU, and the CPU only for networks that need none. Raises UserError when there is no such GPU, or
    less memory is free than the model needs. ``needed``: gigabytes, if not the card's.
    """
    import torch

    needed = card.memory.gpu_gb if needed is None else needed
    if wanted == "cpu" or (wanted == "auto" and needed is None and not torch.cuda.is_available()):
        return torch.device("cpu")
    if not torch.cuda.is_available():
        raise UserError(
            f"{card.title} runs on a GPU and torch sees none here; run this job where there is "
            f"one, set device to cpu and wait, or {card.instead}"
        )
    free_gb = torch.cuda.mem_get_info()[0] / 1e9
    if needed is not None and free_gb < needed:
        raise UserError(
            f"{card.title} needs {needed:.0f} GB of GPU memory ({card.memory.note}) "
            f"and {free_gb:.0f} GB are free; {card.instead}"
        )
    return torch.device("cuda")


def require_finite(card: Card, what: str, values: Num[np.ndarray, " ..."]) -> Num[np.ndarray, " ..."]:
    """``values`` unchanged; raises UserError when a network returned non-finite numbers."""
    bad = int(np.size(values) - np.isfinite(values).sum())
    if bad:
        raise failed(card, f"returned {bad} values of {what} that are no numbers")
    return values
