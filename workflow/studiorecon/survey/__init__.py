# SPDX-License-Identifier: Apache-2.0
"""Decides which effects a scene calls for.

In: cameras, people, films, plates and depth; out: a decision for each effect, and the factors that later steps divide
out of the pictures. In the order to read:

* ``decide``: the step;
* ``effect_decisions``: from measurements to decisions, in the order in which one effect hides another;
* ``effects``: one file per effect, and the list of them;
* ``evidence``: the data of the measurements, from ``clips`` (pictures over time), ``exposures`` and ``specularity``
  (colours of surfaces that cameras share), ``stillness`` (shifts and light), ``coverage``, ``scene_change``.
"""
