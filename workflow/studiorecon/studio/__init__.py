# SPDX-License-Identifier: Apache-2.0
"""The synthetic studio: a description goes in, a dataset like a user's comes out, with its exact truth.

``description`` → ``room`` and ``textures``, ``actors`` (``performance``, ``gait``, ``clothing``), ``meshes`` → ``rig``
(cameras) → ``tracing``, ``film``, ``sensor`` (pictures), ``detections``, ``calibration`` (what a user would bring),
``truth``. ``takes`` films cameras side by side, ``capture`` is the step.
"""
