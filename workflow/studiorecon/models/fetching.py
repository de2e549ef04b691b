# SPDX-License-Identifier: Apache-2.0
"""Getting weights, each by the ordinary client of where they lie. Called by ``snakemake weights`` and by nothing else."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from studiorecon.errors import Refusal
from studiorecon.libraries import remedy
from studiorecon.models.card import WeightFile
from studiorecon.models.offline import may_fetch


def fetch(file: WeightFile, folder: Path) -> str:
    """Put one file into ``folder``; returns the SHA-256 its publisher states, or "". Raises Refusal with what a person has to do."""
    may_fetch()
    target = folder / file.path
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        if file.how in ("hub", "snapshot"):
            return _from_hub(file, target)
        if file.how == "torchvision":
            return _from_torchvision(file, target)
        if file.how == "package":
            return _from_package(file, target)
    except (Refusal, KeyboardInterrupt):
        raise
    except Exception as error:  # every client has exceptions of its own: of access, of the network, of the disk
        gate = "; ask for access there, and log in with the hub's client" if file.gated else ""
        raise Refusal(
            f"{file.path} could not be fetched from {file.source} {file.repository} ({type(error).__name__}: {_first_line(error)}){gate}"
        ) from None
    raise Refusal(f"{file.path} cannot be fetched by a program: get it from {file.source} and put it to {target}")


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), "no reason given")


def _client(name: str, file: WeightFile) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        raise Refusal(
            f"to fetch {file.path} the package {name.split('.')[0]} is needed, which is not installed ({remedy(name)}); "
            f"or get the file by hand from {file.source} {file.repository}".rstrip()
        ) from None


def _from_hub(file: WeightFile, target: Path) -> str:
    hub = _client("huggingface_hub", file)
    inner = Path(file.remote)
    # The file's own folder structure is kept by the client, so the place it is put into is the target less that structure.
    place = target
    for _ in inner.parts:
        place = place.parent
    if file.how == "snapshot":
        hub.snapshot_download(file.repository, local_dir=str(place))
    if str(target).endswith(str(inner)):
        hub.hf_hub_download(file.repository, file.remote, local_dir=str(place))
    else:
        partial = target.parent / f".{target.name}.partial"
        made = Path(hub.hf_hub_download(file.repository, file.remote, local_dir=str(partial)))
        made.replace(target)
        _remove(partial)
    tag = str(hub.get_hf_file_metadata(hub.hf_hub_url(file.repository, file.remote)).etag or "")
    # Large files carry their SHA-256 there, small ones a git hash of 40 digits.
    return tag if len(tag) == 64 else ""


def _remove(folder: Path) -> None:
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()


def _from_torchvision(file: WeightFile, target: Path) -> str:
    module, _, member = file.remote.partition(":")
    enum, _, name = member.partition(".")
    address = getattr(getattr(_client(module, file), enum), name).url
    partial = target.parent / f".{target.name}.partial"
    _client("torch.hub", file).download_url_to_file(address, str(partial), hash_prefix=file.sha256 or None, progress=True)
    partial.replace(target)
    return ""


def _from_package(file: WeightFile, target: Path) -> str:
    name, _, inner = file.remote.partition(":")
    source = Path(_client(name, file).__file__).parent / inner
    target.write_bytes(source.read_bytes())
    return ""
