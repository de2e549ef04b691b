# SPDX-License-Identifier: Apache-2.0
"""Rigid things that move and are no persons. In come videos, plates and bodies; out comes ``objects.npz``.

``find`` is the step: ``residual`` (what differs and is nobody) → ``sightings`` (places) → ``object_tracks`` →
``carving`` and ``rigid`` (shape and colours) → ``pose_fit`` and ``rotation`` (how it turns).
"""
