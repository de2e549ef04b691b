# SPDX-License-Identifier: Apache-2.0
"""The room box and what stands in it. In come votes of all sweeps; out come a box, primitives and a picture of them.

``votes`` (what the sweeps say), ``yaw`` and ``box`` (walls), ``ground_contacts`` (walls that nothing matches),
``platform`` (what people stand on above the floor), ``proposals`` and ``primitive_fitting`` (what is tried and kept),
``contact_localisation`` (where one photo shows a foot), ``primitives`` (boxes and cylinders), ``visibility`` (space
that people show to be free), ``primitives_picture``.
"""
