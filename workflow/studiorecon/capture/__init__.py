# SPDX-License-Identifier: Apache-2.0
"""The footage as all later stages see it: lossless, undistorted, at working size and on common moments.

In come footage, calibration and clocks; out come one video and one description per camera (``frames``), and the list
of all (``manifest``).
"""
