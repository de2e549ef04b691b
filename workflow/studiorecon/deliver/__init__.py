# SPDX-License-Identifier: Apache-2.0
"""Exports the result for other tools. In: finished results; out: one folder with a manifest.

``finished`` is the scene in memory for writers of 3D files. ``export`` is the step of plain files; each kind of file
has a list of writers: ``camera_files``, ``motion_files``, ``joint_angles``, ``keypoint_files``. ``gltf`` writes
animated people, in their ``body_colours``. ``scene_glb`` writes everything as one glTF, ``usd`` as one stage. ``mesh``
makes the room one mesh, from ``fusion`` and ``room_planes``. ``player`` is one page that shows the scene in motion:
``player_data`` and ``player_motion`` describe the scene, compressed by ``packing``; its scripts are in
``resources/player``.
"""
