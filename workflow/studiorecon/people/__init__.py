# SPDX-License-Identifier: Apache-2.0
"""Who is who across cameras, and everybody's body over time.

In come cameras, detections and plates; out come ``people.tsv``, ``identities.tsv`` and one motion per person. Steps,
in the order of the data: ``second_look`` (pictures once more, where ``expected`` says somebody must be; where few
cameras say it, by the metric guess, ``monocular_guess``), ``lift`` (pelvises at the scene's depth, on request),
``associate``, ``fit``; for people to look at: ``review``, ``overlay``. Below them: ``association`` (tracks to
persons), ``fitting`` (points to fit a body to). ``fit_settings``: settings of several steps.
"""
