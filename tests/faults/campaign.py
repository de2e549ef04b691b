# SPDX-License-Identifier: Apache-2.0
"""Damaged files of every reader, and what became of them: a table of verdicts by class of damage.

``python -m tests.faults.campaign [VARIANTS]`` (of bytes, and of structure, per reader; 100). What a verdict means:

* right: the reader gives what the whole file holds, or what a harmless change leaves of it;
* refused: one sentence that names what is the user's;
* traceback: any other exception, a sentence of several lines among them: a fault of the project;
* slow: more than ten seconds over one file;
* heavy: more than 100 MB of memory over one file, all of which are smaller than 1 MB here, where Linux tells.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml
from studiorecon.errors import UserError
from studiorecon.scene.names import checked_name

from tests.faults import damage, test_faults_brought, test_faults_door
from tests.faults.readers import Reader, survives

CLASSES = ("editors", "another file", "bytes", "structure", "names")
VERDICTS = ("right", "refused", "traceback", "slow", "heavy")
_SLOW_S, _HEAVY_MB = 10.0, 100.0
_READERS = test_faults_door.READERS | test_faults_brought.READERS


def variants(reader: Reader, count: int, rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    """Class and content of damaged files of one reader."""
    if reader.text:
        yield from (("editors", change(reader.whole)) for change in damage.HARMLESS.values())
    yield from (("another file", change(reader.whole)) for change in damage.ENCODINGS.values())
    yield from (("bytes", damage.bytes_changed(reader.whole, rng)) for _ in range(count))
    if reader.value is not None:
        dump = yaml.safe_dump if reader.name.endswith(".yaml") else json.dumps
        yield from (("structure", dump(damage.structure_changed(reader.value, rng)).encode()) for _ in range(count))


def verdict(reader: Reader, path: Path, content: bytes) -> str:
    """One of ``VERDICTS``."""
    path.write_bytes(content)
    begun, held_mb = time.monotonic(), most_held_mb(anew=True)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            said = survives(reader, path)
    except Exception:  # whatever it is, it is what is counted
        return "traceback"
    if time.monotonic() - begun > _SLOW_S:
        return "slow"
    if most_held_mb() - held_mb > _HEAVY_MB:
        return "heavy"
    return "right" if said == "right" else "refused"


def most_held_mb(anew: bool = False) -> float:
    """The most memory that this process has held, decoders' and all; ``anew``: from now on."""
    if not Path("/proc/self/clear_refs").exists():
        return 0.0
    if anew:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"^VmHWM:\s+(\d+) kB", status, re.MULTILINE)[0]) / 1024


def found(count: int, seed: int = 0) -> Counter[tuple[str, str]]:
    """How many variants of each class ended in each verdict."""
    told: Counter[tuple[str, str]] = Counter()
    for index, reader in enumerate(_READERS.values()):
        with tempfile.TemporaryDirectory() as folder:
            path = reader.written(Path(folder), reader.whole)
            for kind, content in variants(reader, count, np.random.default_rng([seed, index])):
                told[kind, verdict(reader, path, content)] += 1
    for name in damage.NAMES:
        try:
            checked_name(name, "the scene", "rename it")
            told["names", "right"] += 1
        except UserError:
            told["names", "refused"] += 1
    return told


def table(told: Counter[tuple[str, str]]) -> str:
    """The verdicts by class, as text."""
    lines = ["| damage | " + " | ".join(VERDICTS) + " |", "|---|" + "---|" * len(VERDICTS)]
    lines += [f"| {kind} | " + " | ".join(str(told[kind, end]) for end in VERDICTS) + " |" for kind in CLASSES]
    return "\n".join(lines)


if __name__ == "__main__":
    ended = found(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
    print(f"{sum(ended.values())} variants of {len(_READERS)} kinds of files, and names")
    print(table(ended))
    sys.exit(any(ended[kind, end] for kind in CLASSES for end in ("traceback", "slow", "heavy")))
