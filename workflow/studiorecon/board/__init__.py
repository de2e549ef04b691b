# SPDX-License-Identifier: Apache-2.0
"""Cameras from a calibration board: a ChArUco board or a chessboard that somebody moves before all cameras.

``pattern``  the board's description and its corners
``corners``  the corners in the pictures of a film
``lens``     a camera's lens from them
``poses``    the board's pose before a camera, over time
``clocks``   the films' offsets, and the cameras' poses relative to one another, from those poses
``cameras``  all of it, and one estimate of the cameras (``studiorecon.estimate``)
"""
