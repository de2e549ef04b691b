# SPDX-License-Identifier: Apache-2.0
"""Geometry on arrays, in float64, with "undetermined" as a possible result; of a scene it knows only the camera.

Inputs are points, pixels, depth maps and ``scene.camera.Camera``; outputs are points and poses with their uncertainty.
In reading order:

* ``rotations``, ``smoothing``: rotations, and motion over time; ``statistics``: a number with its interval;
* ``distortion`` (inner loop: ``distortion_kernels``), ``lens``: from a real lens's pixels to the pinhole's;
  ``crop_hypotheses``: position of a film in the calibrated picture;
* ``triangulation`` (inner loops: ``triangulation_kernels``, ``triangulation_dlt``), ``relative_pose``,
  ``camera_motion``, ``scale``: from pixels of several cameras to points, poses and metres; ``groups``: groups of
  linked nodes;
* ``depth_surface``, ``depth_alignment``, ``lifting``, ``floor``: points and surfaces from depth maps;
* ``camera_path``: camera paths between cameras.
"""
