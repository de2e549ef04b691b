# SPDX-License-Identifier: Apache-2.0
"""Fixtures every test may use."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# The workers fill the cores: more threads in each, which wait in busy loops, would make them several times slower. Said
# before what reads it is imported, and inherited by the workers. To one thread of libgomp, where a machine has that,
# numba hands nothing over; to one of its own, which steps take (__main__), every call of a kernel, in 40 µs.
ALONE = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
os.environ.update({name: os.environ.get(name, chosen) for name, chosen in ALONE.items()})

from studiorecon.__main__ import KERNELS  # noqa: E402 after that, and before numba is imported

os.environ.update({name: os.environ.get(name, chosen) for name, chosen in KERNELS.items()})

ROOT = Path(__file__).resolve().parents[1]
# As every step does (__main__): where byte code is not written beside the sources, every worker and every process of a
# test would compile all that it imports.
if sys.dont_write_bytecode:
    sys.pycache_prefix, sys.dont_write_bytecode = str(ROOT / ".snakemake/bytecode"), False
    os.environ |= {"PYTHONPYCACHEPREFIX": sys.pycache_prefix, "PYTHONDONTWRITEBYTECODE": ""}

from tests import defaults  # noqa: E402 after that
from tests.made.browser import BROWSER, NO_BROWSER  # noqa: E402

# The ids of all tests, slow ones included, where this run was not asked for some of them.
EVERY_TEST = pytest.StashKey[list[str]]()
# Files that share one run of the smallest studio to its end.
FINISHED_STUDIO = {
    f"tests/workflow/test_{name}.py"
    for name in (
        "bare",
        "every_setting",
        "reruns",
        "identities",
        "shadows",
        "precomputed",
        "notebooks",
        "killed",
        "hostile_names",
        "hardships",
        "lost_worker",
        "window_in_browser",
    )
}


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Keeps the tests of a file on one worker, where what they share is made once."""
    # xdist is there where this is called. Its own groups are suffixes of test ids, which pytest 9 does not show it.
    from xdist.scheduler import LoadFileScheduling

    class ByWhatTheyShare(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "finished studio" if file in FINISHED_STUDIO else file

    return ByWhatTheyShare(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Whole runs of the workflow take longest, so they do not come last; nor first, because they take along what tests
    before them compiled."""
    if BROWSER is None:
        for item in items:
            if item.get_closest_marker("browser"):
                item.add_marker(pytest.mark.skip(reason=NO_BROWSER))
    if [Path(given).resolve() for given in config.args] == [ROOT / "tests"]:
        config.stash[EVERY_TEST] = [item.nodeid for item in items]
    files = [item.nodeid.partition("::")[0] for item in items]
    after = max((k for k, file in enumerate(files) if file.startswith("tests/hard/")), default=-1)

    def place(k: int) -> tuple[float, bool]:
        late = k + 0.0 if not files[k].startswith("tests/workflow/") else after + 0.5
        return late, files[k] not in FINISHED_STUDIO

    items[:] = [items[k] for k in sorted(range(len(items)), key=place)]


# Ids of what was skipped and the reasons, which .ci/run collects in the file that this variable names.
SKIPS_FILE = "STUDIORECON_SKIPS"
SKIPPED: dict[str, str] = {}


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        SKIPPED[report.nodeid] = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    if report.skipped:
        SKIPPED[report.nodeid] = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)


def pytest_sessionfinish(session: pytest.Session) -> None:
    if SKIPS_FILE in os.environ and not hasattr(session.config, "workerinput"):
        with Path(os.environ[SKIPS_FILE]).open("a", encoding="utf-8") as file:
            file.writelines(f"{name}\t{reason}\n" for name, reason in SKIPPED.items())


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository's root folder."""
    return ROOT


@pytest.fixture(scope="session")
def default_settings() -> Callable[..., dict[str, Any]]:
    """``default_settings("depth", planes_step_m=0.1)``: a section of config/config.yaml, with some values replaced."""
    return defaults.default_settings


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder with the real captures; skips when it is not there."""
    folder = Path(os.environ.get("STUDIORECON_REAL_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no real captures: set STUDIORECON_REAL_DATA to their folder")
    return folder
