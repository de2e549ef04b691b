# SPDX-License-Identifier: Apache-2.0
"""Tests that need a CUDA device and gsplat: ``pytest -m gpu tests/gpu``."""
