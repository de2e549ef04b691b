# SPDX-License-Identifier: Apache-2.0
"""Where a Gaussian's appearance comes from; the truth map of every film is rendered from these marks."""

from __future__ import annotations

MEASURED = 0
"""A training camera saw it."""
INFERRED = 1
"""Not seen itself, but its place or colour follows from what was seen: a default wall, the mirror image of an arm."""
INVENTED = 2
"""Painted in so that there is no hole."""
