# SPDX-License-Identifier: Apache-2.0
"""The room's shape, and a depth map for every training camera; inputs are cameras, clean plates and people.

Outputs are the room box, its primitives and one depth map per plate. The embedded way: ``sweep`` (one camera's votes),
``box`` (the walls, all cameras together), ``room`` (furniture, and depths that agree), ``refine`` (one camera's final
depth), on ``stereo`` and ``layout``; ``preview`` films the box while the rest runs. A network's depth (``network``, or
``estimates`` of files) is calibrated (``learned``, ``depth_edges``) and is one term of the last labelling (``fusion``).
Instead of ``refine``: ``first``, or ``given``. ``sweep_settings``: settings of several steps; ``kernels``: compiles the
code of the room's fit in advance.
"""
