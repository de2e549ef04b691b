# SPDX-License-Identifier: Apache-2.0
"""Pictures as arrays: read between pixels, compared, moved, and taken apart.

In come (H, W[, 3]) arrays; out come arrays and figures. No files but plates and PNG.

* ``warp``, ``sizes``, ``blur``, ``regions``, ``silhouette``: fractional pixels, other sizes, binary pictures, meshes;
* ``encoded``: pictures as PNG and JPEG; ``channels``: over the channels of every pixel;
* ``plate``, ``steady_light``, ``difference``, ``exposure``, ``colours``: what stays put, in one light, what differs
  from it, and how cameras agree;
* ``self_similar``: holes closed with what a surface shows elsewhere;
* ``flow``, ``transfer`` (inner loops: ``lookup``): where pixels go, and what renders miss carried to other views;
* ``metrics`` (inner loops: ``similarity``, ``temporal``), ``flip``, ``perceptual``: how close a picture is to the true
  one;
* ``palette``: the colours of people in films and pages.
"""
