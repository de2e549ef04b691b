# SPDX-License-Identifier: Apache-2.0
"""Names are data: whatever stands in a rule's shell line is quoted for the shell, and no rule writes such a line by
hand."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from snakemake.utils import QuotedFormatter
from studiorecon.plan.command import command

from tests.made.layout import ROOT, rules

STEPS = sorted({step for _, step, _ in rules()})
HOSTILE = ["$(touch x)", "`touch x`", "a&b", "a b", "-rf", "a\nb", "';touch x;'"]


@pytest.mark.parametrize("step", STEPS)
def test_every_placeholder_is_quoted(step: str) -> None:
    places = re.findall(r"\{[^}]*\}", command(step))
    assert places
    assert not [place for place in places if not place.endswith(":q}") and place != "{threads}"]


@pytest.mark.parametrize("path", sorted((ROOT / "workflow/rules").glob("*.smk")), ids=lambda p: p.name)
def test_no_rule_writes_its_shell_line_by_hand(path: Path) -> None:
    lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    after = [lines[k + 1] for k, line in enumerate(lines) if line == "shell:"]
    assert not [line for line in after if not re.fullmatch(r'command\("[\w.]+"\)', line)]
    assert not [line for line in lines if line.startswith("shell:") and line != "shell:"]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_reaches_a_step_as_one_word(name: str) -> None:
    """Quoted as Snakemake quotes, and taken apart again as a shell does."""
    line = QuotedFormatter().format("python --camera {camera:q}", camera=name)
    assert shlex.split(line) == ["python", "--camera", name]
