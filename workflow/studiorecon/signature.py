# SPDX-License-Identifier: Apache-2.0
"""What the paths of a step's ``run`` are to its rule: their types say it, and the rule's command line follows.

A plain ``Path`` is read: an input of the rule.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

Written = Annotated[Path, "written"]
"""A file or folder that the step writes: an output of its rule."""

Place = Annotated[Path, "place"]
"""A place where the step finds or leaves things that are no product of any rule: weights, logs, working files; one of
the rule's params."""
