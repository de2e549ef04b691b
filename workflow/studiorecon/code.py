# SPDX-License-Identifier: Apache-2.0
"""A digest of the code that one step runs, so that editing a line re-runs exactly the steps that use it.

Snakemake hashes a rule's shell text, not what the program behind it imports. The digest covers the step's module and every
module of this package that it imports, directly or not, as syntax trees without docstrings: comments, docstrings and
layout change nothing.
"""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent


def digest(step: str) -> str:
    """Sixteen hex digits for ``"stage.step"``; raises FileNotFoundError when there is no such module."""
    seen: dict[str, str] = {}
    # The command line reads the settings of every step, so it belongs to each of them.
    waiting = ["__main__", step]
    while waiting:
        module = waiting.pop()
        if module in seen:
            continue
        path = module_path(module)
        if path is None:
            raise FileNotFoundError(f"no module studiorecon.{module}")
        seen[module], imported = _read(path, path.stat().st_mtime_ns)
        waiting += [m for m in imported if m not in seen]
    text = "\n".join(f"{name} {seen[name]}" for name in sorted(seen))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def module_path(module: str) -> Path | None:
    """The file of ``"scene.camera"`` (or of a package, its ``__init__.py``); None when it is not a module of ours."""
    base = PACKAGE.joinpath(*module.split(".")) if module else PACKAGE
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file() and (module or path.name == "__init__.py"):
            return path
    return None


@cache
def _read(path: Path, _mtime_ns: int) -> tuple[str, tuple[str, ...]]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return hashlib.sha256(ast.dump(_without_docstrings(tree)).encode()).hexdigest(), tuple(sorted(imports(tree)))


def imports(tree: ast.AST) -> set[str]:
    """Names (relative to the package) of our own modules that a syntax tree imports, anywhere in it."""
    found = set()
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            if name.startswith("studiorecon."):
                module = name.removeprefix("studiorecon.")
                if module_path(module) is not None:
                    found.add(module)
    return found


def _without_docstrings(tree: ast.AST) -> ast.AST:
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
                node.body = node.body[1:] or [ast.Pass()]
    return tree
