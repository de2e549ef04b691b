# SPDX-License-Identifier: Apache-2.0
"""Several cameras at once: estimated, checked and refined on the people they see.

Inputs are cameras and detections without identities; outputs are cameras, the world's up and floor, and their
uncertainty.

* ``active_cameras``: cameras that see people; ``correspondences``: points that several cameras see; ``gravity``: up and
  the floor;
* ``from_tracks``: cameras from people alone; ``pose_consensus``: the best such rig, and the cameras not in it;
  ``self_calibration``: refined with focal lengths and, by ``room_turns``, the room's straight edges; ``room_picture``:
  the room in one camera; ``floor_marks``: points on the floor that cameras share, ``ground_plane``: the rig aligned to
  them; ``metric_scale``: metres; ``pose_uncertainty``: sigmas;
* ``bundle``: refines calibrated cameras; ``moved_cameras``: cameras that were moved since; ``room_refinement``:
  refinement on floor and edges too; ``edge_refinement``: edges that contradict cameras that fit people;
  ``floor_alignment``: keeps the floor level; ``held_out_pose``: held-out cameras; ``hypotheses``, ``lens_model``: other
  readings of poses and lenses; ``outlier_camera``: one camera that all others contradict; ``body_points``: people's
  keypoints by their names; ``residuals``: why their rays do not meet; ``human_size``: another unit than metres;
  ``first_depth``: a network's depth maps; ``contact_sheet``: a picture of the cameras.
"""
