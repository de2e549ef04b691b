# SPDX-License-Identifier: Apache-2.0
"""The room without people. In come one camera's working video and its detections; out comes its clean plate, with an
alpha that says where it was measured: ``clean``.
"""
