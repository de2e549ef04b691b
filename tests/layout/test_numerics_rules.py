# SPDX-License-Identifier: Apache-2.0
"""Rules of arithmetic that a glance at the syntax can hold: no half precision, no Euler angles, no naked arccos."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from tests.made.sources import tree

PACKAGE = Path(__file__).resolve().parents[2] / "workflow" / "studiorecon"
MODULES = sorted(PACKAGE.rglob("*.py"))
HALF = {"float16", "bfloat16", ".half()"}
EULER = {"as_euler", "from_euler"}
ARCCOS = {"arccos", "acos"}
# Where a rule may be broken, and why.
ALLOWED = {
    (
        "studio.truth",
        "float16",
    ): "stored pixel motion of the synthetic studio, up to tens of pixels; stored, never computed in",
    **dict.fromkeys(
        [("render.layers", "float16"), ("footage.exr", "float16")],
        "OpenEXR channels of colours, normals and shares as compositors expect them; stored, never computed in",
    ),
    **dict.fromkeys(
        [(f"models.adapters.{adapter}", "bfloat16") for adapter in ("difix", "fixer", "pi3", "sam3")]
        + [("models.adapters.pi3", "float16")],
        "upstream's own networks run so on a GPU, as their authors do; what comes back is float32 and checked",
    ),
}


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


@cache
def names_used(path: Path) -> set[str]:
    """Every attribute, name and call keyword in a module's code; words in comments and docstrings do not count."""
    nodes = list(ast.walk(tree(path)))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    attributes = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    methods = {f".{call.func.attr}()" for call in calls if isinstance(call.func, ast.Attribute)}
    return attributes | methods | {node.id for node in nodes if isinstance(node, ast.Name)} | dtype_strings(calls)


def dtype_strings(calls: list[ast.Call]) -> set[str]:
    """Texts that are handed to a function as they stand: ``astype("float16")``."""
    values = [v for call in calls for v in [*call.args, *(k.value for k in call.keywords)]]
    return {v.value for v in values if isinstance(v, ast.Constant) and isinstance(v.value, str)}


@pytest.mark.parametrize(
    ("forbidden", "why"),
    [
        (HALF, "nothing numeric in half precision (numerics rule 1, rows L07, I05, O01)"),
        (EULER, "no Euler angles (row R21)"),
        (ARCCOS, "angles by atan2: arccos of a rounded 1 is NaN (rows R02, I13)"),
    ],
    ids=["half", "euler", "arccos"],
)
def test_code_keeps_to_the_rule(forbidden: set[str], why: str) -> None:
    used = {(name_of(path), word) for path in MODULES for word in names_used(path) & forbidden}
    broken = sorted(used - ALLOWED.keys())
    assert not broken, f"{why}; not so {', '.join(f'{module} ({word})' for module, word in broken)}"


def test_every_exception_is_still_needed() -> None:
    for (module, word), reason in ALLOWED.items():
        assert reason
        assert word in names_used(PACKAGE.joinpath(*module.split(".")).with_suffix(".py")), (
            f"{module} no longer uses {word}"
        )
