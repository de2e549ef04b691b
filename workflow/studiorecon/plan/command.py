# SPDX-License-Identifier: Apache-2.0
"""The command line of a rule, derived from the signature of its step's ``run``, so that inputs are declared once.

``run(settings, person: str, model: Path, detections: list[Path], body: Path, fit: Written)`` of ``people.fit`` becomes

    python -m studiorecon people.fit --settings {params.settings:q} --log {log:q} --person {wildcards.person:q}
    --model {input.model[0]:q} --detections {input.detections:q} --body {input.body:q} --fit {output.fit:q}

so the rule names its inputs, outputs and params as the step does. An argument that is a dataclass of paths becomes one
option per field. Signatures are parsed and not imported: importing a step would load numerical libraries.
"""

from __future__ import annotations

import ast
from functools import cache

from studiorecon.code import module_path

_WILDCARDS = {"scene", "camera", "person", "segment", "shot", "picture", "stranger", "row"}
_THREADS = {"threads", "processes", "cores"}
# A COLMAP model is several files: the step gets the first and finds the others in the same folder.
_FIRST_OF_SEVERAL = {"model", "heldout_model", "given_model"}


@cache
def command(step: str) -> str:
    """The shell line of the rule that runs ``"stage.step"``; raises FileNotFoundError when there is no such step."""
    options = [f"--{name.replace('_', '-')} {_value(name, kind)}" for name, kind in signature(step)]
    return " ".join([f"python -m studiorecon {step}", *options])


def signature(step: str) -> list[tuple[str, str]]:
    """Names and annotations of the arguments of ``run``, in order, plus the log, which every step has."""
    path = module_path(step)
    if path is None:
        raise FileNotFoundError(f"no module studiorecon.{step}")
    tree = ast.parse(path.read_bytes())
    run = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "run")
    taken = []
    for a in (*run.args.args, *run.args.kwonlyargs):
        kind = ast.unparse(a.annotation) if a.annotation else "str"
        taken += (_fields(kind, tree) if a.arg != "settings" else None) or [(a.arg, kind)]
    first = 1 if taken[0][0] == "settings" else 0
    return [*taken[:first], ("log", "log"), *taken[first:]]


def _fields(kind: str, tree: ast.Module) -> list[tuple[str, str]] | None:
    """Names and annotations of the fields of one of our dataclasses in a module; None for other classes."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name == kind:
            fields = [field for field in node.body if isinstance(field, ast.AnnAssign)]
            return [(ast.unparse(field.target), ast.unparse(field.annotation)) for field in fields]
        if isinstance(node, ast.ImportFrom) and kind in [alias.name for alias in node.names]:
            path = module_path((node.module or "").removeprefix("studiorecon."))
            return None if path is None else _fields(kind, ast.parse(path.read_bytes()))
    return None


def _value(name: str, kind: str) -> str:
    if name == "log":
        return "{log:q}"
    if name in _THREADS:
        return "{threads}"
    if name in _WILDCARDS and kind in ("str", "int"):
        return f"{{wildcards.{name}:q}}"
    if "Written" in kind:
        return f"{{output.{name}:q}}"
    if "Path" in kind:
        return f"{{input.{name}[0]:q}}" if name in _FIRST_OF_SEVERAL else f"{{input.{name}:q}}"
    return f"{{params.{name}:q}}"
