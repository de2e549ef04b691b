# SPDX-License-Identifier: Apache-2.0
"""The room box and the furniture in it: from votes of all sweeps to a box, primitives and a picture of them.

``votes`` (of the sweeps), ``yaw`` and ``box`` (walls), ``ground_contacts`` (feet of upright edges), ``unseen_walls``
(walls without matches), ``platform`` (a raised surface under people), ``proposals`` and ``primitive_fitting``
(candidates and their selection), ``primitives`` (boxes), ``visibility`` (space that people show to be free),
``primitives_picture``.
"""
