# SPDX-License-Identifier: Apache-2.0
"""The types that mark the paths of a step's ``run`` as inputs or outputs; the rule's command line is made from them.

A plain ``Path`` is an input of the rule.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

Written = Annotated[Path, "written"]
"""A file or folder that the step writes: an output of its rule."""

Place = Annotated[Path, "place"]
"""A place for files that no rule makes: weights, logs, working files; one of the rule's params."""
