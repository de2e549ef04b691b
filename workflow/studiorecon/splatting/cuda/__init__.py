# SPDX-License-Identifier: Apache-2.0
"""The CUDA back end; only ``device: cuda`` imports it, with torch, kornia and gsplat.

``rasterise`` (gsplat behind the calls of ``cpu.rasterise``) · ``adam`` (Adam on tensors) · ``tensor_set`` (a still set
in training, for ``train.trainer``).
"""
