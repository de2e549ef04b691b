# SPDX-License-Identifier: Apache-2.0
"""The body: SMPL's 24 joints with a skinned surface, its fit to points, and people as Gaussians on it.

In come poses and shapes, or 3D points to be explained; out come joints, surfaces, silhouettes and posed Gaussians. In
reading order:

* ``skinning``: forward kinematics and blend skinning; ``model``: the bundled body, or a user's SMPL file;
* ``person_files``: a person's motion as a file; ``person_boxes``, ``silhouettes``, ``capsules``: where bodies are in
  pictures, and what light they keep from the floor;
* ``fitting``: pose and shape from points over time; ``avatar``: Gaussians in the rest pose, and what moves them.
"""
