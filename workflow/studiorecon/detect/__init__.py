# SPDX-License-Identifier: Apache-2.0
"""Detects people in each camera's pictures, before any calibration.

In: footage, or files of keypoints; out: raw detections per camera, in pixels of the footage. Steps: ``chapters``
(several files of one recording as one film), ``moments`` (the embedded detector in some stretches, for clocks and
calibration), ``people`` (in all the rest), ``keypoints`` (a user's files).
"""
