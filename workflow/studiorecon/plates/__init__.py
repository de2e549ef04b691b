# SPDX-License-Identifier: Apache-2.0
"""The room without people: ``clean`` reads one camera's working video and its detections and writes its clean plate.

The plate's alpha marks the measured pixels.
"""
