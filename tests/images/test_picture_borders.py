# SPDX-License-Identifier: Apache-2.0
"""What the functions on pictures say about arguments that do not fit: the argument's name and its shape."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from studiorecon.footage.exr import write_depth
from studiorecon.footage.stills import shrink
from studiorecon.images import metrics
from studiorecon.images.blur import gaussian_blur
from studiorecon.images.exposure import Overlap, compare, solve_gains
from studiorecon.images.flow import consistent, grey_levels
from studiorecon.images.plate import noise_levels, temporal_modes, write_plate
from studiorecon.images.regions import dilate, signed_distance_px, without_holes, without_islands
from studiorecon.images.silhouette import front_person, mesh_depth
from studiorecon.images.similarity import similarity_map
from studiorecon.images.warp import sample, warp

from tests.made.cameras import ring


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


CASES = {
    "sample-image": (lambda: sample(zeros(5), zeros(2, 2, 2)), r"image has shape \(5,\), expected \(H, W, \.\.\.\)"),
    "sample-pixels": (lambda: sample(zeros(5, 5), zeros(7, 2)), r"pixels has shape \(7, 2\), expected \(h, w, 2\)"),
    "warp": (lambda: warp(zeros(5, 5), zeros(5, 5, 3)), r"flow has shape \(5, 5, 3\)"),
    "blur": (lambda: gaussian_blur(zeros(5), 3, 1.0), r"image has shape \(5,\)"),
    "compare": (
        lambda: compare(0, 1, zeros(5, 3), zeros(6, 3), 1),
        r"second_rgb has shape \(6, 3\), expected \(N, 3\) with N = 5",
    ),
    "mesh": (lambda: mesh_depth(zeros(5, 2), np.zeros((1, 3), int), ring(1)[0]), r"vertices_m has shape \(5, 2\)"),
    "mesh-faces": (lambda: mesh_depth(zeros(5, 3), np.full((1, 3), 5), ring(1)[0]), "faces name vertices 5 to 5"),
    "plate": (
        lambda: temporal_modes(np.zeros((3, 4, 5, 3), np.uint8), np.ones((2, 4, 5), bool), 8.0),
        r"free has shape \(2, 4, 5\)",
    ),
    "plate-kind": (lambda: temporal_modes(zeros(3, 4, 5, 3), np.ones((3, 4, 5), bool), 8.0), "frames are float32"),
    "dilated": (lambda: dilate(np.ones((3, 4, 5), bool), 3), r"region has shape \(3, 4, 5\)"),
    "consistent": (lambda: consistent(zeros(5, 5, 2), zeros(5, 6, 2)), r"reverse_flow has shape \(5, 6, 2\)"),
    "grey": (lambda: grey_levels(zeros(5, 5)), r"rgb has shape \(5, 5\)"),
    "noise": (lambda: noise_levels(zeros(5, 5, 3)), r"frames has shape \(5, 5, 3\)"),
    "distance": (lambda: signed_distance_px(zeros(5)), r"region has shape \(5,\)"),
    "islands": (lambda: without_islands(zeros(5), 3), r"region has shape \(5,\)"),
    "holes": (lambda: without_holes(zeros(5), 3), r"region has shape \(5,\)"),
    "front": (lambda: front_person(zeros(5, 5)), r"depths_m has shape \(5, 5\)"),
    "errors": (lambda: metrics.error_map(zeros(5, 5, 3), zeros(5, 6, 3)), "truth has shape .* with H = 5, W = 5"),
    "psnr-mask": (
        lambda: metrics.psnr(zeros(5, 5, 3), zeros(5, 5, 3), np.ones((4, 5), bool)),
        r"mask has shape \(4, 5\)",
    ),
    "corrected": (lambda: metrics.colour_corrected_psnr(zeros(5, 5, 3), zeros(5, 5)), r"truth has shape \(5, 5\)"),
    "ssim": (lambda: metrics.ssim_map(zeros(5, 5, 3), zeros(5, 6, 3)), r"truth has shape \(5, 6, 3\)"),
    "ssim-mask": (lambda: metrics.ssim(zeros(20, 20), np.ones((20, 21), bool)), r"mask has shape \(20, 21\)"),
    "ssim-3dgs": (lambda: metrics.ssim_3dgs(zeros(20)), r"similarity has shape \(20,\)"),
    "windows": (lambda: metrics.whole_windows(np.ones(20, bool)), r"mask has shape \(20,\)"),
    "inside": (lambda: metrics.mean_inside(zeros(5, 5), np.ones((5, 6), bool)), r"mask has shape \(5, 6\)"),
    "change": (
        lambda: metrics.change_maps(zeros(5, 5, 3), zeros(5, 5, 3), zeros(5, 5, 3), np.ones((5, 5), bool)),
        r"backward has shape \(5, 5, 3\)",
    ),
    "similarity": (lambda: similarity_map(zeros(5, 5, 3), zeros(4, 5, 3)), r"second has shape \(4, 5, 3\)"),
    "gains": (lambda: solve_gains(2, [Overlap(0, 1, np.array([0, np.nan, 0]), 9)]), "log_ratio of cameras 0 and 1"),
    "shrink": (lambda: shrink(zeros(5, 5, 3), np.ones((5, 4), bool), (2, 2)), r"measured has shape \(5, 4\)"),
    "plate-file": (
        lambda: write_plate(Path("no.png"), zeros(5, 5, 3), np.ones((5, 4), bool)),
        r"measured has shape \(5, 4\)",
    ),
    "depth-file": (lambda: write_depth(Path("no.exr"), zeros(5, 5), zeros(5, 4)), r"confidence has shape \(5, 4\)"),
}


@pytest.mark.parametrize("case", CASES)
def test_arguments_that_do_not_fit_are_named(case: str) -> None:
    call: Callable[[], object]
    call, message = CASES[case]
    with pytest.raises(ValueError, match=message):
        call()
