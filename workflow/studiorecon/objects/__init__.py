# SPDX-License-Identifier: Apache-2.0
"""Rigid objects that move and are not people: reads videos, plates and fitted bodies, writes ``objects.npz``.

``find`` is the step. In reading order: ``residual`` (pixels that differ from the plate) → ``sightings`` (3D positions)
→ ``object_tracks`` → ``carving`` and ``rigid`` (shape and colours) → ``pose_fit`` and ``rotation`` (orientation over
time).
"""
