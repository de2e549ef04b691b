# SPDX-License-Identifier: Apache-2.0
"""Pictures as arrays: reading at fractional pixels, comparing, warping and decomposing them.

Inputs are (H, W[, 3]) arrays; outputs are arrays and figures. No files but plates and PNG.

* ``warp``, ``sizes``, ``blur``, ``regions``, ``silhouette``: fractional pixels, other sizes, binary pictures, meshes;
* ``encoded``: pictures as PNG and JPEG; ``channels``: reductions over the channels of every pixel;
* ``plate``, ``photometric_normalisation``, ``difference``, ``exposure``: the static background, constant
  light, differences from the plate, and equal exposure across cameras;
* ``texture_fill``: fills holes with repeats of the surface;
* ``flow``, ``transfer`` (inner loops: ``lookup``): optical flow, and residuals of renders carried to other views;
* ``metrics`` (inner loops: ``similarity``, ``temporal``), ``flip``, ``perceptual``: distance of a picture from the true
  one;
* ``palette``: the colours of people in films and pages.
"""
