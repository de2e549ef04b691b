# SPDX-License-Identifier: Apache-2.0
"""Fixtures every test may use."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
# Files that share one run of the smallest studio to its end; it takes longest, so it starts first.
FINISHED_STUDIO = {f"tests/workflow/test_{name}.py" for name in ("reruns", "identities", "shadows", "precomputed")}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keeps the tests of a file on one worker, where what they share is made once; whole runs of the workflow come first."""
    for item in items:
        file = item.nodeid.partition("::")[0]
        item.add_marker(pytest.mark.xdist_group("finished studio" if file in FINISHED_STUDIO else file))
    items.sort(key=lambda item: (item.nodeid.partition("::")[0] not in FINISHED_STUDIO, "tests/workflow/" not in item.nodeid))


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository's root folder."""
    return ROOT


@pytest.fixture(scope="session")
def default_settings() -> Callable[..., dict[str, Any]]:
    """``default_settings("depth", planes_step_m=0.1)``: a section of config/config.yaml, with some values replaced."""
    config = yaml.safe_load((ROOT / "config" / "config.yaml").read_text(encoding="utf-8"))

    def section(stage: str, **replaced: Any) -> dict[str, Any]:
        unknown = set(replaced) - set(config[stage])
        assert not unknown, f"config section {stage} has no {unknown}"
        return {**copy.deepcopy(config[stage]), **replaced}

    return section


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder with the real captures; skips when it is not there."""
    folder = Path(os.environ.get("STUDIORECON_REAL_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no real captures: set STUDIORECON_REAL_DATA to their folder")
    return folder
