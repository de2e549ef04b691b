# SPDX-License-Identifier: Apache-2.0
"""The room as static Gaussians. In come plates, synthesized views and depth; out comes ``background.ply`` with the
provenance of every Gaussian.

``train`` is the step: ``preparation`` (first Gaussians; ``targets``, what they are trained against;
``hole_filling``, what no camera sees), ``fitting`` (the iterations), ``refinement`` (enhanced renders become targets).
Where a network enhances them, ``half`` and ``refined`` are steps before it, and ``halves`` the files between.
``kernels`` compiles ahead what it and the people's training run on. ``train_settings`` is what it is told.
"""
