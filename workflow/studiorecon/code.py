# SPDX-License-Identifier: Apache-2.0
"""A digest of the code that one step runs, so that editing a line reruns exactly the steps that use it.

Snakemake hashes a rule's shell text, not the imports of the program behind it. The digest covers the step's module and
every module of this package that it imports, directly or not, as syntax trees without docstrings: comments, docstrings
and layout change nothing.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path

PACKAGE = Path(__file__).parent
# Number of sources in the cache; the oldest are dropped first.
_REMEMBERED = 4000


def digest(step: str, by_name: Iterable[str] = ()) -> str:
    """Sixteen hex digits for ``"stage.step"`` and for modules that it loads ``by_name``, without an import statement.

    Raises FileNotFoundError when there is no such module.
    """
    # The command line reads the settings of every step, so it belongs to each of them.
    files = dependencies(["__main__", step, *by_name])
    text = "\n".join(f"{name} {_read(files[name])[0]}" for name in sorted(files))
    save_digests()
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def dependencies(modules: Iterable[str], without: Set[str] = frozenset()) -> dict[str, Path]:
    """Files of modules and of all they import, directly or not, by name; modules that only ``without`` imports are left
    out.

    Raises FileNotFoundError when one of ``modules`` is not part of this package.
    """
    files: dict[str, Path] = {}
    waiting, there = list(modules), _modules()
    while waiting:
        module = waiting.pop()
        if module in files or module in without:
            continue
        if module not in there:
            raise FileNotFoundError(f"no module studiorecon.{module}")
        files[module] = there[module]
        waiting += [name for name in _read(there[module])[1] if name in there]
    return files


def module_path(module: str) -> Path | None:
    """The file of ``"scene.camera"`` (or of a package, its ``__init__.py``); None for a module outside this package."""
    return _modules().get(module)


def imports_of_file(path: Path) -> list[str]:
    """Names (relative to the package, sorted) of our own modules that a source file imports, anywhere in it."""
    there = _modules()
    return [name for name in _read(path)[1] if name in there]


def imports_of_statements(statements: list[ast.stmt]) -> set[str]:
    """The same for statements, whether such modules exist or not."""
    found: set[str] = set()
    for statement in _statements(statements):
        if isinstance(statement, ast.Import):
            found.update(alias.name for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom) and statement.module and statement.level == 0:
            found.update((statement.module, *(f"{statement.module}.{alias.name}" for alias in statement.names)))
    return {name.removeprefix("studiorecon.") for name in found if name.startswith("studiorecon.")}


def _modules() -> Mapping[str, Path]:
    """File of every module of this package by its name, "" the package itself; listed again when a folder has
    changed."""
    folders, modules = _find_module(PACKAGE)
    if any(not os.path.isdir(folder) or os.stat(folder).st_mtime_ns != seen for folder, seen in folders.items()):
        _find_module.cache_clear()
        _, modules = _find_module(PACKAGE)
    return modules


@cache
def _find_module(package: Path) -> tuple[dict[str, int], dict[str, Path]]:
    """Time of the last change of every folder of the package, and the file of every module in them."""
    folders: dict[str, int] = {}
    modules: dict[str, Path] = {}
    for folder, below, names in os.walk(package):
        below[:] = [name for name in below if name != "__pycache__"]
        folders[folder] = os.stat(folder).st_mtime_ns
        within = Path(folder).relative_to(package).parts
        for name in sorted(name for name in names if name.endswith(".py")):
            own = () if name == "__init__.py" else (name.removesuffix(".py"),)
            # Where package and module share a name, Python takes the package.
            if own == () or ".".join((*within, *own)) not in modules:
                modules[".".join((*within, *own))] = Path(folder, name)
    return folders, modules


def _read(path: Path) -> tuple[str, list[str]]:
    """Digest of a source file's syntax tree without docstrings, and its imports from ``studiorecon``."""
    described = os.stat(path)
    return _read_cached(path, described.st_mtime_ns, described.st_size)


# A file is needed once per step that reaches it: thirty times before a run.
@lru_cache(_REMEMBERED)
def _read_cached(path: Path, changed_ns: int, size: int) -> tuple[str, list[str]]:
    """The same, cached by the file's time of change and size."""
    source = path.read_bytes()
    known, mark = _digests(_memory()), hashlib.sha256(source).hexdigest()
    if mark not in known:
        tree = ast.parse(source)
        names = sorted(imports_of_statements(tree.body))
        known[mark] = hashlib.sha256(ast.dump(_without_docstrings(tree)).encode()).hexdigest(), names
    return known[mark]


def _memory() -> Path:
    """The cache file, next to the byte code: syntax trees differ between versions of Python."""
    return PACKAGE / "__pycache__" / f"digests.{sys.implementation.cache_tag}.json"


class _Digests(dict):
    """Digest and imports by the hash of a source's bytes; ``stored`` is the number in the file."""

    stored = 0


@cache
def _digests(memory: Path) -> _Digests:
    known = _Digests()
    # Parsing every source takes seconds, which Snakemake would spend at every start. Without a readable file they are
    # parsed.
    with suppress(OSError, ValueError):
        stored = json.loads(memory.read_text(encoding="ascii"))
        known.update(stored if isinstance(stored, dict) else {})
        known.stored = len(known)
    return known


def save_digests() -> None:
    """Store the cache for the next process."""
    memory = _memory()
    known = _digests(memory)
    if len(known) == known.stored:
        return
    # As with Python's byte code, a read-only place means no cache.
    with suppress(OSError):
        memory.parent.mkdir(exist_ok=True)
        partial = memory.with_suffix(f".{os.getpid()}.partial")
        partial.write_text(json.dumps(dict(list(known.items())[-_REMEMBERED:])), encoding="ascii")
        partial.replace(memory)
    known.stored = len(known)


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Every statement of a body and of its inner bodies, but not inside expressions, which contain none."""
    for statement in body:
        yield statement
        for field in ("body", "orelse", "finalbody"):
            yield from _statements(getattr(statement, field, []))
        for part in (*getattr(statement, "handlers", []), *getattr(statement, "cases", [])):
            yield from _statements(part.body)


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in (tree, *_statements(tree.body)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = node.body[1:] or [ast.Pass()]
    return tree
