# SPDX-License-Identifier: Apache-2.0
"""Converts detections to the working frames.

In: raw detections, footage and clocks; out: undistorted tracks per camera: ``keypoints`` of a detector or of files,
``bodies`` of a network.
"""
