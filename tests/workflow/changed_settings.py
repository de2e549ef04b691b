# SPDX-License-Identifier: Apache-2.0
"""Which rules of a finished scene would run again, for many changed settings: ``python changed_settings.py DATASET
OVERLAY.yaml ...``

Prints a line of JSON per overlay, the rules whose own parameters differ from what Snakemake remembers of the run; null
where the plan is refused. Snakemake is imported once
and forked per overlay. Rules are compared one by one (rerun by time only): what follows from a change is not mixed with
what it changes.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile

from snakemake.cli import main
from snakemake.persistence import ParamsChange

# Snakemake lists the files of unchanged parameters too, which its own plan does not take for changed.
ParamsChange.__iter__ = lambda self: iter(self.files if self else ())


def printed(*arguments: str) -> list[str]:
    """Lines that one call of Snakemake prints, made in a fork of this process; raises RuntimeError with its messages
    when it fails."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as messages:
        child = os.fork()
        if child == 0:
            os.dup2(out.fileno(), 1)
            os.dup2(messages.fileno(), 2)
            status = 1
            try:
                main(["--quiet", "all", "--rerun-triggers", "mtime", *arguments])
            except SystemExit as ended:
                status = int(ended.code or 0)
            finally:
                sys.stdout.flush()
                os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        out.seek(0)
        messages.seek(0)
        lines, told = out.read().splitlines(), messages.read()
    if status:
        raise RuntimeError(told)
    return lines


def rules_by_output(*arguments: str) -> dict[str, str]:
    """Output file → rule of everything in the scene."""
    table = [line.split("\t") for line in printed("--summary", *arguments)]
    return {row[0]: row[2] for row in table[1:]}


if __name__ == "__main__":
    dataset, *overlays = sys.argv[1:]
    given = ("--cores", "2", "--config", f"dataset={dataset}")
    rule = rules_by_output(*given)
    for overlay in overlays:
        try:
            changed = printed("--list-changes", "params", "--configfile", overlay, *given)
        except RuntimeError:
            print("null", flush=True)
        else:
            print(json.dumps(sorted({rule[line] for line in changed if line.strip()})), flush=True)
