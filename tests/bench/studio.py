# SPDX-License-Identifier: Apache-2.0
"""How long the synthetic studio needs for its demo, and where the time goes: ``python tests/bench/studio.py
[description.yaml]``.

Prints wall and processor seconds, peak memory of one camera's process and the size of what was written. Run it on an
idle machine: two processes film side by side, so on two cores the wall time is half the processor time and the start.
"""

from __future__ import annotations

import os
import platform
import resource
import sys
import tempfile
import time
from pathlib import Path

from studiorecon.studio import capture
from studiorecon.studio.description import RESOURCES, read_description


def main() -> None:
    description = Path(sys.argv[1]) if len(sys.argv) > 1 else RESOURCES / "studio" / "demo.yaml"
    described = read_description(description)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.2f}")
    with tempfile.TemporaryDirectory() as folder:
        started = time.monotonic()
        capture.run(description, Path(folder) / "dataset", Path(folder) / "truth")
        wall_s = time.monotonic() - started
        size = {
            part: sum(p.stat().st_size for p in (Path(folder) / part).rglob("*") if p.is_file()) / 1e6
            for part in ("dataset", "truth")
        }
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    pictures = len(described.names) * described.frames
    print(
        f"{description.stem}: {wall_s:.1f} s wall, "
        f"{children.ru_utime + children.ru_stime:.1f} s processor, {pictures} pictures"
    )
    print(f"{1000 * wall_s / pictures:.0f} ms per picture; peak {children.ru_maxrss / 1024:.0f} MB per process (of 2)")
    print(f"dataset {size['dataset']:.1f} MB, truth {size['truth']:.1f} MB")


if __name__ == "__main__":
    main()
