# SPDX-License-Identifier: Apache-2.0
"""Small wrong edits of the arithmetic, each of which some test must notice: a sign, a transpose, a missing √w, half a
pixel, an index.

The edits stand in ``mutations.tsv``. Each is made in a copy of the package, and the tests that should notice run
against the copy. Nightly (``slow``): about ten seconds each. ``python -m tests.hard.test_mutations`` lists the edits
that nobody notices.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "workflow" / "studiorecon"
LIMIT_S = 500


@dataclass(frozen=True)
class Mutation:
    """One edit of ``file`` under the package, from a text that stands there once.

    Attributes:
        tests: arguments for pytest, a file and perhaps ``-k`` with a word of some names; one of these tests must fail.
    """

    name: str
    file: str
    before: str
    after: str
    tests: str


def mutations() -> list[Mutation]:
    """The edits of ``mutations.tsv``; a backslash and n stand for a new line."""
    with (Path(__file__).parent / "mutations.tsv").open(encoding="utf-8", newline="") as file:
        lines = csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE)
        return [Mutation(**{key: text.replace("\\n", "\n") for key, text in line.items()}) for line in lines]


MUTATIONS = mutations()


def copied(folder: Path) -> Path:
    """A copy of the package with numba's caches, which follow the times of the files."""
    shutil.copytree(PACKAGE, folder / "studiorecon", ignore=shutil.ignore_patterns("*.pyc"))
    return folder


def run(copy: Path, tests: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-n0", "-x", "-q", "-p", "no:cacheprovider", *tests.split()]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )


def noticed(copy: Path, mutation: Mutation) -> tuple[bool, str]:
    """Whether a test fails under the edit, and what pytest said; the copy is as before afterwards."""
    path = copy / "studiorecon" / mutation.file
    source, times = path.read_text(encoding="utf-8"), (path.stat().st_atime_ns, path.stat().st_mtime_ns)
    assert source.count(mutation.before) == 1, (
        f"{mutation.name}: {mutation.file} has changed; the edit needs its new text"
    )
    path.write_text(source.replace(mutation.before, mutation.after), encoding="utf-8")
    try:
        done = run(copy, mutation.tests)
    finally:
        path.write_text(source, encoding="utf-8")
        os.utime(path, ns=times)
        # A compiled caller keeps what it was compiled with.
        for cache in path.parent.glob("__pycache__/*.nb?"):
            cache.unlink()
    # 1: tests ran and failed. 2 and more: they could not even be collected, which proves nothing.
    return done.returncode == 1 and " failed" in done.stdout, done.stdout[-1500:] + done.stderr[-500:]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("mutated")
    yield copied(folder)
    shutil.rmtree(folder)


def test_names_are_unique_and_every_edit_finds_its_place_once() -> None:
    assert len({m.name for m in MUTATIONS}) == len(MUTATIONS) >= 25
    for mutation in MUTATIONS:
        assert mutation.before != mutation.after
        count = (PACKAGE / mutation.file).read_text(encoding="utf-8").count(mutation.before)
        assert count == 1, f"{mutation.name}: {mutation.file} holds {mutation.before!r} {count} times"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_without_an_edit_all_of_these_tests_pass(copy: Path) -> None:
    files = sorted({test for m in MUTATIONS for test in m.tests.split() if test.startswith("tests/")})
    done = run(copy, " ".join(files))
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.name)
def test_a_wrong_edit_is_noticed(copy: Path, mutation: Mutation) -> None:
    seen, messages = noticed(copy, mutation)
    assert seen, (
        f"no test of {mutation.tests} notices {mutation.before!r} → {mutation.after!r} in {mutation.file}:\n{messages}"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        place, wanted = copied(Path(scratch)), set(sys.argv[1:])
        for one in MUTATIONS:
            if not wanted or one.name in wanted:
                print(f"{'noticed' if noticed(place, one)[0] else 'NOT NOTICED'}: {one.name} ({one.file})", flush=True)
