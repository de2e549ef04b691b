# SPDX-License-Identifier: Apache-2.0
"""How good it is, and everything worth seeing on one page. In come all results; out come ``metrics.json`` and
``index.html``.

Steps: ``recognition`` (whom a detector finds in the films), ``evaluate`` (measures), ``audit`` (effects that only a
trained scene shows), ``picture`` (one overview), ``page``, ``strict`` (warnings stop the run, where asked); by hand:
``score`` (any method's pictures), ``compare`` (two results). Below them: ``metrics`` and ``sections``.
"""
