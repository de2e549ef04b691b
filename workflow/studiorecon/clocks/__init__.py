# SPDX-License-Identifier: Apache-2.0
"""The start time of every camera, and the moments that all share.

Reads footage and raw detections, writes ``clocks.json``. The step is ``offsets``. Each source of evidence has a file:
``sound``, ``people_clock`` (lags by ``people_lag`` and, with a user's calibration, ``calibrated_lag``), ``rig_offsets``
(all calibrated cameras together) and ``motion_clock``. ``offset_consensus`` combines them to one clock, ``timeline``
holds the times of frames.
"""
