# SPDX-License-Identifier: Apache-2.0
"""Points for a body's fit: reads all people's detections and cameras, returns points in the world with sigmas.

``points`` are triangulated keypoints, ``surface_points`` those of a network's bodies, ``hands`` those of fingers,
of which ``hand_sides`` says whose they are: the left or the right hand's.
``limbs``: lengths of bones, ``legs``: poses of unseen legs, ``readouts``: rolling shutters, ``presence``: frames in
which a person is present.
"""
