# SPDX-License-Identifier: Apache-2.0
"""Measures the quality of a run and puts its results on one page.

In: all results; out: ``metrics.json``, ``index.html``.

Steps: ``recognition`` (detector scores of people in the films), ``evaluate`` (measures), ``audit`` (effects that only a
trained scene shows), ``picture`` (an overview), ``page``, ``strict`` (turns warnings into an error). Run by hand:
``score`` (pictures of any method). Below them: ``metrics`` and ``sections``.
"""
