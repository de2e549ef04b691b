# SPDX-License-Identifier: Apache-2.0
"""Reads and writes camera files. In: a calibration in a format of another tool; out: cameras with our axes and units.

Read in this order:

* ``raw_camera``: one camera of a foreign file, and the checks that all readers of such files share; ``lens_kinds``: the
  lens model behind a name;
* ``colmap_models``, ``transforms_json``: the two foreign formats that several stages read;
* ``calibration``: the lenses in our own ``calibration.json``;
* ``colmap``: the undistorted cameras that all later steps read, as COLMAP text.
"""
