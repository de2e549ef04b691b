# SPDX-License-Identifier: Apache-2.0
"""Cameras as files: a calibration as somebody wrote it goes in, cameras with our axes and units come out.

Read in this order:

* ``raw_camera``: one camera of somebody else's file, whether it can be one, and the checks that every reader of such
  files shares; ``lens_kinds``: which lens model a name means;
* ``colmap_models``, ``transforms_json``: the two foreign kinds that more than one stage reads;
* ``calibration``: the lenses in our own ``calibration.json``;
* ``colmap``: the undistorted cameras that all later steps read, as COLMAP text.
"""
