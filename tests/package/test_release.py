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


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_the_same_tree_gives_the_same_bytes(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    builder = WheelBuilder if kind == "wheel" else SdistBuilder
    built = []
    for folder in ("first", "second"):
        (path,) = builder(str(ROOT)).build(directory=str(tmp_path / folder), versions=["standard"])
        built.append(Path(path))
        time.sleep(2.1)  # an archive counts in two seconds
        os.utime(ROOT / "README.md")
    assert built[0].name == built[1].name
    assert built[0].read_bytes() == built[1].read_bytes()


def test_the_version_has_its_changes() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    changes = (ROOT / "docs/changelog.md").read_text(encoding="utf-8")
    assert re.search(rf"^## {re.escape(version)}\b", changes, re.MULTILINE)
