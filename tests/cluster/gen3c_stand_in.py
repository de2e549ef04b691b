# SPDX-License-Identifier: Apache-2.0
"""Stands in for ``views.generate`` on a machine without GPU and weights: films of GEN3C's size and length, and a note
of what the job had.

Each film repeats the request's first key frame. The job of segment 01 fails at its first attempt, as one does that runs
out of memory.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import numpy as np
from studiorecon.footage.video import write_lossless
from studiorecon.models.adapters.gen3c_request import check_form
from studiorecon.views.generate import read_request

_NOTED = ("CUDA_VISIBLE_DEVICES", "SLURM_ARRAY_JOB_ID", "SLURM_ARRAY_TASK_ID", "SLURM_JOB_ID")


def main() -> int:
    """Note the job's share of the machine below ``notes``, then write the film or fail."""
    options = argparse.ArgumentParser()
    options.add_argument("--requests", type=Path)
    options.add_argument("--films", type=Path)
    given, _ = options.parse_known_args()
    notes = Path("notes")
    notes.mkdir(exist_ok=True)
    segment = given.films.name.partition(".")[0]
    attempt = len(list(notes.glob(f"{segment}.*.json"))) + 1
    (notes / f"{segment}.{attempt}.json").write_text(json.dumps({name: os.environ.get(name, "") for name in _NOTED}))
    if segment == "01" and attempt == 1:
        print("planted failure: out of memory", file=sys.stderr)
        return 1
    request = read_request(given.requests)
    check_form(request)
    first = np.clip((request["images_key_frames"][0] + 1) * 127.5, 0, 255).astype(np.uint8)
    picture = first.transpose(1, 2, 0) if first.shape[0] == 3 else first
    write_lossless(given.films, (picture for _ in request["w2cs_all"]), 24.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
