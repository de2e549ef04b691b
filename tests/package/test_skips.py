# SPDX-License-Identifier: Apache-2.0
"""A skipped test is told, and fails where nobody allowed it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import skips


@pytest.mark.parametrize(
    ("name", "reason", "fine"),
    [
        ("tests/gpu/test_a.py", "Skipped: no CUDA device", True),
        ("tests/gpu/test_a.py::test_b[x]", "Skipped: no CUDA device", True),
        ("tests/gpu/test_a.py", "Skipped: it was red", False),
        ("tests/other/test_a.py", "Skipped: no CUDA device", False),
    ],
)
def test_a_skip_needs_its_test_and_its_reason(name: str, reason: str, fine: bool) -> None:
    allowed = skips.allowed_skips(["# comment", "", "tests/gpu/* | no CUDA device", "tests/other/* |"])
    found, refused = skips.sorted_out([(name, reason)], allowed)
    assert bool(found) == fine
    assert bool(refused) != fine


def test_a_run_writes_what_it_skipped_and_the_check_fails_on_it(tmp_path: Path, root: Path) -> None:
    (tmp_path / "test_one.py").write_text(
        "import pytest\n\ndef test_a() -> None:\n    pytest.skip('it was red')\n\n"
        "@pytest.mark.xfail\ndef test_b() -> None:\n    assert False\n"
    )
    (tmp_path / "test_two.py").write_text("import pytest\n\npytest.importorskip('no_such_package')\n")
    (tmp_path / "conftest.py").write_text((root / "tests/conftest.py").read_text("utf-8"), "utf-8")
    told = tmp_path / "skips.tsv"
    environment = os.environ | {"STUDIORECON_SKIPS": str(told), "PYTHONPATH": f"{root}:{root / 'workflow'}"}
    command = [sys.executable, "-m", "pytest", "-q", "-c", str(root / "pyproject.toml"), "--rootdir", str(tmp_path)]
    subprocess.run([*command, "-n", "0", str(tmp_path)], env=environment, capture_output=True, check=False)
    lines = dict(line.split("\t") for line in told.read_text("utf-8").splitlines())
    assert lines["test_one.py::test_a"] == "Skipped: it was red"
    assert "no_such_package" in lines["test_two.py"]
    assert len(lines) == 2
    check = subprocess.run(
        [sys.executable, "-m", "tests.skips", str(told)], cwd=root, capture_output=True, text=True, check=False
    )
    assert check.returncode == 1
    assert "it was red (1 skipped in test_one.py)" in check.stdout
