# SPDX-License-Identifier: Apache-2.0
"""What tests of layout and their neighbours share."""

from __future__ import annotations

# In the order in which data meets them.
STAGES = ["detect", "clocks", "calibration", "capture", "tracks", "plates", "cameras", "people", "depth", "survey"]


# The doors to torch inside the package, opened only by ``device: cuda``.
ON_REQUEST = {"splatting.cuda.tensor_set"}
