# SPDX-License-Identifier: Apache-2.0
"""Geometry on arrays, in float64, with "undetermined" as a possible answer; a camera is all it knows of a scene.

In come points, pixels, depth maps and ``scene.camera.Camera``; out come points, poses and how well they are known. In
reading order:

* ``rotations``, ``smoothing``: rotations, and motion over time; ``statistics``: a number with its interval;
* ``distortion`` (inner loop: ``distortion_kernels``), ``lens``: from a real lens's pixels to the pinhole's;
  ``film_places``: where a film lies in the calibrated picture;
* ``triangulation`` (inner loops: ``triangulation_kernels``, ``triangulation_dlt``), ``relative_pose``, ``bundle``,
  ``scale``: from pixels of several cameras to points, poses and metres; ``groups``: what belongs together;
* ``depth_surface``, ``depth_alignment``, ``lifting``, ``floor``: what a depth map says;
* ``camera_path``: camera paths between cameras.
"""
