# SPDX-License-Identifier: Apache-2.0
"""The detector's runtime tells nobody that it is used, and keeps nothing about it."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LOOK = """
import os, sys, time
from pathlib import Path
from studiorecon.detector.blazepose import BlazePose
BlazePose(Path("resources/detector/pose_landmark_full.onnx"))
time.sleep(1)
print(len(os.listdir("/proc/self/task")) if os.path.isdir("/proc/self/task") else 1)
"""


def test_nothing_is_kept_and_no_thread_reports(tmp_path: Path) -> None:
    """Version 1.32 keeps ``.cache/Microsoft`` in the home folder and a thread that sends, unless it is told not to."""
    environment = {k: v for k, v in os.environ.items() if k not in ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")}
    environment |= {"HOME": str(tmp_path), "PYTHONPATH": str(ROOT / "workflow"), "NUMBA_CACHE_DIR": str(tmp_path / "n")}
    done = subprocess.run(
        [sys.executable, "-c", LOOK], cwd=ROOT, env=environment, text=True, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / ".cache").exists()
    assert [p.name for p in tmp_path.iterdir() if p.name != "n"] == []


def test_one_module_loads_the_runtime() -> None:
    """It says before that nothing may be reported; the others name its types only."""
    package = ROOT / "workflow/studiorecon"
    users = set()
    for path in package.rglob("*.py"):
        module = ast.parse(path.read_text(encoding="utf-8"))
        typed = {id(n) for block in module.body if isinstance(block, ast.If) for n in ast.walk(block)}
        for node in (n for n in ast.walk(module) if id(n) not in typed):
            named = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            named += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.partition(".")[0] == "onnxruntime" for name in named):
                users.add(str(path.relative_to(package)))
    assert users == {"machine/onnx_network.py"}
