# SPDX-License-Identifier: Apache-2.0
"""The synthetic studio: renders a dataset like a user's from a description, with its exact truth.

``description`` → ``room`` and ``textures``, ``actors`` (``performance``, ``gait``, ``hand_motion``, ``clothing``),
``meshes`` → ``rig`` (cameras) → ``tracing``, ``film``, ``sensor`` (pictures), ``detections``, ``calibration`` (a user's
files), ``truth``. ``takes`` films cameras in parallel, ``capture`` is the step.
"""
