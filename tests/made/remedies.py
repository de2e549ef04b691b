# SPDX-License-Identifier: Apache-2.0
"""Sentences for users by the place in the package that makes them, and what they advise, done."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import studiorecon
from studiorecon import errors, progress

PACKAGE = Path(studiorecon.__file__).parent


@dataclass(frozen=True)
class Sentence:
    """One call of ``UserError`` or ``warn``; ``place`` is file, function and, where it makes several, which of them."""

    place: str
    lines: range
    argument: ast.expr | None


@cache
def sentences_of(file: Path) -> tuple[Sentence, ...]:
    """Every sentence that a module of the package makes, in order of lines."""
    found: dict[str, list[ast.Call]] = {}

    def visit(node: ast.AST, function: str) -> None:
        for below in ast.iter_child_nodes(node):
            if isinstance(below, ast.Call) and ast.unparse(below.func).split(".")[-1] in ("UserError", "warn"):
                found.setdefault(function, []).append(below)
            named = isinstance(below, ast.FunctionDef | ast.ClassDef)
            visit(below, f"{function}.{below.name}".lstrip(".") if named else function)

    visit(ast.parse(file.read_text(encoding="utf-8")), "")
    sentences = []
    for function, calls in found.items():
        calls.sort(key=lambda call: (call.lineno, call.col_offset))
        for number, call in enumerate(calls, 1):
            place = f"{file.relative_to(PACKAGE).as_posix()} {function}" + (f" {number}" if len(calls) > 1 else "")
            lines = range(call.lineno, (call.end_lineno or call.lineno) + 1)
            sentences.append(Sentence(place, lines, call.args[0] if call.args else None))
    return tuple(sentences)


def _place(frame: FrameType) -> str:
    file = Path(frame.f_code.co_filename)
    made = [s.place for s in sentences_of(file) if frame.f_lineno in s.lines] if PACKAGE in file.parents else []
    return made[0] if made else f"{file}:{frame.f_lineno}"


@contextmanager
def made_sentences() -> Iterator[dict[str, str]]:
    """The sentences that are made within, by their places."""
    made: dict[str, str] = {}
    refuse, say = errors.UserError.__init__, progress.say

    def refused(self: errors.UserError, sentence: str) -> None:
        made[_place(sys._getframe(1))] = sentence
        refuse(self, sentence)

    def said(sentence: str) -> None:
        if sys._getframe(1).f_code is progress.warn.__code__:
            made[_place(sys._getframe(2))] = sentence
        say(sentence)

    errors.UserError.__init__, progress.say = refused, said  # type: ignore[method-assign, assignment]
    try:
        yield made
    finally:
        errors.UserError.__init__, progress.say = refuse, say  # type: ignore[method-assign]


def follow(place: str, brought: Callable[[], object], advised: Callable[[], object]) -> str:
    """The sentence of that place, to which what is brought leads; fails unless what is advised leads to the end of the
    step without it."""
    with made_sentences() as made:
        try:
            brought()
        except errors.UserError:
            pass
        else:
            assert made, f"nothing is said, {place} is expected"
    assert place in made, f"said is {made}"
    sentence = made[place]
    with made_sentences() as made:
        advised()
    assert place not in made, made[place]
    return sentence


def follow_row(row: Sequence[Any], folder: Path) -> None:
    """``follow`` a row of a table: the place, the fault, and all that is advised, each in a folder of its own."""
    place, brought, *advised = row
    for number, done in enumerate(advised):
        before, after = (folder / f"{name}{number}" for name in ("brought", "advised"))
        before.mkdir()
        after.mkdir()
        follow(place, lambda at=before: brought(at), lambda at=after, do=done: do(at))
