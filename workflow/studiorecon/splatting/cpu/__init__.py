# SPDX-License-Identifier: Apache-2.0
"""The CPU's back end. Gaussians and a camera come in, planes (5, H, W) and gradients in parameter blocks go out.

In reading order: ``simd``, ``simd_rows`` (sixteen lanes inside numba) · ``blocks`` (sixteen Gaussians) · ``harmonics``,
``camera_vector``, ``projection`` · ``tiles`` · ``forward``, ``planes``, ``channels`` · ``backward``,
``projection_gradient`` · ``rasterise`` (what others call) · ``ssim``, ``alpha_loss``, ``adam`` (kernels of ``train``).
"""
