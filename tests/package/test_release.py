# SPDX-License-Identifier: Apache-2.0
"""What is released: the same tree gives the same bytes, and the version has its changes."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import pytest
import tomllib

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow  # two wheels; a release is built nightly
def test_the_same_tree_gives_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    for folder in ("first", "second"):
        for builder in (WheelBuilder, SdistBuilder):
            list(builder(str(ROOT)).build(directory=str(tmp_path / folder), versions=["standard"]))
        time.sleep(2.1 if folder == "first" else 0.0)  # an archive counts in two seconds
        os.utime(ROOT / "README.md")
    first, second = ({p.name: p.read_bytes() for p in (tmp_path / folder).iterdir()} for folder in ("first", "second"))
    assert len(first) == 2
    assert first == second


def test_the_version_has_its_changes() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    changes = (ROOT / "docs/changelog.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(version)}\b", changes, re.MULTILINE)
