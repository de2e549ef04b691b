# SPDX-License-Identifier: Apache-2.0
"""``report.strict``: ends a run with an error if it warned of anything, after all results are made.

Unattended pipelines with ``strict`` thereby distinguish a scene that lost a camera or a person from a complete one.
"""

from __future__ import annotations

from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.pages.run_summary import read_warnings
from studiorecon.scene.files import write_text
from studiorecon.signature import Place, Written


def run(page: Path, logs: Place, passed: Written) -> None:
    """Write ``passed`` if no log of the scene holds a warning; else raise UserError with all of them."""
    found = [f"{step}: {sentence}" for step, sentence in read_warnings(logs)]
    if found:
        raise UserError(
            f"{len(found)} warning{'s' if len(found) > 1 else ''}, treated as errors (strict); all results are "
            f"made, and {page} lists them too:\n" + "\n".join(found)
        )
    write_text(passed, "no step warned\n")
