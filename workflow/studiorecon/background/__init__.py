# SPDX-License-Identifier: Apache-2.0
"""The room as static Gaussians: reads plates, synthesized views and depth, writes ``background.ply`` and provenance.

``train`` is the step: ``preparation`` (first Gaussians; ``targets``, the pictures to fit; ``hole_filling``, surfaces
that no camera sees), ``fitting`` (the iterations), ``refinement`` (enhanced renders become targets). If a network
enhances them, ``half`` and ``refined`` are steps before it, and ``half_trained_files`` the files between. ``kernels``
compiles the code of this training and the people's in advance. ``train_settings`` holds the settings.
"""
