# SPDX-License-Identifier: Apache-2.0
"""From the videos of a few static, far-apart cameras to a 4D scene."""
