# SPDX-License-Identifier: Apache-2.0
"""Plane-sweep stereo: from plates and planes to costs, and one plane or depth per pixel.

``plates`` and ``planes`` (inputs) → ``matching`` (the cost of a plane) → ``labelling`` (one plane per pixel). For
furniture: ``photo_cost`` with ``kernels`` and ``trial_kernels``, and ``self_dissimilarity`` where one photo shows it
alone.
"""
