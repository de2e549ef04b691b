# SPDX-License-Identifier: Apache-2.0
"""Plans of Snakemake one after another, each in a fork of one process that has imported it: ``python planner.py``.

A line of JSON says what to call (``arguments``), in which folder, with which environment, and where to write what is
printed; a line with the exit status answers. Most of a plan's time is the import of Snakemake and its plugins.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path


def planned(arguments: list[str], folder: str, environment: dict[str, str], printed: str) -> int:
    """The exit status of one call of Snakemake; what it prints stands in the file ``printed``."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            out = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            sys.path[:0] = [place for place in environment.get("PYTHONPATH", "").split(os.pathsep) if place]
            sys.pycache_prefix = environment.get("PYTHONPYCACHEPREFIX")
            sys.argv = ["snakemake", *arguments]
            main(arguments)
        except SystemExit as ended:
            status = int(ended.code or 0)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


if __name__ == "__main__":
    # Not this folder's modules: the package comes from the copy that is planned.
    sys.path.remove(str(Path(__file__).parent))
    import jsonschema  # noqa: F401 asked by every plan
    import yaml  # noqa: F401 asked by every plan
    from snakemake.cli import get_argument_parser, main
    from snakemake.persistence import ParamsChange

    # Snakemake lists the files of unchanged parameters too, which its own plan does not take for changed.
    ParamsChange.__iter__ = lambda self: iter(self.files if self else ())
    get_argument_parser()  # finds the plugins, of which one is the package's own: not the copy's
    for name in [name for name in sys.modules if name.partition(".")[0] == "studiorecon"]:
        del sys.modules[name]
    for line in sys.stdin:
        print(planned(**json.loads(line)), flush=True)
