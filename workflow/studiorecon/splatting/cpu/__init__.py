# SPDX-License-Identifier: Apache-2.0
"""The CPU back end: renders Gaussians into planes (5, H, W) and returns gradients in parameter blocks.

In reading order: ``simd``, ``simd_rows`` (sixteen lanes inside numba) · ``blocks`` (sixteen Gaussians) · ``harmonics``,
``camera_vector``, ``projection`` · ``tiles`` · ``forward``, ``planes``, ``channels`` · ``backward``,
``projection_gradient`` · ``rasterise`` (the interface) · ``ssim``, ``alpha_loss``, ``adam`` (kernels of ``train``).
"""
