# SPDX-License-Identifier: Apache-2.0
"""Plane-sweep stereo. In come plates and planes; out come costs, and one plane or depth per pixel.

``plates`` and ``planes`` (what is compared and tried) → ``matching`` (the cost of a plane) → ``labelling`` (one
plane per pixel) → ``passes`` (the second pass, without hidden cameras). For furniture: ``photo_cost`` with ``kernels``
and ``trial_kernels``, and ``self_dissimilarity`` where one photo shows it alone. ``free_space`` takes back what
floats.
"""
