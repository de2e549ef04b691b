# SPDX-License-Identifier: Apache-2.0
"""Reductions over the channels of every pixel: numpy's own along a last axis of three take 6 to 12 times as long."""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Num


def channel_max(picture: Num[np.ndarray, "*P C"]) -> Num[np.ndarray, "*P"]:
    """The greatest channel of every pixel of a picture: bit for bit ``picture.max(axis=-1)``."""
    return reduce(np.maximum, np.moveaxis(picture, -1, 0))


def channel_sum(picture: Num[np.ndarray, "*P C"]) -> Num[np.ndarray, "*P"]:
    """The sum of the channels of every pixel of a picture, in its own type, which must hold it.

    For floats and up to seven channels it is ``picture.sum(axis=-1)``, bit for bit.
    """
    return reduce(np.add, np.moveaxis(picture, -1, 0))
