# SPDX-License-Identifier: Apache-2.0
"""Foundations say at their border what they refuse: a public function that can raise states it in its docstring."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.made.sources import tree

PACKAGE = Path(__file__).resolve().parents[2] / "workflow" / "studiorecon"
FOUNDATIONS = ["geometry", "body", "images", "splatting"]
MODULES = sorted(path for room in FOUNDATIONS for path in (PACKAGE / room).glob("*.py"))
STATED = re.compile(r"\b[Rr]aise[sd]?\b|\b[Rr]efus")
Function = ast.FunctionDef


def functions(path: Path) -> dict[str, Function]:
    """Every function and method of a module by its qualified name."""
    body = tree(path).body
    found = {node.name: node for node in body if isinstance(node, Function)}
    for owner in (node for node in body if isinstance(node, ast.ClassDef)):
        found |= {f"{owner.name}.{node.name}": node for node in owner.body if isinstance(node, Function)}
    return found


def raises(function: Function, private: dict[str, Function]) -> bool:
    """Whether it raises, checks its border with ``require``, or calls a private function of its module that does."""
    for node in ast.walk(function):
        if isinstance(node, ast.Raise):
            return True
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            name = node.func.id
            if name == "require" or (
                name in private and raises(private[name], {k: v for k, v in private.items() if k != name})
            ):
                return True
    return False


def public(name: str) -> bool:
    return not any(part.startswith("_") for part in name.split("."))


@pytest.mark.parametrize("path", MODULES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_a_public_function_that_can_raise_says_so(path: Path) -> None:
    found = functions(path)
    private = {name: node for name, node in found.items() if name.startswith("_")}
    silent = [
        name
        for name, node in found.items()
        if public(name) and raises(node, private) and not STATED.search(ast.get_docstring(node) or "")
    ]
    assert not silent, f"{path.name}: {', '.join(silent)} can raise and does not say what"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_a_statement_is_not_empty(path: Path) -> None:
    """Who says that it raises names the error, or the function whose errors it passes on."""
    for name, node in functions(path).items():
        for sentence in re.split(r"\.\s", ast.get_docstring(node) or "") if public(name) else []:
            if re.search(r"\b[Rr]aises\b", sentence):
                named = re.search(r"Error|UserError|``\w|\bas it does\b", sentence)
                assert named, f"{path.name}: {name} says “{sentence.strip()}” without the error's name"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_what_is_refused_is_called_as_the_argument_is(path: Path) -> None:
    """``require`` names what its caller gave: an argument of the function, or a field of the class."""
    for qualified, node in functions(path).items():
        classes = {c.name: c for c in tree(path).body if isinstance(c, ast.ClassDef)}
        owner = classes.get(qualified.split(".")[0], node)
        given = {a.arg for a in ast.walk(node) if isinstance(a, ast.arg)}
        given |= {ast.unparse(a.target) for a in ast.walk(owner) if isinstance(a, ast.AnnAssign)}
        calls = [c for c in ast.walk(node) if isinstance(c, ast.Call) and ast.unparse(c.func) == "require"]
        named = {c.args[0].value.split()[0].split(".")[-1] for c in calls if isinstance(c.args[0], ast.Constant)}
        assert named <= given, f"{path.name}: {qualified} requires {sorted(named - given)}"
