# SPDX-License-Identifier: Apache-2.0
"""The cameras that all later stages use; inputs are the calibration, people's detections and the plates.

``refine`` writes COLMAP models of training and held-out cameras, moved only where that clearly helps, and a report,
after the ``calibration_check`` on people. It also uses the room's straight edges (``edge_acceptance``) and floor
(``floor_acceptance``); ``changes`` lists the moves. Then ``held_out`` checks the poses of the held-out cameras.
"""
