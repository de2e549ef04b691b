# SPDX-License-Identifier: Apache-2.0
"""No step reads a file of the results that its rule does not name: every job runs where nothing else is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from tests.workflow.conftest import QUICK, House, make_house, over

# Looks at whatever other jobs have written so far about themselves.
READS_LOGS = {"report_page"}


def alone(house: House) -> int:
    """Have every rule of a house run in a folder that holds links to its inputs and nothing else; returns how many
    do."""
    count = 0
    for path in sorted((house.folder / "workflow/rules").glob("*.smk")):
        blocks = re.split(r"(\n *(?:rule|checkpoint) \w+:)", path.read_text())
        for index in range(2, len(blocks), 2):
            if blocks[index - 1].split()[-1].rstrip(":") not in READS_LOGS:
                blocks[index], made = re.subn(
                    r"^( +)resources:$", r'\1shadow:\n\1    "minimal"\n\1resources:', blocks[index], flags=re.M
                )
                count += made
        path.write_text("".join(blocks))
    return count


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_smallest_studio_runs_with_every_job_alone_with_its_inputs(tmp_path: Path) -> None:
    house = make_house(tmp_path / "alone", "resources/studio/tiny.yaml")
    settings = house.folder / "config/config.yaml"
    settings.write_text(yaml.safe_dump(over(yaml.safe_load(settings.read_text()), QUICK), sort_keys=False))
    assert alone(house) > 40
    house.snakemake("--cores", "2")
    assert (house.folder / "results/tiny/report/index.html").stat().st_size > 0
