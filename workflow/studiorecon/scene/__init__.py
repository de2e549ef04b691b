# SPDX-License-Identifier: Apache-2.0
"""The data types of a scene and their files.

One convention everywhere (inputs are converted once, in ``cameras``):

* world: right-handed, metres, z up, floor near z = 0; camera: OpenCV axes (x right, y down, z forward);
* ``camera_from_world`` maps world points to camera points; in a product the names next to each other agree;
* pixel centres at +0.5: the centre of the top-left pixel is (0.5, 0.5); ``hw`` is (rows, columns), ``wh`` (width,
  height);
* images are float32 RGB in [0, 1]; depth is z-depth in metres, 0 = unknown; time is 0-based; camera names are strings;
* geometry is float64; every numeric result comes with ``valid``.

These modules import nothing of this package but errors, arrays and progress:

* ``user_files``: opens users' files; ``user_values``, ``numbered_files`` and ``names``: check their values and names;
* ``files``: writes files completely or not at all; ``schema``: the fields of a file between steps; ``step_files``:
  reads such files and names a wrong field; ``spool``: arrays that do not fit into memory; ``dataset`` and
  ``capture_yaml``: the user's files;
* ``camera``, ``path``, ``clocks``, ``moments``, ``readouts``, ``capture``: cameras, camera paths, times, and the
  working footage;
* ``raw_detections``, ``recorded_keypoints``, ``keypoint_verdict``, ``people``: detections, how keypoints fit their
  film, identities, and bodies over time;
* ``room``, ``gaussians``, ``gaussians_ply``, ``provenance``: the room box, Gaussians, and their provenance;
* ``replacement_photos``: how films name people of photos; ``support``: how well photos show a view;
* ``reports``: what steps report about tracks, cameras and scores, as pages show it;
* ``effects``, ``decisions``, ``factors``: the type of an effect, the decisions of a scene, and gains of cameras and
  frames.
"""
