# SPDX-License-Identifier: Apache-2.0
"""``report.strict``: ends a run with an error if it warned of anything, after all results are made.

Unattended pipelines with ``strict`` thereby distinguish a scene that lost a camera or a person from a complete one.
"""

from __future__ import annotations

from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.pages.run_summary import read_warnings
from studiorecon.progress import say
from studiorecon.scene.files import write_text
from studiorecon.signature import Place, Written


def run(page: Path, logs: Place, passed: Written) -> None:
    """Write ``passed`` if no log of the scene holds a warning; else list them and raise UserError."""
    found = read_warnings(logs)
    for step, sentence in found:
        say(f"{step}: {sentence}")
    if found:
        raise UserError(
            f"{len(found)} warning{'s' if len(found) > 1 else ''}, treated as errors (strict); all results are made, "
            f"and {page} lists them too"
        )
    write_text(passed, "no step warned\n")
