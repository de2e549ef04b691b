# SPDX-License-Identifier: Apache-2.0
"""What tests of enhance and their neighbours share."""

from __future__ import annotations

from studiorecon.recursive.flows import DisFlow

SEARCH = DisFlow("medium")
