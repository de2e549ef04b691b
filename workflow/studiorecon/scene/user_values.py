# SPDX-License-Identifier: Apache-2.0
"""Checks values of users' files: mappings, lists, numbers in ranges.

Every function takes ``where``, the beginning of a sentence that names file and key (``capture.yaml: focal_px of cam1``)
and raises UserError with it.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_SHOWN = 60
"""Number of characters shown of a refused value."""
_LONGEST_NAME = 255
_SHORT = reprlib.Repr()
_SHORT.maxstring, _SHORT.maxother, _SHORT.maxlong = 2 * MAX_SHOWN, 2 * MAX_SHOWN, MAX_SHOWN
_SHORT.fillvalue = "…"


def short_text(value: Any) -> str:
    """A value for a sentence: on one line, and not too long."""
    try:
        text = " ".join(_SHORT.repr(value).split())
    except ValueError:  # of an endless number
        text = type(value).__name__
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 1] + "…"


def as_mapping(value: Any, where: str, example: str) -> Mapping[Any, Any]:
    """``value``, which must be a mapping from names such as ``example``; None becomes an empty one."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise UserError(f"{where} is {short_text(value)}; it must have the form {example}")
    return value


def as_list(value: Any, where: str, example: str) -> list[Any]:
    """``value``, which must be a list such as ``example``, and not text; None becomes an empty one."""
    if value is None:
        return []
    if not isinstance(value, (list, tuple)):
        raise UserError(f"{where} is {short_text(value)}; it must be a list, such as {example}")
    return list(value)


def name(value: Any, where: str) -> str:
    """``value`` as a name or path: text, or a whole number, which YAML makes of 01 and the like."""
    if isinstance(value, bool) or not isinstance(value, (str, int)) or value == "":
        raise UserError(f"{where} is {short_text(value)}; it must be text")
    return str(value)


def path(value: Any, where: str) -> str:
    """``value`` as a path, with / for the \\ of Windows, whose parts are no longer than systems allow."""
    found = name(value, where).replace("\\", "/")
    if max(map(len, found.split("/"))) > _LONGEST_NAME or "\0" in found:
        raise UserError(f"{where} is {short_text(found)}; no file can be called so")
    return found


def number(value: Any, where: str, low: float, high: float, what: str) -> float:
    """``value`` as a finite number within ``low`` … ``high``; ``what`` names the expected quantity, with its unit."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise UserError(f"{where} is {short_text(value)}; it must be {what}{_as_text(value)}")
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not low <= found <= high:
        raise UserError(f"{where} is {short_text(value)}; it must be {what}")
    return found


def whole(value: Any, where: str, low: int, high: int, what: str = "a whole number") -> int:
    """``value`` as a whole number within ``low`` … ``high``."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not low <= value <= high:
        raise UserError(f"{where} is {short_text(value)}; it must be {what} from {low} to {high}{_as_text(value)}")
    return int(value)


def _as_text(value: Any) -> str:
    digits = isinstance(value, str) and any(letter.isdecimal() for letter in value)
    return ", in plain decimal digits without quotes or leading zeros" if digits else ""


def numbers(value: Any, where: str, *, finite: bool = True) -> Float[np.ndarray, " ..."]:
    """Float64 array of a number, or of lists of numbers of one length; missing ones (null) are NaN.

    With ``finite`` none of them may be NaN, infinite or missing.
    """
    try:
        array = np.asarray(value)
        if _holds_truth(value):
            raise ValueError
        if array.dtype == object and _plain(array):
            array = np.array([math.nan if v is None else v for v in array.reshape(-1)], float).reshape(array.shape)
        if isinstance(value, np.ndarray) and array.dtype.kind not in "iufO":
            raise UserError(f"{where}: the array holds {array.dtype}; it must hold real numbers")
        if array.dtype.kind not in "iuf":
            raise ValueError
        array = array.astype(np.float64)
    except (ValueError, TypeError, OverflowError, RecursionError):
        raise UserError(f"{where}: {short_text(value)} are not numbers in lists of one length") from None
    if finite and not np.isfinite(array).all():
        raise UserError(f"{where} holds a number that is not finite ({short_text(value)})")
    return array


def _holds_truth(value: Any) -> bool:
    """Whether lists hold true or false, which NumPy would count as 1 or 0."""
    kinds = set(map(type, value)) if isinstance(value, (list, tuple)) else set()
    return bool in kinds or (not kinds.isdisjoint((list, tuple)) and any(map(_holds_truth, value)))


def _plain(array: np.ndarray) -> bool:
    return all(v is None or (isinstance(v, (int, float)) and not isinstance(v, bool)) for v in array.reshape(-1))
