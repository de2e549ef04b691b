# SPDX-License-Identifier: Apache-2.0
"""``python -m tests.skips FILE``: what a run of the tests skipped and why; fails where that is not allowed.

FILE has a line ``test id<TAB>reason`` per skipped test, as ``tests/conftest.py`` writes it. ``tests/skips_allowed.txt``
says which tests may be skipped for which reason.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from fnmatch import fnmatchcase
from pathlib import Path

ALLOWED = Path(__file__).with_name("skips_allowed.txt")


def allowed_skips(lines: Iterable[str]) -> list[tuple[str, str]]:
    """(pattern of test ids, part of the reason) of every line ``pattern | part``; ``#`` begins a comment."""
    entries = [line.partition("|") for line in lines if line.strip() and not line.startswith("#")]
    return [(pattern.strip(), part.strip()) for pattern, _, part in entries]


def sorted_out(
    skipped: Iterable[tuple[str, str]], allowed: list[tuple[str, str]]
) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Test ids by reason, of the allowed skips and of the others."""
    fine: dict[str, list[str]] = {}
    refused: dict[str, list[str]] = {}
    for name, reason in skipped:
        known = any(fnmatchcase(name, pattern) and part and part in reason for pattern, part in allowed)
        (fine if known else refused).setdefault(reason.removeprefix("Skipped: "), []).append(name)
    return fine, refused


def main(path: str) -> int:
    """1 when a skip is not allowed, else 0; prints every reason with the tests that it left out."""
    lines = Path(path).read_text("utf-8").splitlines() if Path(path).exists() else []
    rows = {(name, reason) for name, _, reason in (line.partition("\t") for line in lines)}
    fine, refused = sorted_out(sorted(rows), allowed_skips(ALLOWED.read_text("utf-8").splitlines()))
    for title, found in (("not tested", fine), ("skipped without being allowed (tests/skips_allowed.txt)", refused)):
        for reason, names in found.items():
            files = sorted({name.partition("::")[0] for name in names})
            print(f"{title}: {reason} ({len(names)} skipped in {', '.join(files)})")
    return bool(refused)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
