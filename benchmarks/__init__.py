# SPDX-License-Identifier: Apache-2.0
"""Speed bars: scripts run by hand and by the report, never as timed asserts in the test suite."""

import os

from studiorecon.__main__ import KERNELS

# As a step's process does: numba's own cache keeps a kernel whose constant was changed in another module.
for _variable, _chosen in KERNELS.items():
    os.environ.setdefault(_variable, _chosen)
