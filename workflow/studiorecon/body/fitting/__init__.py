# SPDX-License-Identifier: Apache-2.0
"""Fits a body's pose and shape to named 3D points over time; returns a ``Fit``.

In reading order: ``fit`` (the entry point), ``start`` (initial pose), ``prior`` (pose prior), ``point_model`` (the
points and their derivatives), ``problem`` and ``normal_equations`` (cost and its linearisation), ``elimination`` (their
solution), ``levenberg_marquardt`` (the solver), ``multi_start`` (other bodies that explain the points as well),
``hands`` (fingers, and arms that reach to them), ``paper_solver`` (the paper's fit taken literally).
"""
