# SPDX-License-Identifier: Apache-2.0
"""2D keypoints: what detectors call them, how their files are read, who is followed, and whose rays meet.

In come files or a detector's answers; out come ``scene.people.Detections`` in undistorted pixels. In reading order:

* ``layouts``: names and orders, SMPL's joints among them; ``layout_choice``: which one, when nobody says;
* ``readers`` opens a user's files (``file_numbers``, ``picture_content``, ``result_files``, ``deeplabcut``,
  ``mediapipe``);
* ``film_check`` compares them with the film (``numbering``, ``possible_readings``, ``motion``, ``on_film``);
* ``reading`` (undistorted, followed), ``tracking`` (one camera),
  ``steadying`` (a network's tremble), ``retiming`` (the common clock);
* ``correspondence``: which tracks of different cameras show the same person.
"""
