# SPDX-License-Identifier: Apache-2.0
"""Films are opened in one place: another opener would read another size, other colours or other times of them."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.made.sources import tree

PACKAGE = Path(__file__).resolve().parents[2] / "workflow" / "studiorecon"


def opens_films(path: Path) -> bool:
    """Whether a module imports PyAV, or uses OpenCV's reader of films."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import) and any(name.name.partition(".")[0] == "av" for name in node.names):
            return True
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "av":
            return True
        if isinstance(node, ast.Attribute) and node.attr == "VideoCapture":
            return True
    return False


def test_only_footage_opens_films() -> None:
    others = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "footage"]
    assert not [str(path.relative_to(PACKAGE)) for path in others if opens_films(path)]
    assert any(map(opens_films, (PACKAGE / "footage").glob("*.py")))
