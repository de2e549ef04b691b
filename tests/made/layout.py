# SPDX-License-Identifier: Apache-2.0
"""What tests of layout and their neighbours share."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# The doors to torch inside the package, opened only by ``device: cuda``.
ON_REQUEST = {"splatting.cuda.tensor_set", "humans.tensor_person"}


def rules() -> list[tuple[str, str, str]]:
    """(rule file, step, text) of every rule that runs a step."""
    found = []
    for path in sorted((ROOT / "workflow/rules").glob("*.smk")):
        for block in re.split(r"\n(?= *(?:(?:use )?rule|checkpoint) )", path.read_text()):
            step = re.search(r"shell:\s+command\(\"(\w+\.\w+)\"\)", block)
            if step:
                found.append((path.name, step.group(1), block))
    return found
