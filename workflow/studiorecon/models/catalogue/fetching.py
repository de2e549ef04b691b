# SPDX-License-Identifier: Apache-2.0
"""Fetches weights, each by the ordinary client of its source. Only ``snakemake weights`` calls it."""

from __future__ import annotations

import errno
import http
import importlib
import shutil
import urllib.error
import urllib.request
import zipfile
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.machine.libraries import install_remedy
from studiorecon.models.catalogue.card import WeightFile
from studiorecon.models.catalogue.checksums import git_blob_hash, other_file
from studiorecon.models.catalogue.sandbox import allow_fetching
from studiorecon.progress import warn


def fetch(file: WeightFile, folder: Path) -> str:
    """The SHA-256 that its publisher states, or "", of a file that is put into ``folder``.

    Raises UserError with the steps for a person to take.
    """
    allow_fetching()
    target = folder / file.path
    target.parent.mkdir(parents=True, exist_ok=True)
    _room_for(file, folder)
    try:
        if file.how in ("hub", "snapshot"):
            return _from_hub(file, target)
        if file.how == "torchvision":
            return _from_torchvision(file, target)
        if file.how == "package":
            return _from_package(file, target)
        if file.how == "mirrors":
            return from_mirrors(file, target)
    except (UserError, KeyboardInterrupt):
        raise
    except Exception as error:  # every client has its own exceptions for access, network and disk
        gate = "; agree to its terms there, and log in with the hub's client (hf auth login)" if file.gated else ""
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            gate = f"; make room in {folder}, or set weights to a folder with enough space: fetched files are kept"
        raise UserError(
            f"{file.path} could not be fetched from {file.source} {file.repository} "
            f"({type(error).__name__}: {_first_line(error)}){gate}"
        ) from None
    raise UserError(f"{file.path} cannot be fetched by a program: get it from {file.source} and put it to {target}")


def _room_for(file: WeightFile, folder: Path) -> None:
    free_gb = shutil.disk_usage(folder).free / 1e9
    if file.size_gb and free_gb < file.size_gb:
        raise UserError(
            f"{file.path} has {file.size_gb:g} GB and {folder} has room for {free_gb:.1f}; make room there, or set "
            "weights to a folder with room"
        )


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), "no reason given")


def _client(name: str, file: WeightFile) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        raise UserError(
            f"to fetch {file.path} the package {name.split('.')[0]} is needed, which "
            f"is not installed ({install_remedy(name)}); "
            f"or get the file by hand from {file.source} {file.repository}".rstrip()
        ) from None


def _from_hub(file: WeightFile, target: Path) -> str:
    """Fetch a file, or its whole repository, at the card's revision; an interrupted download is resumed."""
    hub = _client("huggingface_hub", file)
    inner = Path(file.remote)
    # The client reproduces the file's own folder structure, so the destination is the target less that structure.
    place = target
    for _ in inner.parts:
        place = place.parent
    if file.how == "snapshot":
        hub.snapshot_download(file.repository, revision=file.revision, local_dir=str(place))
        _verify_published(hub, file, place)
    if str(target).endswith(str(inner)):
        hub.hf_hub_download(file.repository, file.remote, revision=file.revision, local_dir=str(place))
    else:
        partial = target.parent / f".{target.name}.partial"
        made = hub.hf_hub_download(file.repository, file.remote, revision=file.revision, local_dir=str(partial))
        Path(made).replace(target)
        _remove(partial)
    address = hub.hf_hub_url(file.repository, file.remote, revision=file.revision)
    stated = str(hub.get_hf_file_metadata(address).etag or "")
    # For large files the hub states the SHA-256, for small ones git's hash of their content.
    if len(stated) == 40 and stated != git_blob_hash(target):
        raise other_file(target, f"is not what {file.repository} has")
    return stated if len(stated) == 64 else ""


def _verify_published(hub: Any, file: WeightFile, place: Path) -> None:
    """Raises UserError when a small file of a whole repository, possibly code, differs from that revision's."""
    about = hub.HfApi().model_info(file.repository, revision=file.revision, files_metadata=True)
    for entry in about.siblings:
        path = place / entry.rfilename
        if not entry.lfs and path.is_file() and entry.blob_id != git_blob_hash(path):
            raise other_file(path, f"is not what {file.repository} has at {file.revision[:12]}")


def _remove(folder: Path) -> None:
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()


def _from_torchvision(file: WeightFile, target: Path) -> str:
    module, _, member = file.remote.partition(":")
    enum, _, name = member.partition(".")
    address = getattr(getattr(_client(module, file), enum), name).url
    partial = target.parent / f".{target.name}.partial"
    _client("torch.hub", file).download_url_to_file(
        address, str(partial), hash_prefix=file.sha256 or None, progress=True
    )
    partial.replace(target)
    return ""


def _from_package(file: WeightFile, target: Path) -> str:
    name, _, inner = file.remote.partition(":")
    source = Path(_client(name, file).__file__).parent / inner
    target.write_bytes(source.read_bytes())
    return ""


def from_mirrors(file: WeightFile, target: Path) -> str:
    """Fetch a file, or the archive with it, from the first mirror that answers; interrupted downloads are resumed.

    The checksum on the card verifies it, whatever its origin.
    """
    partial = target.parent / f".{target.name}.partial"
    for mirror in file.mirrors:
        try:
            _download(mirror if "://" in mirror else f"https://{mirror}", partial)
            break
        except OSError as error:  # includes urllib's and http.client's errors of access and network
            if mirror == file.mirrors[-1] or error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise
            host = mirror.split("://")[-1].partition("/")[0]
            warn(f"{host} does not answer ({_first_line(error)}); trying the next mirror")
    if zipfile.is_zipfile(partial):
        try:
            _unpack(partial, file, target)
        finally:
            partial.unlink()
    else:
        partial.replace(target)
    return ""


def _unpack(archive: Path, file: WeightFile, target: Path) -> None:
    unpacked = target.parent / f".{target.name}.unpacked"
    with zipfile.ZipFile(archive) as opened:
        members = [name for name in opened.namelist() if Path(name).name == file.remote]
        if len(members) != 1:
            raise UserError(f"the archive of {file.path} has {len(members)} files {file.remote}, expected one")
        with opened.open(members[0]) as member, open(unpacked, "wb") as stream:
            shutil.copyfileobj(member, stream)
    unpacked.replace(target)


def _download(address: str, partial: Path) -> None:
    """Append the rest of ``address`` to its partial file."""
    have = partial.stat().st_size if partial.exists() else 0
    request = urllib.request.Request(address, headers={"Range": f"bytes={have}-"} if have else {})
    try:
        with urllib.request.urlopen(request, timeout=60.0) as answer:
            # A server without range requests sends everything again.
            goes_on = answer.status == http.HTTPStatus.PARTIAL_CONTENT
            whole = int(answer.headers.get("Content-Length") or 0) + (have if goes_on else 0)
            with open(partial, "ab" if goes_on else "wb") as stream:
                shutil.copyfileobj(answer, stream)
    except urllib.error.HTTPError as error:
        if have and error.code == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            return  # the file is complete
        raise
    if whole and partial.stat().st_size < whole:
        raise ConnectionError(f"broken off after {partial.stat().st_size} of {whole} bytes")
