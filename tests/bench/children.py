# SPDX-License-Identifier: Apache-2.0
"""Measurements that need a process of their own: cold and cached start, peak memory, other instruction sets.

python -m tests.bench.children start | memory | raster
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
INSTRUCTION_SETS = {"AVX2": ("haswell", "+avx2,+fma"), "SSE": ("x86-64", "-avx,-avx2,-fma,-avx512f")}
"""Name → what numba is told the machine has (NUMBA_CPU_NAME, NUMBA_CPU_FEATURES)."""


def start() -> dict[str, float]:
    """One whole training step, so that every kernel of the loop is compiled or read from the cache."""
    import numpy as np
    from studiorecon.splatting.cpu.rasterise import Rasteriser
    from studiorecon.splatting.train.still import train_still as train
    from studiorecon.splatting.train.targets import Target

    from tests.made.gaussians import camera, room
    from tests.made.splatting_settings import SETTINGS

    scene, view = room(2000, 0), camera(96, 56)
    target = Target(view, Rasteriser(near_m=0.01).forward(scene, view).rgb.clip(0, 1))
    train(scene, [target], _shortened(SETTINGS, 1), np.random.default_rng(0), extent_m=4.0)
    return {}


def memory(count: int = 300_000, width: int = 1280, height: int = 704) -> dict[str, float]:
    """Peak resident memory of training steps with loss and Adam on one picture, GB."""
    import numpy as np
    from studiorecon.splatting.train.still import train_still as train
    from studiorecon.splatting.train.targets import Target

    from tests.made.gaussians import camera, room
    from tests.made.splatting_settings import SETTINGS

    target = Target(camera(width, height), np.random.default_rng(0).random((height, width, 3), np.float32))
    train(room(count, 0), [target], _shortened(SETTINGS, 3), np.random.default_rng(0), extent_m=4.0, threads=2)
    # Not ru_maxrss: that of a process that another one started includes what its parent held.
    peak = next(
        line for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines() if line.startswith("VmHWM")
    )
    return {"peak_gb": int(peak.split()[1]) * 1024 / 1e9}


def raster(count: int = 50_000, width: int = 320, height: int = 176, rounds: int = 40) -> dict[str, float]:
    """Least processor milliseconds of the blending kernels forward and back, on one thread."""
    import numpy as np
    from studiorecon.splatting.cpu.blocks import block, morton_order
    from studiorecon.splatting.cpu.rasterise import Rasteriser

    from tests.bench.splats import best_ms, raster_of
    from tests.made.gaussians import camera, room

    scene, rasteriser = room(count, 0), Rasteriser(near_m=0.01, threads=1)
    by = np.random.default_rng(0).normal(size=(5, height, width)).astype(np.float32)
    with rasteriser.own_threads():
        rasteriser.draw(block(scene.take(morton_order(scene.means_m))), camera(width, height), (0, 0, 0))
        rasteriser.gather(by)
        _, ms = best_ms({"raster": raster_of(rasteriser, by)}, rounds)
    return {"ms": ms["raster"]}


def _shortened(settings, iterations: int):
    from dataclasses import replace

    return replace(settings, iterations=iterations, sh_degree=3, warmup_half_resolution=0.0)


def ask(what: str, cache: Path, instruction_set: str = "") -> dict[str, float]:
    """Runs one of the above in a fresh process; its answer, with seconds of wall and of processor time.

    On an idle machine the two agree for what one thread does, as compiling and importing; on a busy one only the latter
    means something.
    """
    # Byte code is kept with the kernels, also where the machine's setting is to write none.
    kept = {
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONDONTWRITEBYTECODE": "",
        "PYTHONPYCACHEPREFIX": str(cache / "bytecode"),
    }
    environment = {**os.environ, **kept, "PYTHONPATH": f"{ROOT / 'workflow'}:{ROOT}"}
    if instruction_set:
        environment["NUMBA_CPU_NAME"], environment["NUMBA_CPU_FEATURES"] = INSTRUCTION_SETS[instruction_set]
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "tests.bench.children", what]
    answer = subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {**json.loads(answer.splitlines()[-1]), "wall_s": time.perf_counter() - began, "processor_s": spent}


def prototype(folder: Path, iterations: int) -> dict[str, float]:
    """The design's sketch doing the same: cold and cached start (processor s), and seconds of a training of 50,000 at
    320×176.

    What its figures are here, beside those it had where the bars were set, says how fast this machine is.
    """
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        kept = {
            "NUMBA_CACHE_DIR": name,
            "PYTHONDONTWRITEBYTECODE": "",
            "PYTHONPYCACHEPREFIX": str(Path(name) / "bytecode"),
        }

        def train(*arguments: str) -> tuple[float, str]:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, str(folder.resolve() / "train.py"), *arguments, "2", "vis"]
            said = subprocess.run(
                command, env={**os.environ, **kept}, check=True, stdout=subprocess.PIPE, text=True
            ).stdout
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, said

        found["cold_s"] = train("1", "2000", "96", "56")[0]
        found["cached_s"] = min(train("1", "2000", "96", "56")[0] for _ in range(2))
        said = train(str(iterations), "50000", "320", "176")[1]
        found["training_s"] = float(said.rpartition(" iterations ")[2].split()[0])
    return found


def all_of_them() -> dict[str, dict[str, float]]:
    """Every measurement, with a cache that nobody has filled before."""
    with tempfile.TemporaryDirectory() as name:
        cache = Path(name)
        found = {"cold": ask("start", cache)}
        found["cached"] = min((ask("start", cache) for _ in range(2)), key=lambda answer: answer["processor_s"])
        found["memory"] = ask("memory", cache)
        for instruction_set in INSTRUCTION_SETS:
            found[instruction_set] = ask("raster", cache, instruction_set)
        return found


if __name__ == "__main__":
    print(json.dumps({"start": start, "memory": memory, "raster": raster}[sys.argv[1]]()))
