# SPDX-License-Identifier: Apache-2.0
"""Identities across cameras, and every person's body over time; inputs are cameras, detections and plates.

Outputs are ``people.tsv``, ``identities.tsv`` and one motion per person. Steps, in the order of the data:
``second_look`` (detects again in pictures, at people predicted by ``expected_keypoints`` from the other cameras, or
with few cameras by the metric guess, ``monocular_guess``; ``hand_search`` at the ends of their arms), ``lift``
(pelvises at the scene's depth, on request), ``associate``, ``fit``; for viewing: ``review``, ``overlay``. Below them:
``association`` (tracks to persons), ``pictures`` (what pictures show of them), ``fitting`` (points for the body's fit).
``corrected_identities``: identities as the user has them. ``fit_settings``: settings of several steps.
"""
