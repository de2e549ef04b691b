# SPDX-License-Identifier: Apache-2.0
"""What pictures show of triangulated skeletons: ``change`` where their joints move, ``coverage`` by the detector's
masks and by differences from clean plates, and the colours of their ``clothes``."""
