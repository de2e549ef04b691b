# SPDX-License-Identifier: Apache-2.0
"""The result for other tools. In come finished results; out comes one folder with a manifest.

``finished`` is the scene in memory, as writers of 3D see it. ``export`` is the step of plain files; each kind of
file has a list of writers: ``camera_files``, ``motion_files``, ``keypoint_files``; ``gltf`` writes people that move,
in their ``body_colours``. ``scene_glb`` writes everything as one glTF, ``usd`` as one stage. ``mesh`` makes the room
one mesh, from ``fusion`` and ``room_planes``. ``player`` is one page that shows the scene in motion: ``player_data``
and ``player_motion`` tell it what there is, in the few bytes of ``packing``; its scripts are in ``resources/player``.
"""
