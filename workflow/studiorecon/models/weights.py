# SPDX-License-Identifier: Apache-2.0
"""``models.weights``: lists the files of every selected network, and fetches and verifies them on request.

It is the only step that may access the network.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import Card, WeightFile
from studiorecon.models.catalogue.checksums import read_pins, repository_code, verify, write_pins
from studiorecon.models.catalogue.fetching import fetch
from studiorecon.models.catalogue.registry import find_card
from studiorecon.progress import say
from studiorecon.signature import Place


def describe_file(file: WeightFile, folder: Path) -> str:
    """One line: size, gate, checksum, source, place."""
    size = f"{file.size_gb:g} GB" if file.size_gb else "size not stated"
    gate = (
        "request access"
        if file.gated
        else "free to fetch"
        if file.how != "hand"
        else "by hand, after agreeing to terms"
    )
    published = (
        f"SHA-256 {file.sha256}…"
        if file.sha256
        else f"MD5 {file.md5}"
        if file.md5
        else "no published checksum; compared with the hub's and with the first download's"
        if file.revision
        else "no published checksum, compared with its first download"
    )
    inner = f"/{file.remote}" if file.repository else ""
    at = f" at {file.revision[:12]}" if file.revision else ""
    place = f"{file.source} {file.repository}{inner}{at}".replace("  ", " ")
    return f"{folder / file.path}: {size}; {gate}; {published}; from {place}"


def stage_file(file: WeightFile, folder: Path, pins: dict[str, Any], may_fetch: bool) -> str:
    """State of one file after fetching (if missing and allowed) and verifying; ``pins`` receives its checksum."""
    try:
        stated = ""
        if not (folder / file.path).is_file():
            if not may_fetch:
                return "missing"
            say(f"fetching {file.path} from {file.source} {file.repository}".rstrip())
            stated = fetch(file, folder)
        pin = verify(folder, file, pins)
        if stated and pin["sha256"] != stated:
            return (
                f"{folder / file.path} is not what its publisher has (SHA-256 "
                f"{stated[:12]}…); delete it and run this again"
            )
    except UserError as refusal:
        return str(refusal)
    pins[file.path] = pin
    return "verified"


def run(models: list[str], weights: Place, fetching: str) -> None:
    """List the files of ``models``; with ``fetching`` "yes" fetch the missing ones that a program may get, and verify
    all.

    Raises UserError when, with fetching, a file is still missing or wrong; a listing alone never fails.
    """
    if not models:
        say("no setting uses an upstream network: nothing has to be fetched")
        return
    weights.mkdir(parents=True, exist_ok=True)
    pins = read_pins(weights)
    failed = []
    for name in models:
        entry = find_card(name)
        terms = entry.terms
        say(f"{entry.title} ({name}): code {terms.code}; weights {terms.weights}; commercial use: {terms.commercial}")
        if terms.condition:
            say(f"  {terms.condition}" + (f"; instead: {terms.alternative}" if terms.alternative else ""))
        say(
            f"  runs in image {entry.runtime.image}, upstream at {entry.runtime.commit}; "
            f"{_memory(entry.memory.gpu_gb, entry.memory.note)}"
        )
        for file in _files(entry, weights):
            state = stage_file(file, weights, pins, fetching == "yes")
            if pins:
                write_pins(weights, pins)
            say(f"  {describe_file(file, weights)}: {state.upper() if state in ('missing', 'verified') else state}")
            if state != "verified":
                failed.append(file.path if state == "missing" else state)
    if failed and fetching == "yes":
        raise UserError(f"{len(failed)} of the files are missing or wrong: {failed[0]}")
    if failed:
        say(f"{len(failed)} files are missing or wrong; snakemake weights fetches those that need no registration")


def _files(card: Card, folder: Path) -> Iterator[WeightFile]:
    yield from card.weights
    # Known only after the files before it are fetched.
    yield from repository_code(folder, card.weights)


def _memory(gpu_gb: float | None, note: str) -> str:
    return f"{gpu_gb:g} GB of GPU memory ({note})" if gpu_gb else note
