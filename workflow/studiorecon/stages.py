# SPDX-License-Identifier: Apache-2.0
"""The one list of stages. Each has its rules in ``workflow/rules``, a folder here and a folder of tests of its name."""

from __future__ import annotations

# In the order of the data. No stage imports another one, and no rule takes an input of a later one.
STAGES: tuple[str, ...] = (
    "detect",
    "clocks",
    "calibration",
    "capture",
    "tracks",
    "plates",
    "cameras",
    "people",
    "depth",
    "survey",
    "objects",
    "masks",
    "views",
    "background",
    "humans",
    "render",
    "enhance",
    "deliver",
    "report",
)
