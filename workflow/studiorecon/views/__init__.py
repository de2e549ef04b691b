# SPDX-License-Identifier: Apache-2.0
"""Synthesises views between the training cameras, for the background's training, from plates, depth and cameras.

``path`` (the poses) → ``synthesize`` (``forward_warp``: photos warped by their depth). With a network instead:
``request``, ``generate``, ``fitted``, with ``frame`` for its picture size, ``first_moment`` for the people in its
input, and ``people`` for another network that detects them in its views. ``warp_settings``: settings of several steps.
"""
