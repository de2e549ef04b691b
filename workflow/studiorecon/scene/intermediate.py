# SPDX-License-Identifier: Apache-2.0
"""Files that one step writes and another reads: back they come whole and finite, or are named, with the cure.

A disk, a copy or somebody's hand may have damaged them since; NaN that got in would spread into everything that
follows, and nobody could tell from where.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene import outside

if TYPE_CHECKING:
    from jaxtyping import Shaped

_CURE = "delete it, and it is made again"


def read_arrays(
    path: Path, names: Iterable[str] | None = None, *, but: Container[str] = (), gaps: Container[str] = ()
) -> dict[str, Shaped[np.ndarray, " ..."]]:
    """The arrays of an npz that a step wrote: those of ``names``, or all but those of ``but``.

    Raises UserError that names the file and the array: missing, damaged, or with a number that is not finite where none
    may be (not in ``gaps``).
    """
    try:
        found = outside.read_npz(path, names=names, but=but, remedy=_CURE)
    except KeyError as error:
        raise UserError(_missing(path, error)) from None
    for name, array in found.items():
        if array.dtype.kind == "f" and name not in gaps and (bad := int((~np.isfinite(array)).sum())):
            raise UserError(f"{path} is damaged: {bad} of {array.size} numbers of {name} are not finite; {_CURE}")
    return found


def read_content(path: Path, *, gaps: Container[str] = ()) -> Any:
    """What a JSON file holds that a step wrote. A number that is not finite is written as null: only under the keys of
    ``gaps`` may one stand. Raises UserError as ``read_arrays`` does."""
    with as_written(path):
        value = outside.read_json(path, remedy=_CURE)
        if (key := _gap(value, gaps)) is not None:
            raise ValueError(f"a number is missing in {key or 'its list'}")
    return value


@contextmanager
def as_written(path: Path) -> Iterator[None]:
    """Around what takes values out of a file that a step wrote: what is missing in it, or of another kind, becomes a
    UserError that names it."""
    try:
        yield
    except UserError:
        raise
    except KeyError as error:
        raise UserError(_missing(path, error)) from None
    except (TypeError, ValueError, IndexError, AttributeError, ArithmeticError) as error:
        reason = outside.first_line(error)
        raise UserError(f"{path} is damaged, or of another version of this program ({reason}); {_CURE}") from None


def _missing(path: Path, error: KeyError) -> str:
    return f"{path} has no {error.args[0]!r}: it is damaged, or of another version of this program; {_CURE}"


def _gap(value: Any, allowed: Container[str]) -> str | None:
    """The key below which ``value`` holds a null or a number that is not finite; None where there is none."""
    waiting: list[tuple[str, Any]] = [("", value)]
    while waiting:
        key, here = waiting.pop()
        if isinstance(here, dict):
            waiting += [(str(name), below) for name, below in here.items()]
        elif isinstance(here, list):
            waiting += [(key, below) for below in here]
        elif (here is None or (isinstance(here, float) and not math.isfinite(here))) and key not in allowed:
            return key
    return None
