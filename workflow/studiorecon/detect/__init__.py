# SPDX-License-Identifier: Apache-2.0
"""Who is in each camera's pictures, before any calibration.

In comes footage, or files of keypoints; out come raw detections per camera, in pixels of the footage. Steps:
``chapters`` (several files of one recording as one film), ``people`` (the embedded detector), ``keypoints`` (a user's
files).
"""
