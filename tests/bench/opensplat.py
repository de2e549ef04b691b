# SPDX-License-Identifier: Apache-2.0
"""OpenSplat's rasteriser for the CPU, built from an unpacked source beside its own torch: never part of this project.

Its program wants OpenCV's headers and fetches four libraries; its drawing and its gradients are one file that needs
torch alone, and are called as its ``model.cpp`` and ``rasterize_gaussians.cpp`` call them, with our nearest depth. It
draws colours and opacity but no depth, so it has less to sum than ours.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians

# Every pixel's Gaussians stay on C++'s side until the gradients are done.
_BINDINGS = """
#include <torch/extension.h>
#include "bindings.h"
using Lists = std::vector<int32_t>;
namespace py = pybind11;

PYBIND11_MODULE(TORCH_EXTENSION_NAME, m) {
  m.def("project", [](torch::Tensor means, torch::Tensor scales, torch::Tensor quats, torch::Tensor view,
                      torch::Tensor clip, float fx, float fy, float cx, float cy, int height, int width, float near) {
    return project_gaussians_forward_tensor_cpu(means.size(0), means, scales, 1.0f, quats, view, clip, fx, fy, cx, cy,
                                                height, width, near);
  });
  m.def("colours", [](int degree, torch::Tensor directions, torch::Tensor sh) {
    return compute_sh_forward_tensor_cpu(directions.size(0), degree, degree, directions, sh);
  });
  m.def("draw", [](int width, int height, torch::Tensor xys, torch::Tensor conics, torch::Tensor colours,
                   torch::Tensor opacities, torch::Tensor background, torch::Tensor cov2d, torch::Tensor depths) {
    auto drawn =
        rasterize_forward_tensor_cpu(width, height, xys, conics, colours, opacities, background, cov2d, depths);
    py::capsule lists(std::get<2>(drawn), [](void *held) { delete[] static_cast<Lists *>(held); });
    return py::make_tuple(std::get<0>(drawn), std::get<1>(drawn), lists);
  });
  m.def("gather", [](int height, int width, torch::Tensor xys, torch::Tensor conics, torch::Tensor colours,
                     torch::Tensor opacities, torch::Tensor background, torch::Tensor cov2d, torch::Tensor depths,
                     torch::Tensor rest, py::capsule lists, torch::Tensor by_rgb, torch::Tensor by_alpha) {
    return rasterize_backward_tensor_cpu(height, width, xys, conics, colours, opacities, background, cov2d, depths,
                                         rest, static_cast<Lists *>(lists.get_pointer()), by_rgb, by_alpha);
  });
}
"""


def built(folder: Path) -> Any:
    """Its functions, compiled for this machine from ``folder``, OpenSplat's source."""
    from torch.utils.cpp_extension import load

    source = folder / "rasterizer" / "gsplat-cpu"
    with tempfile.TemporaryDirectory() as place:
        own = Path(place) / "opensplat_bindings.cpp"
        own.write_text(_BINDINGS)
        return load(
            "opensplat_cpu",
            [str(own), str(source / "gsplat_cpu.cpp")],
            extra_include_paths=[str(source)],
            extra_cflags=["-O3", "-march=native"],
            build_directory=place,
        )


def drawn_by_opensplat(
    folder: Path, gaussians: Gaussians, camera: Camera, by: np.ndarray, near_m: float
) -> Callable[[bool], np.ndarray]:
    """A call that draws with OpenSplat, and with True also computes all gradients for the colours and opacity of ``by``
    (5, H, W); returns RGB."""
    import torch

    theirs, (width, height), (fx, fy), (cx, cy) = built(folder), camera.wh, camera.focal_px, camera.principal_px
    fields = [
        gaussians.means_m,
        gaussians.quaternions,
        np.exp(gaussians.log_scales),
        1 / (1 + np.exp(-gaussians.logit_opacities))[:, None],
        gaussians.sh,
    ]
    leaves = [torch.tensor(value, dtype=torch.float32, requires_grad=True) for value in fields]
    far_m = 1000.0
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1], clip[3, 2] = 2 * fx / width, 2 * fy / height, 1.0
    clip[2, 2:] = (far_m + near_m) / (far_m - near_m), -2 * far_m * near_m / (far_m - near_m)
    view, whole, centre = (
        torch.tensor(m, dtype=torch.float32)
        for m in (camera.camera_from_world, clip @ camera.camera_from_world, camera.centre_m)
    )
    black, by_rgb = torch.zeros(3), torch.tensor(np.ascontiguousarray(by[:3].transpose(1, 2, 0)))
    by_alpha = -torch.tensor(by[4])

    class Draw(torch.autograd.Function):
        @staticmethod
        def forward(ctx, xys, conics, colours, opacities, cov2d, depths):
            image, rest, ctx.lists = theirs.draw(width, height, xys, conics, colours, opacities, black, cov2d, depths)
            ctx.save_for_backward(xys, conics, colours, opacities, cov2d, depths, rest)
            return image, 1 - rest

        @staticmethod
        def backward(ctx, of_rgb, of_alpha):
            *drawn, cov2d, depths, rest = ctx.saved_tensors
            of_drawn = theirs.gather(
                height, width, *drawn, black, cov2d, depths, rest, ctx.lists, of_rgb.contiguous(), of_alpha.contiguous()
            )
            return *of_drawn, None, None

    def run(gradients: bool) -> np.ndarray:
        with torch.set_grad_enabled(gradients):
            means, quaternions, scales, opacities, sh = leaves
            xys, _, conics, cov2d, depths = theirs.project(
                means, scales, quaternions, view, whole, fx, fy, cx, cy, height, width, near_m
            )
            directions = torch.nn.functional.normalize(means.detach() - centre, dim=-1)
            colours = torch.clamp_min(theirs.colours(3, directions, sh) + 0.5, 0.0)
            image, alpha = Draw.apply(
                xys, conics.contiguous(), colours.contiguous(), opacities, cov2d.detach(), depths.detach().contiguous()
            )
            if gradients:
                for leaf in leaves:
                    leaf.grad = None
                ((image * by_rgb).sum() + (alpha * by_alpha).sum()).backward()
        return image.detach().numpy()

    return run
