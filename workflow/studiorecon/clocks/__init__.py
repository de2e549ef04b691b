# SPDX-License-Identifier: Apache-2.0
"""The start time of every camera, and the moments that all share.

Reads footage and raw detections, writes ``clocks.json``. The step ``moments`` reads sound and motion, and searches
for people in some moments; the step ``offsets`` adds people. Each source of evidence is a module
that returns lags between cameras with their likelihoods: ``sound``, ``people`` (by ``epipolar`` geometry, near that of
a user's calibration if there is one) and ``motion``. ``posterior`` maximises all of them together, ``timeline`` holds
the times of frames, ``stretches`` names films that lack frames in their middle.
"""
