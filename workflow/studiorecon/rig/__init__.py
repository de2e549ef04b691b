# SPDX-License-Identifier: Apache-2.0
"""Several cameras at once: found, checked and moved by the people they see.

In come cameras and detections nobody has named; out come cameras, the world's up and floor, and how sure all of it
is.

* ``active_cameras``: which cameras see anybody; ``correspondences``: points that several cameras see; ``gravity``: up
  and the floor;
* ``from_tracks``: cameras from nothing but people; ``pose_consensus``: the best of what that finds, and who is not in
  it; ``self_calibration``: made exact, with their focal lengths and, by ``room_turns``, the room's straight edges;
  ``room_picture``: the room as a camera sees it; ``floor_marks``: places on the floor that cameras share,
  ``ground_plane``: the rig laid on them;
  ``metric_scale``: their metres; ``pose_uncertainty``: how well they are known;
* ``bundle``: calibrated cameras refined; ``moved_cameras``: cameras that were moved since; ``room_refinement``: by its
  floor and edges too; ``edge_refinement``: whether edges contradict cameras that people accept; ``floor_alignment``:
  without tilting the floor; ``held_out_pose``: those that only judge; ``hypotheses``, ``lens_model``: poses and lenses
  that were meant otherwise; ``outlier_camera``: one camera that all others contradict; ``body_points``: people's
  keypoints by their names; ``residuals``: why their rays do not meet; ``human_size``: another unit than metres;
  ``first_depth``: what a network that found them says of depth; ``contact_sheet``: the picture of it all.
"""
