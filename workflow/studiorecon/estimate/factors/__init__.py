# SPDX-License-Identifier: Apache-2.0
"""The factors of an estimate, each with its standard deviations and their source.

``keypoints``   people's joints, and points on the floor that cameras share
``bones``       bones keep their length, about that of a mean adult
``feet``        the lower foot is on the floor
``poses``       calibrated poses, their scale and their floor
``lenses``      prior knowledge of lenses; cameras of one make have similar ones
``board``       corners of a calibration board
``edges``       the room's straight edges have three directions
"""
