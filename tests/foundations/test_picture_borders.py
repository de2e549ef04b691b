# SPDX-License-Identifier: Apache-2.0
"""What the functions on pictures say about arguments that do not fit: the argument's name and its shape."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from studiorecon.images.blur import gaussian_blur
from studiorecon.images.exposure import compare
from studiorecon.images.flow import chained, consistent
from studiorecon.images.plate import temporal_modes
from studiorecon.images.regions import dilated, iou
from studiorecon.images.silhouette import mesh_depth
from studiorecon.images.warp import sample, warp

from tests.foundations.camera_ring import ring


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


CASES = {
    "sample-image": (lambda: sample(zeros(5), zeros(2, 2, 2)), r"image has shape \(5,\), expected \(H, W, \.\.\.\)"),
    "sample-pixels": (lambda: sample(zeros(5, 5), zeros(7, 2)), r"pixels has shape \(7, 2\), expected \(h, w, 2\)"),
    "warp": (lambda: warp(zeros(5, 5), zeros(5, 5, 3)), r"flow has shape \(5, 5, 3\)"),
    "blur": (lambda: gaussian_blur(zeros(5), 3, 1.0), r"image has shape \(5,\)"),
    "compare": (lambda: compare(0, 1, zeros(5, 3), zeros(6, 3), 1), r"second_rgb has shape \(6, 3\), expected \(N, 3\) with N = 5"),
    "mesh": (lambda: mesh_depth(zeros(5, 2), np.zeros((1, 3), int), ring(1)[0]), r"vertices_m has shape \(5, 2\)"),
    "mesh-faces": (lambda: mesh_depth(zeros(5, 3), np.full((1, 3), 5), ring(1)[0]), "faces name vertices 5 to 5"),
    "plate": (lambda: temporal_modes(np.zeros((3, 4, 5, 3), np.uint8), np.ones((2, 4, 5), bool), 8.0), r"free has shape \(2, 4, 5\)"),
    "plate-kind": (lambda: temporal_modes(zeros(3, 4, 5, 3), np.ones((3, 4, 5), bool), 8.0), "frames are float32"),
    "dilated": (lambda: dilated(np.ones((3, 4, 5), bool), 3), r"region has shape \(3, 4, 5\)"),
    "iou": (lambda: iou(np.ones((3, 4), bool), np.ones((4, 4), bool)), r"second has shape \(4, 4\), expected \(3, 4\)"),
    "consistent": (lambda: consistent(zeros(5, 5, 2), zeros(5, 6, 2)), r"reverse_flow has shape \(5, 6, 2\)"),
    "chained": (lambda: chained(zeros(5, 5, 2), np.ones((5, 5), bool), zeros(6, 5, 2), np.ones((6, 5), bool)), "further has shape"),
}


@pytest.mark.parametrize("case", CASES)
def test_arguments_that_do_not_fit_are_named(case: str) -> None:
    call: Callable[[], object]
    call, message = CASES[case]
    with pytest.raises(ValueError, match=message):
        call()
