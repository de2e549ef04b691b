# SPDX-License-Identifier: Apache-2.0
"""2D keypoints: names of their points, readers of their files, tracks in one camera, and which tracks are one person.

Inputs are files or a detector's output; outputs are ``scene.people.Detections`` in undistorted pixels. In reading
order:

* ``layouts``: names and orders, SMPL's joints among them; ``layout_choice``: the layout of keypoints without a name;
  ``hands``: points of hands, among recorded ones too;
* ``readers`` opens a user's files (``file_numbers``, ``picture_content``, ``result_files``, ``deeplabcut``,
  ``mediapipe``);
* ``film_check`` compares them with the film (``numbering``, ``coordinate_readings``, ``motion``, ``motion_agreement``,
  ``unmatched``), ``film_colours`` with the other films;
* ``detections`` (undistorted, tracked), ``tracking`` (one camera), ``temporal_smoothing`` (smooths a network's jitter),
  ``resampling`` (the common clock);
* ``correspondence``: which tracks of different cameras show the same person.
"""
