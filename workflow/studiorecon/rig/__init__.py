# SPDX-License-Identifier: Apache-2.0
"""Several cameras at once: estimated, checked and refined on the people they see.

Inputs are cameras and detections without identities; outputs are cameras, the world's up and floor, and their
uncertainty.

What cameras see
    ``active_cameras``    cameras that see people
    ``body_points``       people's keypoints by their names
    ``hand_sizes``        how large hands are, and which are searched for
    ``correspondences``   points that several cameras see
    ``room_picture``      the room in one camera
    ``floor_marks``       points on the floor that cameras share
    ``first_depth``       a network's depth maps
Cameras from people alone
    ``from_tracks``       cameras from tracks
    ``pose_consensus``    the best such rig, and the cameras not in it
    ``estimate``          refined with lenses, edges and floor marks
    ``lens_knowledge``    the prior of lenses
    ``detector_noise``    the keypoints' errors
    ``room_turns``        a room's three directions
    ``gravity``           up and the floor
    ``metric_scale``      metres
    ``world_of_people``   the world from up, floor and metres
Calibrated cameras
    ``agreement``         how well they agree with people
    ``calibrated``        what people and the room require of them
    ``room_evidence``     what the empty room shows of them
    ``held_out_pose``     held-out cameras
    ``refined_cameras``   … of those that see people, beside the others
    ``starts``            other readings of a calibration
    ``lens_model``        other readings of lenses
    ``outlier_camera``    one camera that all others contradict
    ``residuals``         why people's rays do not meet
    ``human_size``        the check of the unit of length
    ``contact_sheet``     a picture of the cameras
"""
