# SPDX-License-Identifier: Apache-2.0
"""What a body is fitted to. In come everybody's detections and cameras; out come points in the world with standard
deviations: ``points`` of keypoints, ``surface_points`` of a network's bodies. Beside them ``limbs``: how long bones
are, ``legs`` that no camera shows, ``readouts``: whose rows look one after the other, ``presence``: when somebody is
there at all.
"""
