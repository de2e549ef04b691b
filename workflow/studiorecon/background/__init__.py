# SPDX-License-Identifier: Apache-2.0
"""The room as static Gaussians. In come plates, synthesized views and depth; out comes ``background.ply`` with the
provenance of every Gaussian.

``train`` is the step: ``seeding`` (first Gaussians), ``targets`` (what they are trained against), ``refinement``
(enhanced renders become targets), ``hole_filling`` (what no camera sees). ``kernels`` compiles ahead what it and the
people's training run on.
``train_settings`` is what it is told.
"""
