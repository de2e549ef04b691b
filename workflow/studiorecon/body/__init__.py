# SPDX-License-Identifier: Apache-2.0
"""Body models: SMPL's 24 joints with a skinned surface, its fit to 3D points, and people as Gaussians on it.

Inputs are poses and shapes, or 3D points to fit. Outputs are joints, surfaces, silhouettes and posed Gaussians. In
reading order:

* ``skinning``: forward kinematics and blend skinning; ``model``: the bundled body, or a user's SMPL file;
  ``fingers``: the 30 joints that a body can have after its 24; ``hands``: their axes, and hands of another size;
* ``person_files``: a person's motion as a file; ``person_boxes``, ``silhouettes``: where bodies are in images;
  ``capsules``: which light they block from the floor;
* ``fitting``: pose and shape from points over time; ``avatar``: Gaussians in the rest pose and their motion.
"""
