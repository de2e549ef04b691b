# SPDX-License-Identifier: Apache-2.0
"""Which effects does this scene call for? In come cameras, people, films, plates and depth; out go a decision for each
effect, and the files that later steps divide out of the pictures. In the order to read:

* ``decide``: the step; ``judge``: from measurements to decisions, in the order in which one effect hides another;
* ``effects``: one file per effect, and the list of them;
* ``evidence``: what they are measured on, and what several of them ask: ``clips`` (pictures over time),
  ``exposures`` and ``specularity`` (colours of surfaces that cameras share), ``stillness`` (shifts and light),
  ``speed`` (lens, clock, readout), ``resolution``, ``coverage``, ``scene_change``.
"""
