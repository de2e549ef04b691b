# SPDX-License-Identifier: Apache-2.0
"""Nothing is fetched during a run: what every hub client that upstream code uses is told."""

from __future__ import annotations

import os

OFFLINE = {"HF_HUB_OFFLINE": "1", "TRANSFORMERS_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
"""Variables that hub clients read when they are imported."""


def stay_offline() -> None:
    """Tell the hub clients of this process, and of those it starts, to fetch nothing."""
    os.environ.update(OFFLINE)


def may_fetch() -> None:
    """Lift that for this process; only ``snakemake weights`` does."""
    for variable in OFFLINE:
        os.environ.pop(variable, None)
