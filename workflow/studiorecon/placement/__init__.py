# SPDX-License-Identifier: Apache-2.0
"""Plans camera positions before filming, from a room and lenses or from a finished calibration; draws one picture.

The plan holds positions and what the cameras will see. Steps: ``place``, ``advise``; below them: ``room``,
``camera_placement``, ``rig_quality``, ``picture``.
"""
