# SPDX-License-Identifier: Apache-2.0
"""Speed bars: scripts run by hand and by the report, never as timed asserts in the test suite."""
