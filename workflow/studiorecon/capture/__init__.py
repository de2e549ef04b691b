# SPDX-License-Identifier: Apache-2.0
"""Converts the footage for all later stages: lossless, undistorted, at working size and at common moments.

In: footage, calibration and clocks; out: one video and one description per camera (``frames``), and the list of all
(``manifest``).
"""
