# SPDX-License-Identifier: Apache-2.0
"""What takes or gives arrays says their shapes where a reader and an editor look first: in the annotation."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.made.sources import tree

PACKAGE = Path(__file__).resolve().parents[2] / "workflow" / "studiorecon"


def bare(annotation: ast.expr) -> bool:
    """Whether there is an array in it without a shape: ``np.ndarray`` outside ``Float[np.ndarray, "N 3"]``."""
    if isinstance(annotation, ast.Subscript) and isinstance(annotation.slice, ast.Tuple):
        array, *shape = annotation.slice.elts
        if ast.unparse(array) == "np.ndarray" and [type(getattr(s, "value", None)) for s in shape] == [str]:
            return False
    if ast.unparse(annotation) in ("np.ndarray", "NDArray", "npt.NDArray", "ndarray"):
        return True
    return any(bare(part) for part in ast.iter_child_nodes(annotation) if isinstance(part, ast.expr))


def annotations(body: list[ast.stmt], within: str) -> Iterator[tuple[str, ast.expr]]:
    """Name and annotations of all that is public: functions, methods, and fields of classes."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from annotations(node.body, f"{within}.{node.name}")
        elif isinstance(node, ast.AnnAssign) and not ast.unparse(node.target).startswith("_"):
            yield f"{within}.{ast.unparse(node.target)}", node.annotation
        elif isinstance(node, ast.FunctionDef) and (not node.name.startswith("_") or node.name.endswith("__")):
            taken = ast.walk(node.args)
            given = [a.annotation for a in taken if isinstance(a, ast.arg)] + [node.returns]
            yield from ((f"{within}.{node.name}", a) for a in given if a is not None)


def test_public_functions_and_fields_say_the_shapes_of_their_arrays() -> None:
    bodies = {p.relative_to(PACKAGE).with_suffix("").parts: tree(p).body for p in sorted(PACKAGE.rglob("*.py"))}
    assert not [name for parts, body in bodies.items() for name, a in annotations(body, ".".join(parts)) if bare(a)], (
        'say the shape: Float[np.ndarray, "N 3"]; of what has any, as files and memory do, Shaped[np.ndarray, " ..."]'
    )
