# SPDX-License-Identifier: Apache-2.0
"""Reads files that one step writes and another reads, and checks them against their schema.

A disk, a copy or an edit may have damaged them. An error names the file, the field and a remedy; an unchecked value
would spread through all later results without a trace of its source.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from studiorecon.errors import UserError
from studiorecon.scene import user_files
from studiorecon.scene.schema import ListOf, Numbers, Schema, check

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Shaped

T = TypeVar("T")

CURE = "delete it, and the next run makes it again"


def _unchanged(values: Any) -> Any:
    return values


def read(
    path: Path,
    schema: Schema,
    made: Callable[[Any], T] = _unchanged,
    *,
    names: Iterable[str] | None = None,
    but: Container[str] = (),
    sizes: Mapping[str, int] | None = None,
) -> T:
    """The values of a JSON file, the arrays of an npz or the rows of a table, or the result of ``made`` on them.

    An error that ``made`` raises counts as damage of the file. ``names``: of an npz, only these arrays; ``but``: all
    others; ``sizes``: known letters of shapes. Raises UserError with the file, the field and its expected value.
    """
    with step_file_context(path):
        if path.suffix == ".npz":
            values: Any = user_files.read_npz(path, names=names, but=but, remedy=CURE)
        elif path.suffix == ".tsv":
            values = _rows(path, schema)
        else:
            values = user_files.read_json(path, remedy=CURE)
        check(values, schema, sizes=sizes)
        return made(values)


def _rows(path: Path, schema: Schema) -> list[dict[str, Any]]:
    """The rows of a table whose columns are ``schema``'s, with numeric columns converted from text."""
    assert isinstance(schema, ListOf)
    assert isinstance(schema.inner, Mapping)
    text = user_files.read_text(path, CURE)
    header, *rows = csv.reader(io.StringIO(text, newline=""), delimiter="\t", strict=True)
    expect(text.endswith("\n") and header == list(schema.inner), f"its columns are {header} or its end is missing")
    kinds = {"f": float, "i": int}
    of = {name: kinds[field.kind] if isinstance(field, Numbers) else str for name, field in schema.inner.items()}
    return [{name: of[name](word) for name, word in zip(header, row, strict=True)} for row in rows]


def expect(holds: object, words: str) -> None:
    """Raises ValueError with ``words`` unless ``holds``: for conditions between the fields of a file."""
    if not holds:
        raise ValueError(words)


def require(path: Path, holds: object, words: str) -> None:
    """Raises UserError that names a step's file unless ``holds``: for conditions between the files of steps."""
    with step_file_context(path):
        expect(holds, words)


def expect_named(path: Path, owner: str) -> None:
    """Raises ValueError unless the file's name is that of the camera or person in it."""
    expect(path.stem == owner, f"it is {owner}'s, not {path.stem}'s")


def require_size(path: Path, picture: Shaped[np.ndarray, "H W ..."], wh: tuple[int, int]) -> None:
    """Raises UserError unless a step's picture has the size of its camera's."""
    width, height = picture.shape[1], picture.shape[0]
    require(path, (width, height) == tuple(wh), f"it is {width}×{height}, its camera's pictures are {wh[0]}×{wh[1]}")


@contextmanager
def step_file_context(path: Path) -> Iterator[None]:
    """Context for reading a step's file: a missing or wrong entry becomes a UserError that names the file."""
    try:
        yield
    except UserError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, csv.Error) as error:
        reason = f"it has no {error.args[0]!r}" if isinstance(error, KeyError) else user_files.first_line(error)
        raise UserError(f"{path} is damaged, or of another run or version of this program ({reason}); {CURE}") from None
