# SPDX-License-Identifier: Apache-2.0
"""Calibrated cameras: from the user's files, from a network, or from the people in the pictures.

Inputs are a dataset's calibration files, or keypoints where there are none. The output is ``calibration.json``: lenses
in the metric world, z up, pixel centres at +0.5, with a sentence about every change. In the order of the data:

* ``formats``: one file per format, and the list of them;
* ``files``: reads the user's files by that list (``names``: cameras of the footage, ``world``: metres, z up);
* ``choose``: matches cameras to films, and locates a film's pixels (``film_places``), by people where names and sizes
  are ambiguous (``people_evidence``), and by motion what is already undistorted (``second_undistortion``);
* ``network`` and ``from_people`` (with ``room_pictures`` and ``room_evidence``; ``known_lenses`` where lenses are
  known): cameras without calibration files;
* ``doctor`` and ``checks``: checks of the calibration by clocks, coverage and people, before anything expensive runs.
"""
