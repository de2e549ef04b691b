# SPDX-License-Identifier: Apache-2.0
"""Calibrated cameras: from the user's files, from a network, or from the people in the pictures.

In come a dataset's calibration files, or keypoints where there are none; out goes ``calibration.json``: lenses in the
metric world, z up, pixel centres at +0.5, with a sentence about every change. In the order of the data:

* ``formats``: one file per format, and the list of them;
* ``files``: reads the user's files by that list (``names``: cameras of the footage, ``world``: metres, z up);
* ``choose``: which camera is which film, and where its pixels lie, where that is open: people decide;
* ``network`` and ``from_people`` (with ``room_pictures``; ``given_lenses`` where lenses are known): cameras where there
  are no files;
* ``doctor`` and ``checks``: what clocks, coverage and people say of the calibration, before anything expensive runs.
"""
