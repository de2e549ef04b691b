# SPDX-License-Identifier: Apache-2.0
"""Detects people in each camera's pictures, before any calibration.

In: footage, or files of keypoints; out: raw detections per camera, in pixels of the footage. Steps: ``chapters``
(several files of one recording as one film), ``people`` (the embedded detector in all that ``clocks.moments`` did not
search), ``keypoints`` (tracks of a user's files, or of these moments).
"""
