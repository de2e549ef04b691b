# SPDX-License-Identifier: Apache-2.0
"""The factors of an estimate, each with its standard deviations and their source.

``keypoints``   people's joints, and points on the floor that cameras share
``bones``       bones keep their length; about a mean adult's
``feet``        the lower foot is on the floor
``lenses``      what is known of a lens, and cameras of one make are alike
``edges``       the room's straight edges have three directions
"""
