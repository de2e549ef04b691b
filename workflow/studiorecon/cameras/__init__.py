# SPDX-License-Identifier: Apache-2.0
"""The cameras that all later stages use; inputs are the calibration, people's detections and the plates.

``refine`` writes COLMAP models of training and held-out cameras, other than given only where people and the room
require it, after the ``calibration_check`` on people; ``changes`` reports what changed. Then ``held_out`` checks the
poses of the held-out cameras.
"""
