# SPDX-License-Identifier: Apache-2.0
"""When every camera was started, and the moments that all share.

In come footage and raw detections; out comes ``clocks.json``. The step is ``offsets``; each witness has a file:
``sound``, ``people_clock`` (lags by ``people_lag`` and, by a user's calibration, ``calibrated_lag``), ``all_cameras``
(what calibrated cameras then see together) and ``motion_clock``; ``agreement`` makes one clock of what they say, and
``timeline`` the times of frames.
"""
