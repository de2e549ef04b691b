# SPDX-License-Identifier: Apache-2.0
"""Run in a process whose numba was told of a smaller machine: draws what the parent has prepared and looks at the
machine code.

NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=+avx2,+fma python narrow_kernels.py IN.npz OUT.npz blend|everything
"""

from __future__ import annotations

import re
import sys

import numpy as np
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu import adam, backward, forward, projection, projection_gradient
from studiorecon.splatting.cpu import ssim as similarity
from studiorecon.splatting.cpu.forward import LANE_OFFSETS
from studiorecon.splatting.cpu.rasterise import Rasteriser

KERNELS = {"blend": (forward,), "everything": (forward, backward, projection, projection_gradient, adam, similarity)}


def assembly(modules: tuple) -> str:
    """The machine code of every kernel of the modules that has been compiled in this process."""
    kernels = [
        k
        for module in modules
        for k in vars(module).values()
        if hasattr(k, "inspect_asm") and k.__module__ == module.__name__
    ]
    return "\n".join(text for kernel in kernels for text in kernel.inspect_asm().values())


def main(given: str, found: str, what: str) -> None:
    arrays = dict(np.load(given))
    drawn = {}
    if what == "blend":
        planes, touched, ends = (
            np.empty_like(arrays["planes"]),
            np.zeros_like(arrays["touched"]),
            np.zeros_like(arrays["ends"]),
        )
        lists = (arrays["splats"], arrays["starts"], arrays["pairs"], touched, ends)
        forward.blend(
            1, *arrays["grid"].tolist(), *lists, np.zeros(3, np.float32), LANE_OFFSETS, planes, np.zeros(1, np.int64)
        )
        drawn = {"planes": planes, "touched": touched, "ends": ends}
    else:
        fields = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")
        camera = Camera("narrow", tuple(arrays["wh"].tolist()), arrays["intrinsics"], arrays["camera_from_world"])
        rasteriser = Rasteriser(near_m=0.01, threads=1)
        drawn["rgb"] = rasteriser.forward(Gaussians(*(arrays[name] for name in fields)), camera).rgb
        gradients = rasteriser.backward(arrays["by"])
        drawn |= {name: getattr(gradients, name) for name in fields}
    text = assembly(KERNELS[what])
    # A fused product-sum that the machine lacks would be a call of the C library for each of the sixteen lanes.
    calls = re.findall(r"\b(?:fmaf?|fmal)\b(?!\w)", text)
    np.savez(
        found,
        **drawn,
        wide=np.array("zmm" in text),
        middle=np.array("ymm" in text),
        fused=np.array("vfmadd" in text),
        size=np.array(len(text)),
        calls=np.array(len(calls)),
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
