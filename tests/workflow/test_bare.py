# SPDX-License-Identifier: Apache-2.0
"""A finished run needs nothing but Python and the wheels: no library of the system, and nobody to talk to."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.workflow.conftest import House

# The C and C++ runtime and the loader: what every wheel may count on (manylinux).
RUNTIME = re.compile(
    r"(ld-linux-[\w-]+|libc|libm|libmvec|libdl|librt|libutil|libpthread|libgcc_s|libstdc\+\+)(-[\d.]+)?\.so(\.\d+)*"
)
# Everything that Python's own modules load, without any installed package.
PYTHONS_OWN = """
import importlib, pkgutil, sys
from pathlib import Path
for name in sorted(sys.builtin_module_names + tuple(p.name.partition(".")[0] for p in Path(sys.argv[1]).glob("*.so"))):
    try:
        importlib.import_module(name)
    except Exception:
        pass
print(open("/proc/self/maps").read())
"""

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/maps").exists(), reason="the system does not tell what a process has loaded"
)


def processes(finished: House) -> list[dict]:
    """What the Python processes of the finished run wrote down when they ended."""
    return [json.loads(path.read_text()) for path in sorted(finished.witness.glob("*.json"))]


def pythons_own() -> set[str]:
    """File names of the shared objects that the bare interpreter and its standard library load."""
    modules = next(p for p in sys.path if p.endswith("lib-dynload"))
    # -S: without the environment's packages; its exit status does not matter once the objects are told.
    maps = subprocess.run(
        [sys.executable, "-I", "-S", "-c", PYTHONS_OWN, modules], text=True, capture_output=True, check=False
    ).stdout
    return {Path(line.split(maxsplit=5)[5]).name for line in maps.splitlines() if ".so" in line}


def test_nothing_is_loaded_that_the_wheels_and_python_do_not_bring(finished: House) -> None:
    reported = processes(finished)
    steps = {entry["command"][1] for entry in reported if entry["command"][0].endswith("studiorecon/__main__.py")}
    assert steps >= {
        "studio.capture",
        "capture.frames",
        "people.fit",
        "depth.sweep",
        "humans.train",
        "render.shot",
        "report.page",
    }
    inside = tuple(
        str(Path(folder).resolve()) + os.sep
        for folder in (sys.prefix, sys.base_prefix, sys.base_exec_prefix)
        if folder != "/usr"
    )
    own = pythons_own()
    strangers: dict[str, set[str]] = {}
    for entry in reported:
        for path in entry["objects"]:
            if not path.startswith(inside) and not RUNTIME.fullmatch(Path(path).name) and Path(path).name not in own:
                strangers.setdefault(path, set()).add(" ".join(entry["command"][1:2]))
    assert not strangers, "shared objects from outside the environment, and who loads them"


def test_nothing_is_requested_from_any_other_machine(finished: House) -> None:
    requested = {" ".join(entry["command"][:2]): entry["reached"] for entry in processes(finished) if entry["reached"]}
    assert not requested
