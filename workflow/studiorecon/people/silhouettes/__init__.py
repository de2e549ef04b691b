# SPDX-License-Identifier: Apache-2.0
"""People without a single keypoint. In come videos and clean plates; out come bodies over time.

``foreground`` (what differs from the plates) → ``hull`` (who stands where) → ``person_masks`` (whose pixels, kept by
``mask_video``) → ``upright`` and ``facing`` (a first body) → ``tracking`` with ``contour`` (the body from frame to
frame); ``silhouette_people`` does all of it.
"""

# Cameras whose clean plates must show a person; two leave 100 mm of error.
MIN_CAMERAS = 3
