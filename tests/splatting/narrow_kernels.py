# SPDX-License-Identifier: Apache-2.0
"""Run in a process whose numba was told of a smaller machine: draws what the parent has prepared and looks at the
machine code.

NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=+avx2,+fma python narrow_kernels.py IN.npz OUT.npz
"""

from __future__ import annotations

import re
import sys

import numpy as np
from studiorecon.splatting.cpu import forward
from studiorecon.splatting.cpu.forward import LANE_OFFSETS


def assembly() -> str:
    """The machine code of every blending kernel that has been compiled in this process."""
    kernels = [k for k in vars(forward).values() if hasattr(k, "inspect_asm") and k.__module__ == forward.__name__]
    return "\n".join(text for kernel in kernels for text in kernel.inspect_asm().values())


def main(given: str, found: str) -> None:
    arrays = dict(np.load(given))
    planes, touched, ends = (
        np.empty_like(arrays["planes"]),
        np.zeros_like(arrays["touched"]),
        np.zeros_like(arrays["ends"]),
    )
    lists = (arrays["splats"], arrays["starts"], arrays["pairs"], touched, ends)
    forward.blend(
        1, *arrays["grid"].tolist(), *lists, np.zeros(3, np.float32), LANE_OFFSETS, planes, np.zeros(1, np.int64)
    )
    text = assembly()
    # A fused product-sum that the machine lacks would be a call of the C library for each of the sixteen lanes.
    calls = re.findall(r"\b(?:fmaf?|fmal)\b(?!\w)", text)
    np.savez(
        found,
        planes=planes,
        ends=ends,
        wide=np.array("zmm" in text),
        middle=np.array("ymm" in text),
        fused=np.array("vfmadd" in text),
        size=np.array(len(text)),
        calls=np.array(len(calls)),
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
