# SPDX-License-Identifier: Apache-2.0
"""Detections on the working frames. In come raw detections, footage and clocks; out come undistorted, followed
detections per camera: ``keypoints`` of a detector or of files, ``bodies`` of a network.
"""
