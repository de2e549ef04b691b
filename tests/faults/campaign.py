# SPDX-License-Identifier: Apache-2.0
"""Every rule of damage at every field of every noun, and what became of it.

``python -m tests.faults.campaign [BYTES]`` (files with changed bytes per noun; 100). What a verdict means:

* right: the reader gives what the whole file holds;
* other: it is another valid file, and gives what that one holds and nothing else (``FREE``);
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
from studiorecon.scene.recorded_keypoints import RecordedKeypoints

from tests.faults.rules import Variant, bytes_changed, variants
from tests.made.nouns import NOUNS, Noun
from tests.made.user_files import READERS, Reader

VERDICTS = ("right", "other", "warned", "refused", "unclear", "silent", "traceback", "slow", "heavy")
_SLOW_S, _HEAVY_MB = 10.0, 100.0
# When a step wrote the whole file, long before it was damaged.
_WRITTEN_S = 10**9
# Numbers are written with at least six digits.
_SAME = 1e-5


def only(where: str) -> Callable[[Any, Any], bool]:
    """Nothing differs but what is at places like ``where``."""
    return lambda right, now: all(re.fullmatch(where, key) for key in differing(right, now))


def fewer(right: RecordedKeypoints, now: RecordedKeypoints) -> bool:
    """Everybody who is left is as before, and in the same frame."""
    return not _strange(right, now)


def _strange(right: RecordedKeypoints, now: RecordedKeypoints) -> int:
    """How many detections are not among the right ones of their frame."""
    return sum(
        not any(f == g and _alike(one, other) for g, other in zip(right.frame, right.keypoints))
        for f, one in zip(now.frame, now.keypoints)
    )


def one_person(right: RecordedKeypoints, now: RecordedKeypoints) -> bool:
    """One detection differs at most; all are in the same frames."""
    return differing(right, now) <= {".keypoints"} and _strange(right, now) <= 1


def fewer_cameras(right: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    """Every camera that is left is as before."""
    return not differing({name: right[name] for name in now if name in right}, now)


_LISTED = "(openpose|easymocap keypoints|coco|mmpose|mediapipe)"
_KEYPOINTS = f"({_LISTED}|keypoint npz|deeplabcut)"
_CALIBRATIONS = "(transforms|toml|extri|qualisys|vicon|optitrack|llff)"
_PICTURE = "(range|count|doubled|sign|unit|order|zero|mirrored|swapped|frozen|late|file: a hole|byte order|cast)"
_POSE = "(sign|order|zero|byte order|frozen|late|cast)"
FREE: dict[str, tuple[Callable[[Any, Any], bool], tuple[str, ...]]] = {
    "a detector may see nobody, or fewer; the step says where a film has nobody": (
        fewer,
        (
            rf"{_KEYPOINTS}: (file: gone|place: a folder|type|count|doubled|frozen|missing) at [^.]*(\.\d+)?(\..*)?",
            rf"{_LISTED}: zero at .*\d.*",
        ),
    ),
    "other numbers of one person in one picture, or an unseen one": (
        one_person,
        (rf"{_LISTED}: {_PICTURE} at .*\d.*",),
    ),
    "pictures in another order or place of a film, or others' numbers; keypoints.film_check compares with the film": (
        only(r"\.(frame|pictures|keypoints)"),
        (
            r"mmpose: (range|zero|byte order) at .*frame_id",
            r"mediapipe: (order|late) at ",
            rf"keypoint npz: {_PICTURE} at .*",
            r"deeplabcut: byte order at .*",
        ),
    ),
    "another pose or lens of one camera, which cameras.calibration_check and the doctor compare with people": (
        only(r"\.\w+\.(camera_from_world|distortion)"),
        (
            rf"(toml|extri|qualisys|vicon|optitrack|llff): {_POSE} at .*",
            r"transforms: (late at .*transform_matrix|(missing|sign|zero|cast) at k1)",
            r"vicon: (missing|respelled) at .*RADIAL2",
        ),
    ),
    "a camera of another name, or none, which no film fits": (
        lambda right, now: len(now) == len(right) or fewer_cameras(right, now),
        (r"(toml|qualisys|optitrack|transforms): (type|text|deep|count) at .*",),
    ),
    "another value of a setting, or its default": (
        only(r"\.(lengths|focal_px|frame_count|keypoint_layout|masks|notes|pixel_maps|starts|people)\b.*"),
        (
            r"capture\.yaml: (missing at .*|unknown at height_m|whole at starts\.a|zero at (frames\.count|people))",
            r"capture\.yaml: (unit|sign|order|zero|byte order|late) at (focal_px|pixel_maps|starts)\..*",
            r"capture\.yaml: (cast|respelled) at (distance_m|height_m)\..*",
        ),
    ),
    "another studio": (
        only(r"\.(seed|people|(effects|detections)\..*)"),
        (r"studio: (file: (empty|half)|missing|(range|sign|zero|byte order|cast)) at .*",),
    ),
    "another picture or film; masks.read_given counts pictures; films are compared with plates, people and depth": (
        only(r"\.(\d+|count)(\.(\d+|count))?"),
        (
            rf"(given plate|mask|given depth|depth np[yz]|film): {_PICTURE} at .*",
            r"mask: file: gone at |given depth: (missing|respelled) at A|depth np[yz]: (finite|infinite) at .*",
            r"film: (unknown at |truth at fps)",
        ),
    ),
    "another body; its distance to the body model is logged": (
        only(r"\.(means_m|quaternions|log_scales|logit_opacities|sh|track|frame|keypoints|pelvis)"),
        (rf"canonical human: {_PICTURE} at .*", rf"bodies npz: {_PICTURE} at (id|frame_idx|conf|pred_2d|pred_3d)"),
    ),
    "another digit, letter or pixel": (lambda right, now: True, (r".*: bytes at .*",)),
}
"""Damages, as ``noun: rule at place``, that make another valid file: why that is its right result, and what that result
must be, beside the undamaged file's."""


@dataclass(frozen=True)
class Subject:
    """What is damaged: a whole file at ``path`` with all that belongs beside it, and how it is read."""

    name: str
    path: Path
    read: Callable[[Path], Any]
    whole: bytes
    other: bytes | None = None
    ours: bool = False

    @staticmethod
    def of_noun(name: str, noun: Noun, folder: Path) -> Subject:
        for k, place in ((1, folder / "other"), (0, folder)):
            place.mkdir(exist_ok=True)
            noun.write(place / noun.name, k)
        path = folder / noun.name
        os.utime(path, (_WRITTEN_S, _WRITTEN_S))
        (folder / RECORDS.parent).mkdir()
        with contextlib.chdir(folder):
            record_files("its step", [Path(noun.name)])
        return Subject(name, path, noun.read, path.read_bytes(), (folder / "other" / noun.name).read_bytes(), True)

    @staticmethod
    def of_reader(name: str, reader: Reader, folder: Path) -> Subject:
        return Subject(name, reader.written(folder, reader.whole), reader.right, reader.whole)

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


def differing(one: Any, other: Any) -> set[str]:
    """Where two readings do not work out the same."""
    first, second = held(one), held(other)
    return {
        key
        for key in first.keys() | second.keys()
        if not (key in first and key in second and _alike(np.asarray(first[key]), np.asarray(second[key])))
    }


def _alike(a: np.ndarray, b: np.ndarray) -> bool:
    if a.shape != b.shape or (a.dtype.kind in "fiub") != (b.dtype.kind in "fiub"):
        return False
    if a.dtype.kind in "fiub":
        return np.allclose(a.astype(float), b.astype(float), rtol=_SAME, atol=_SAME, equal_nan=True)
    return a.dtype.kind == "O" or np.array_equal(a, b)


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
        if not differing(right[0], value):
            ended = "right"
        elif said - right[1] or changed(subject):
            ended = "warned"
        else:
            ended = (
                "other" if may_differ(f"{subject.name}: {damage.rule} at {damage.place}", right[0], value) else "silent"
            )
    except UserError as refusal:
        sentence = str(refusal)
        named = subject.path.name in sentence or re.search(rf"/{subject.path.parent.name}\b", sentence)
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


def may_differ(damage: str, right: Any, now: Any) -> bool:
    """Whether the result of a damage is that of another valid file."""
    return any(
        allowed(right, now) for allowed, patterns in FREE.values() if any(re.fullmatch(p, damage) for p in patterns)
    )


def outcomes(
    name: str, kind: Noun | Reader, changed: int = 0, every: int = 1, seed: int = 0
) -> Iterator[tuple[str, str, str]]:
    """(rule, place, verdict) of every ``every``-th damage of a noun, and of ``changed`` files with other bytes."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        folder.chmod(0o755)
        subject = (Subject.of_noun if isinstance(kind, Noun) else Subject.of_reader)(name, kind, folder)
        right, rng = reading(subject), np.random.default_rng(seed)
        for index, variant in enumerate(subject.variants):
            if index % every == seed % every:
                yield variant.rule, variant.place, verdict(subject, variant, right)
        for number in range(changed):
            yield (
                "bytes",
                str(number),
                verdict(subject, Variant("bytes", str(number), bytes_changed(subject.whole, rng)), right),
            )


def table(counted: Mapping[str, Counter[str]], first: str) -> str:
    """Verdicts by row, as text."""
    shown: Sequence[str] = VERDICTS
    lines = [f"| {first} | " + " | ".join(shown) + " |", "|---|" + "---|" * len(shown)]
    return "\n".join(
        [*lines, *(f"| {row} | " + " | ".join(str(n[v]) for v in shown) + " |" for row, n in counted.items())]
    )


def wrong(ended: str) -> bool:
    """Whether it is a fault of the project."""
    return ended not in ("right", "other", "warned", "refused")


def main(changed: int) -> int:
    """Prints the tables and what is wrong; the exit status says whether anything is."""
    by_rule: dict[str, Counter[str]] = {}
    by_noun: dict[str, Counter[str]] = {}
    faults = []
    for name, kind in {**NOUNS, **READERS}.items():
        for rule, place, ended in outcomes(name, kind, changed):
            by_rule.setdefault(f"{rule.split(':')[0]}, {'between steps' if name in NOUNS else 'brought'}", Counter())[
                ended
            ] += 1
            by_noun.setdefault(name, Counter())[ended] += 1
            if wrong(ended):
                faults.append(f"{ended}: {name}, {rule} at {place}")
    print(table(dict(sorted(by_rule.items())), "damage"), table(by_noun, "noun"), "\n".join(faults), sep="\n\n")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
