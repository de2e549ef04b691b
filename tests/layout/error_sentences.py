# SPDX-License-Identifier: Apache-2.0
"""docs/errors.md: every sentence that a run can stop with, read from the code.

``python -m tests.layout.error_sentences`` writes it anew.

A sentence is what a ``raise UserError(...)`` says. What stands for something of the reader's own is shown as ‹camera›,
named after the value that the code puts there.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

from tests.made.sources import tree

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "workflow" / "studiorecon"
PAGE = ROOT / "docs" / "errors.md"
HEAD = """# When a run stops

A step that cannot do honest work stops with one sentence: what is wrong, where, and, mostly after a semicolon or
colon, what would help. Here are all of them, stages in the order of the data, by what each works on.
‹words like this› stand for something of your own. The page is made from the code
(`python -m tests.layout.error_sentences`).
"""
# Values that are called otherwise in the code than a reader would.
_CALLED = {
    "where": "file and place", "path": "file", "p": "file", "what": "what", "name": "name", "source": "file",
    "exc": "reason", "error": "reason", "e": "reason", "wh": "size", "hw": "size", "c": "camera", "d": "camera",
    "n": "number", "i": "number", "k": "number", "v": "value", "key": "entry", "f": "file",
}  # fmt: skip
_PASSED_ON = {"shown", "str", "repr", "list", "sorted", "len", "round", "map", "set", "tuple", "int", "float"}
# First lines that are no words for a reader.
_TITLES = {"__main__": "One step, started by itself."}


def sentences() -> Iterator[tuple[str, str, str]]:
    """(part, module's first line, sentence) of every refusal, in the order of parts, files and lines."""
    for path in sorted(PACKAGE.rglob("*.py")):
        source = tree(path)
        inside = path.relative_to(PACKAGE).with_suffix("")
        part = inside.parts[0] if len(inside.parts) > 1 else "the package"
        title = _TITLES.get(path.stem, " ".join((ast.get_docstring(source) or "").split("\n\n")[0].split()))
        for node in ast.walk(source):
            if (
                isinstance(node, ast.Raise)
                and isinstance(node.exc, ast.Call)
                and isinstance(node.exc.func, ast.Name)
                and node.exc.func.id == "UserError"
                and node.exc.args
                and (sentence := said(node.exc.args[0]))
                and any(letter.isalpha() for letter in _without_stand_ins(sentence))
            ):
                yield part, title, " ".join(sentence.split())


def said(node: ast.expr) -> str:
    """What an expression says, with stand-ins for values that only a run knows."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(said(value) for value in node.values)
    if isinstance(node, ast.FormattedValue):
        return said(node.value) if isinstance(node.value, (ast.Constant, ast.IfExp)) else f"‹{called(node.value)}›"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return said(node.left) + said(node.right)
    if isinstance(node, ast.IfExp):
        return " / ".join(text for text in (said(node.body), said(node.orelse)) if text)
    return f"‹{called(node)}›"


def called(node: ast.expr) -> str:
    """A value's name for a reader: that of the last thing that the expression names."""
    if isinstance(node, ast.Name):
        return _CALLED.get(node.id, node.id.strip("_").lower().replace("_", " "))
    if isinstance(node, ast.Attribute):
        inner = node.value
        plain = node.attr in ("name", "value", "parent", "stem", "suffix", "args")
        return called(inner) if plain else node.attr.strip("_").lower().replace("_", " ")
    if isinstance(node, ast.Subscript):
        return called(node.value)
    if isinstance(node, ast.Call):
        function = node.func
        if isinstance(function, ast.Attribute) and function.attr == "join" and node.args:
            return called(node.args[0])
        if isinstance(function, ast.Name) and function.id in _PASSED_ON and node.args:
            return "number" if function.id == "len" else called(node.args[-1])
        return called(function.value) if isinstance(function, ast.Attribute) else called(function)
    if isinstance(node, (ast.GeneratorExp, ast.ListComp, ast.SetComp)):
        return called(node.generators[0].iter)
    if isinstance(node, (ast.BinOp, ast.UnaryOp)):
        return "number"
    if isinstance(node, ast.Starred):
        return called(node.value)
    return "value"


def page() -> str:
    """docs/errors.md."""
    grouped: dict[str, dict[str, list[str]]] = {}
    for part, title, sentence in sentences():
        found = grouped.setdefault(part, {}).setdefault(title, [])
        if sentence not in found:
            found.append(sentence)
    lines = [HEAD]
    for part in in_order(grouped):
        titles = grouped[part]
        lines.append(f"## {part}\n")
        for title, found in titles.items():
            lines.append(f"{_plain(title)}\n")
            lines += [f"- {_plain(sentence)}" for sentence in found]
            lines.append("")
    return "\n".join(lines).rstrip("\n") + "\n"


def in_order(parts: Iterable[str]) -> list[str]:
    """Stages in the order in which data meets them, as the package's first page lists them, then everything else."""
    first_page = ast.get_docstring(ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))) or ""
    listed = first_page.partition("Stages (")[2].partition("``")[2].partition("``")[0]
    stages = [word.strip() for word in listed.replace("\n", " ").split(",")]
    return sorted(parts, key=lambda part: (stages.index(part) if part in stages else len(stages), part))


def _plain(text: str) -> str:
    """Text whose signs Markdown leaves alone."""
    text = text.replace("``", "`")
    outside = text.split("`")
    for place in range(0, len(outside), 2 if len(outside) % 2 else 1):
        for sign in "\\*_[]{}|$":
            outside[place] = outside[place].replace(sign, f"\\{sign}")
        outside[place] = outside[place].replace("<", "&lt;").replace(">", "&gt;")
    return "`".join(outside)


def _without_stand_ins(sentence: str) -> str:
    return "".join(piece.partition("›")[2] if "›" in piece else piece for piece in sentence.split("‹"))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
