# SPDX-License-Identifier: Apache-2.0
"""The nouns of a scene and the files they live in.

One convention everywhere (converted once, at the border, in ``cameras``):

* world: right-handed, metres, z up, floor near z = 0; camera: OpenCV axes (x right, y down, z forward);
* ``camera_from_world`` takes world points to camera points; in a product the inner words meet;
* pixel centres at +0.5: the centre of the top-left pixel is (0.5, 0.5); ``hw`` is (rows, columns), ``wh`` (width,
height);
* images are float32 RGB in [0, 1]; depth is z-depth in metres, 0 = unknown; time is 0-based; camera names are strings;
* geometry is float64; everything numeric travels with ``valid``.

Here are nouns and the files they live in, and nothing of this package but errors, arrays and progress below them:

* ``outside``: the door for files of users, ``values``, ``numbered`` and ``names``: what may stand in them and in their
  names;
* ``files``: files that are complete or absent; ``schema``: what each field of a file between steps must be;
  ``intermediate``: such files read back, or named with the field; ``spool``: arrays that are too many for memory;
  ``dataset`` and ``capture_yaml``: what the user brings;
* ``camera``, ``path``, ``clocks``, ``readouts``, ``capture``: cameras, camera paths, times, and the
  working footage;
* ``raw_detections``, ``recorded``, ``people``: who was detected, who is who, and bodies over time;
* ``room``, ``gaussians``, ``gaussians_ply``, ``provenance``: the room's box, Gaussians, and what is measured of them;
* ``stand_ins``: how films name people of photos; ``support``: how well photos show a view;
* ``effects``, ``decisions``, ``factors``: what an effect is, which of them a scene calls for, and gains of cameras and
  frames.
"""
