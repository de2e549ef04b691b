# SPDX-License-Identifier: Apache-2.0
"""Person masks of every frame: reads videos, plates, fitted bodies and objects, writes one label video per camera.

Labels: 0 background, k + 1 person k, 255 a person who is none of them. ``segment`` is the step. Its ``labelling``
combines ``log_odds`` (plate and body), ``detector_masks`` and, without a plate, ``grabcut``; pixels of
``loose_objects`` belong to no person. Alternatives: ``network`` with ``tracks``, or ``user_masks``.
"""
