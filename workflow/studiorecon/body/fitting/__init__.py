# SPDX-License-Identifier: Apache-2.0
"""Pose and shape of a body from 3D points over time. In come named points with standard deviations; out comes a
``Fit``.

In reading order: ``fit`` (the door), ``start`` (where it begins), ``prior`` (what is known before), ``basis`` (points
as functions of the pose, with derivatives), ``problem`` and ``normal_equations`` (cost and its linearisation),
``elimination`` (its solution), ``levenberg_marquardt`` (the solver), ``multi_start`` (bodies that explain it as well),
``paper_solver`` (the paper's fit taken literally).
"""
