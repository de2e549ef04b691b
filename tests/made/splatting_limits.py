# SPDX-License-Identifier: Apache-2.0
"""What tests of splatting limits and their neighbours share."""

from __future__ import annotations

import numpy as np
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.splatting.cpu.rasterise import GaussianGradients, Rasteriser, Rendering
from studiorecon.splatting.cuda.rasterise import GsplatRasteriser

from tests.made.gaussians import camera

NEAR_M = 0.01


BASE: dict[str, np.ndarray] = {
    "means_m": np.array([0.0, 0.0, 3.0]),
    "quaternions": np.array([1.0, 0, 0, 0]),
    "log_scales": np.full(3, np.log(0.1)),
    "logit_opacities": np.array(1.0),
    "sh": np.full((16, 3), 0.1),
}


def one(**changes: object) -> Gaussians:
    """One ordinary Gaussian in view, with some values replaced."""
    values = {name: np.array(value, np.float64) for name, value in BASE.items()}
    for name, value in changes.items():
        values[name] = np.broadcast_to(np.asarray(value, np.float64), values[name].shape)
    return Gaussians(*(values[name][None] for name in BASE))


def cpu(antialias: bool = False) -> Rasteriser:
    return Rasteriser(near_m=NEAR_M, threads=2, antialias=antialias)


def run(
    gaussians: Gaussians, view: Camera, rasteriser: Rasteriser | GsplatRasteriser | None = None
) -> tuple[Rendering, GaussianGradients, Rasteriser | GsplatRasteriser]:
    rasteriser = rasteriser or cpu()
    rendering = rasteriser.forward(gaussians, view, (0.1, 0.2, 0.3))
    by = np.random.default_rng(0).normal(size=(*view.hw, 5)).astype(np.float32)
    return rendering, rasteriser.backward(by[..., :3], by[..., 3], by[..., 4]), rasteriser


def assert_finite(rendering: Rendering, gradients: GaussianGradients) -> None:
    for name, value in {**vars(rendering), **vars(gradients)}.items():
        assert value is None or np.isfinite(value).all(), name


POISON = {
    "G12 NaN mean": {"means_m": [np.nan, 0, 3]},
    "infinite mean": {"means_m": [0, 0, np.inf]},
    "mean at 1e18": {"means_m": [0, 0, 1e18]},
    "mean at 1e9": {"means_m": [1e9, 0, 3]},
    "inria 781 infinite scale": {"log_scales": [np.inf, 0, 0]},
    "scale 1e18": {"log_scales": np.log(1e18)},
    "NaN scale": {"log_scales": [np.nan, 0, 0]},
    "NaN quaternion": {"quaternions": [np.nan, 0, 0, 1]},
    "infinite quaternion": {"quaternions": [np.inf, 0, 0, 1]},
    "NaN opacity": {"logit_opacities": np.nan},
    "G12 NaN colour": {"sh": np.nan},
    "infinite colour": {"sh": np.inf},
    "colour 1e18": {"sh": 1e18},
}


DEGENERATE = {
    "G07 zero quaternion": {"quaternions": 0.0},
    "quaternion 1e-20": {"quaternions": 1e-20},
    "quaternion 1e18": {"quaternions": 1e18},
    "G05 scale exp(-60)": {"log_scales": -60.0},
    "scale 0": {"log_scales": -np.inf},
    "scale 1e-20": {"log_scales": np.log(1e-20)},
    "scale 1e6": {"log_scales": np.log(1e6)},
    "opacity 0": {"logit_opacities": -np.inf},
    "G08 opacity 1": {"logit_opacities": np.inf},
    "G13 logit 17": {"logit_opacities": 17.0},
    "G16 at the camera centre": {"means_m": camera(8, 8).centre_m},
    "G01 at the near plane": {"means_m": camera(8, 8).centre_m + camera(8, 8).forward * NEAR_M},
    "G01 just before the near plane": {"means_m": camera(8, 8).centre_m + camera(8, 8).forward * NEAR_M * 1.0001},
    "behind": {"means_m": [0, 0, -3.0]},
    "colour 1e6": {"sh": 1e6},
    "one flat axis": {"log_scales": [-np.inf, -2, -2]},
    "msplat 6 needle 1e6:1": {"log_scales": [np.log(5.0), np.log(5e-6), np.log(5e-6)]},
}
