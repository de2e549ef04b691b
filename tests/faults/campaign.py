# SPDX-License-Identifier: Apache-2.0
"""Every rule of damage at every field of every noun, and what became of it.

``python -m tests.faults.campaign [BYTES]`` (files with changed bytes per noun; 100). What a verdict means:

* right: the reader gives what the whole file holds;
* warned: it gives something else, and says so; of a file between steps, that it changed after its step;
* refused: one sentence that names the file, and of a file between steps the cure;
* unclear: a refusal that does neither, or has several lines;
* silent: another result, without a word;
* traceback: any other exception: a fault of the project;
* slow: more than ten seconds of the processor over one file; heavy: more than 100 MB of memory, where Linux tells.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.errors import UserError
from studiorecon.machine.changed_files import RECORDS, changed_files, record_files

from tests.faults.rules import Variant, bytes_changed, variants
from tests.made.nouns import NOUNS, Noun
from tests.made.user_files import READERS, Reader

VERDICTS = ("right", "warned", "refused", "unclear", "silent", "traceback", "slow", "heavy")
_SLOW_S, _HEAVY_MB = 10.0, 100.0
# When a step wrote the whole file, long before it was damaged.
_WRITTEN_S = 10**9
# Numbers are written with at least six digits.
_SAME = 1e-5
_PLAUSIBLE = (
    "(range|count|doubled|sign|unit|order|text|exchanged|mirrored|swapped|zero|byte order|frozen|late|file: a hole)"
)
_KEYPOINTS = "(openpose|easymocap keypoints|coco|mmpose|mediapipe|keypoint npz|deeplabcut)"
_CALIBRATIONS = "(transforms|toml|extri|qualisys|vicon|optitrack|llff)"
FREE = {
    "what a detector or a fit says of what it cannot see": (
        r"(openpose|easymocap keypoints|mmpose): (type|file: gone|missing) at .*",
        r"mask: file: gone at ",
        r"depth np[yz]: (finite|infinite) at .*",
        r"given depth: missing at A",
        rf"{_KEYPOINTS}: place: a folder at ",
    ),
    "an optional value, or the file's own name for something": (
        r"transforms: missing at k1|vicon: missing at .*RADIAL2|(toml|qualisys|optitrack): (type|missing|deep) at .*",
        r"capture\.yaml: (missing at .*|unknown at height_m|whole at starts\.a|zero at (frames\.count|people))",
        r"film: (unknown at |truth at fps)",
        r"studio: (file: empty|file: half|missing) at .*",
        r"studio: ((range|sign|byte order) at seed|zero at .*)",
        r"corrected identities: file: its end at ",
    ),
    "other people or numbers of one film, which keypoints.film_check compares with its pictures": (
        rf"{_KEYPOINTS}: {_PLAUSIBLE} at .*",
    ),
    "another lens or pose, which cameras.calibration_check and the doctor compare with people": (
        rf"{_CALIBRATIONS}: {_PLAUSIBLE} at .*",
        r"capture\.yaml: (unit|sign|order|zero|byte order|late) at (focal_px|pixel_maps|starts)\..*",
    ),
    "another digit, letter or pixel": (r".*: bytes at .*",),
    "names that tracks do not have, which association refuses": (r"corrected identities: order at 0",),
    "another picture: plates are compared with the film, masks with people, depth with the floor, films in time": (
        rf"(given plate|mask|given depth|depth np[yz]): {_PLAUSIBLE} at .*",
        rf"film: {_PLAUSIBLE} at .*",
    ),
    "the brought body's own shape or motion; its distance to the body model is logged": (
        rf"canonical human: {_PLAUSIBLE} at .*",
        rf"bodies npz: {_PLAUSIBLE} at (id|frame_idx|conf|pred_2d|pred_3d)",
    ),
}
"""What may make another whole file without a word: the reason, and the damages as ``noun: rule at place``."""


@dataclass(frozen=True)
class Subject:
    """What is damaged: a whole file at ``path`` with all that belongs beside it, and how it is read."""

    path: Path
    read: Callable[[Path], Any]
    whole: bytes
    other: bytes | None = None
    ours: bool = False

    @staticmethod
    def of_noun(noun: Noun, folder: Path) -> Subject:
        for k, place in ((1, folder / "other"), (0, folder)):
            place.mkdir(exist_ok=True)
            noun.write(place / noun.name, k)
        path = folder / noun.name
        os.utime(path, (_WRITTEN_S, _WRITTEN_S))
        (folder / RECORDS.parent).mkdir()
        with contextlib.chdir(folder):
            record_files("its step", [Path(noun.name)])
        return Subject(path, noun.read, path.read_bytes(), (folder / "other" / noun.name).read_bytes(), True)

    @staticmethod
    def of_reader(reader: Reader, folder: Path) -> Subject:
        return Subject(reader.written(folder, reader.whole), reader.right, reader.whole)

    @property
    def variants(self) -> Iterator[Variant]:
        suffix = ".qca.txt" if self.path.name.endswith(".qca.txt") else self.path.suffix
        return variants(suffix, self.whole, self.other)


def held(value: Any, name: str = "") -> dict[str, Any]:
    """Every number and text inside of what a reader gives, by where it stands."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if f.name not in ("model", "source")}
    if isinstance(value, Mapping):
        value = {str(key): below for key, below in value.items()}
    elif isinstance(value, (list, tuple)):
        value = {str(index): below for index, below in enumerate(value)} | {"count": len(value)}
    else:
        return {name: value}
    return {where: below for key in value for where, below in held(value[key], f"{name}.{key}").items()}


def same(one: Any, other: Any) -> bool:
    """Whether two readings work out the same."""
    first, second = held(one), held(other)
    if first.keys() != second.keys():
        return False
    for key in first:
        a, b = np.asarray(first[key]), np.asarray(second[key])
        if a.shape != b.shape or (a.dtype.kind in "fiub") != (b.dtype.kind in "fiub"):
            return False
        if a.dtype.kind in "fiub":
            if not np.allclose(a.astype(float), b.astype(float), rtol=_SAME, atol=_SAME, equal_nan=True):
                return False
        elif a.dtype.kind != "O" and not np.array_equal(a, b):
            return False
    return True


def reading(subject: Subject) -> tuple[Any, set[str]]:
    """What a file reads as, and the sentences that are said of it, without their numbers."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), np.errstate(all="ignore"):
        value = subject.read(subject.path)
    return value, set(re.sub(r"[-\d.]+", "", said.getvalue().replace(str(subject.path.parent), "")).splitlines())


@contextlib.contextmanager
def as_nobody() -> Iterator[None]:
    """As a user who may not read everything, which root may."""
    root = os.geteuid() == 0
    if root:
        os.setresuid(65534, 65534, 0)
    try:
        yield
    finally:
        if root:
            os.setresuid(0, 0, 0)


def verdict(subject: Subject, damage: Variant, right: tuple[Any, set[str]]) -> str:
    """One of ``VERDICTS``; ``right`` is the ``reading`` of the whole file."""
    damage.lay(subject.path)
    begun, before_mb = time.process_time(), most_held_mb(anew=True)
    try:
        with as_nobody() if callable(damage.data) else contextlib.nullcontext():
            value, said = reading(subject)
        ended = "right" if same(value, right[0]) else "warned" if said - right[1] or changed(subject) else "silent"
    except UserError as refusal:
        sentence = str(refusal)
        named = subject.path.name in sentence or f"{subject.path.parent.name}/" in sentence
        cure = not subject.ours or re.search(r"delete|permit it|is missing|use the same body file", sentence)
        ended = "refused" if named and cure and "\n" not in sentence and 20 < len(sentence) < 1500 else "unclear"
    except Exception:  # whatever it is, it is what is counted
        return "traceback"
    if time.process_time() - begun > _SLOW_S:
        return "slow"
    return "heavy" if most_held_mb() - before_mb > _HEAVY_MB else ended


def changed(subject: Subject) -> bool:
    """Whether a step that is given this file says that it changed."""
    with contextlib.chdir(subject.path.parent):
        return subject.ours and any(changed_files([Path(subject.path.name)]))


def most_held_mb(anew: bool = False) -> float:
    """The most memory that this process has held, decoders' and all; ``anew``: from now on."""
    if not Path("/proc/self/clear_refs").exists():
        return 0.0
    if anew:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    return int(re.findall(r"^VmHWM:\s+(\d+) kB", status, re.MULTILINE)[0]) / 1024


def outcomes(kind: Noun | Reader, changed: int = 0, every: int = 1, seed: int = 0) -> Iterator[tuple[str, str, str]]:
    """(rule, place, verdict) of every ``every``-th damage of a noun, and of ``changed`` files with other bytes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        subject = Subject.of_noun(kind, folder) if isinstance(kind, Noun) else Subject.of_reader(kind, folder)
        right, rng = reading(subject), np.random.default_rng(seed)
        for index, variant in enumerate(subject.variants):
            if index % every == seed % every:
                yield variant.rule, variant.place, verdict(subject, variant, right)
        for number in range(changed):
            yield "bytes", str(number), verdict(subject, Variant("bytes", "", bytes_changed(subject.whole, rng)), right)


def table(counted: Mapping[str, Counter[str]], first: str) -> str:
    """Verdicts by row, as text."""
    shown: Sequence[str] = VERDICTS
    lines = [f"| {first} | " + " | ".join(shown) + " |", "|---|" + "---|" * len(shown)]
    return "\n".join(
        [*lines, *(f"| {row} | " + " | ".join(str(n[v]) for v in shown) + " |" for row, n in counted.items())]
    )


def wrong(name: str, rule: str, place: str, ended: str) -> bool:
    """Whether it is a fault of the project."""
    free = any(re.fullmatch(p, f"{name}: {rule} at {place}") for patterns in FREE.values() for p in patterns)
    return ended not in ("right", "warned", "refused") and not (ended == "silent" and free)


def main(changed: int) -> int:
    """Prints the tables and what is wrong; the exit status says whether anything is."""
    by_rule: dict[str, Counter[str]] = {}
    by_noun: dict[str, Counter[str]] = {}
    faults = []
    for name, kind in {**NOUNS, **READERS}.items():
        for rule, place, ended in outcomes(kind, changed):
            by_rule.setdefault(f"{rule.split(':')[0]}, {'between steps' if name in NOUNS else 'brought'}", Counter())[
                ended
            ] += 1
            by_noun.setdefault(name, Counter())[ended] += 1
            if wrong(name, rule, place, ended):
                faults.append(f"{ended}: {name}, {rule} at {place}")
    print(table(dict(sorted(by_rule.items())), "damage"), table(by_noun, "noun"), "\n".join(faults), sep="\n\n")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
