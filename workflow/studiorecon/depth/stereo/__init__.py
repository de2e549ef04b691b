# SPDX-License-Identifier: Apache-2.0
"""Plane-sweep stereo: from plates and planes to nats, and one plane or depth per pixel.

``plates`` and ``planes`` (inputs) → ``matching`` (the score of a plane) →
``likelihood`` (its nats, the one unit in which all surfaces compete) → ``labelling`` (one plane per pixel). For
furniture: ``photo_cost`` with ``kernels`` and ``trial_kernels``, and ``self_dissimilarity`` where one photo shows it
alone.
"""
