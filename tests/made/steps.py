# SPDX-License-Identifier: Apache-2.0
"""Steps called with one keyword per option, as their command lines have them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from studiorecon.__main__ import build_arguments


def call(function: Callable[..., Any], *settings: Any, **options: Any) -> Any:
    """What the function returns; ``options`` that are fields of a dataclass it takes become one."""
    return function(*settings, **build_arguments(function, options))
