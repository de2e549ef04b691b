# SPDX-License-Identifier: Apache-2.0
"""The notebooks run from their own folder, and every Python example of the pages as it stands, on a finished scene."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from tests.workflow.conftest import ROOT, House

NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


# A page's examples follow from one another, so they run as one program.
EXAMPLES = {
    page: blocks
    for page in [ROOT / "README.md", ROOT / "config/README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if (blocks := re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL))
}


def demo_of(finished: House, folder: Path) -> None:
    """``results/demo`` in a folder, as the examples name it."""
    (folder / "results").mkdir()
    (folder / "results/demo").symlink_to(finished.folder / "results/tiny")


@pytest.mark.parametrize("page", EXAMPLES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_examples_of_a_page_run_as_they_stand(page: Path, finished: House, tmp_path: Path) -> None:
    demo_of(finished, tmp_path)
    path = {"PYTHONPATH": str(ROOT / "workflow")}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", "\n".join(EXAMPLES[page])],
        cwd=tmp_path,
        env={**os.environ, **path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.strip()


def printed(notebook: nbformat.NotebookNode) -> str:
    return "".join(
        output.get("text", "") for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    )


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, finished: House, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "docs/notebooks"
    own.mkdir(parents=True)
    demo_of(finished, tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT / "workflow"), os.environ.get("PYTHONPATH", "")]))
    # What a browser would keep of the person who runs it is not looked at.
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.outputs for cell in notebook.cells if cell.cell_type == "code"), "kept without outputs"
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(own)}}).execute()
    messages = printed(notebook)
    if path.stem == "finished_scene":
        assert "cameras," in messages
        assert messages.count("m/s in the median") == 2
        assert any("image/jpeg" in out.get("data", {}) for c in notebook.cells for out in c.get("outputs", []))
    else:
        assert "joints placed" in messages
        assert "put back to" in messages
