# SPDX-License-Identifier: Apache-2.0
"""The cameras that all later stages use. In come the calibration, everybody's detections and the plates; out come
COLMAP models of training and held-out cameras, moved only where that clearly helps, and the report on it: ``refine``,
with what the room's straight edges (``edge_acceptance``) and its floor (``floor_acceptance``) say, and the ``changes``.
Then ``held_out``: do the cameras that only judge stand where they are said to?
"""
