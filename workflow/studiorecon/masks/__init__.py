# SPDX-License-Identifier: Apache-2.0
"""Who is where in every frame. In come videos, plates, bodies and things; out comes one label video per camera: 0
background, k + 1 person k, 255 somebody who is none of them.

``segment`` is the step, from ``log_odds`` (plate and body), ``detector_masks`` and ``grabcut`` (without a plate);
``loose_objects`` are nobody. Instead of it: ``network`` with ``tracks``, or ``given``.
"""
