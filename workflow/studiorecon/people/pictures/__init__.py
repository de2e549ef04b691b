# SPDX-License-Identifier: Apache-2.0
"""Evidence in pictures for triangulated skeletons: ``change`` where their joints move, ``coverage`` by the detector's
masks and by differences from clean plates, and the colours of their ``clothes``."""
