# SPDX-License-Identifier: Apache-2.0
"""What triangulation and the fit bring over a mean of every camera's own bodies: ``python -m tests.bench.fused``.

The paper's ablation without multi-view refinement (appendix) on a made walk, four cameras at 90°: a network sees a
body in each picture with turns of 4° per joint, shapes 0.3 off, and a depth that is off by a share of its own. Mean
error of the joints in the world, of the mean (``people.fit.solver: fused``) and of the step as it is set; writes
``tests/bench/results/fused.json``. Half a minute.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.configuration import settings as settings_module
from studiorecon.geometry import rotations
from studiorecon.people import fit as step
from studiorecon.people.fitting.fused import fused
from studiorecon.people.fitting.points import lift, observations
from studiorecon.people.fitting.surface_points import surface_of

from tests.bench.bodies import BETAS, FPS, ring, walk
from tests.defaults import default_settings
from tests.made.network_bodies import seen_by_a_network

ROOT = Path(__file__).resolve().parents[2]
FRAMES = 24


def main() -> None:
    """Print the table and keep it."""
    body = replace(BodyModel.load(ROOT / "resources/body.npz"), identity="smpl planted")
    settings = settings_module.load(step.Settings, default_settings("people"), "people")
    poses, trans = walk(FRAMES)
    truth, cameras = (poses, BETAS, trans), ring()
    joints = body.joints(*truth)
    results = {}
    for off in (0.0, 0.02, 0.05, 0.1):
        seen = seen_by_a_network(body, truth, cameras, off)
        whose = {(c.name, 0): "p0" for c in cameras}
        mean = fused("p0", seen, whose, cameras, body, FRAMES)
        own = body.joints(rotations.log(mean.local).reshape(FRAMES, 72), mean.betas, mean.trans_m)
        names, keypoints = observations("p0", seen, whose, body, FRAMES)
        limits = settings.triangulation, settings.fit.unverified_sigma_m
        skin = surface_of("p0", seen, whose, cameras, body, FRAMES, *limits, settings.fit.vertices)
        refined, _ = step.fit_person("p0", lift(names, keypoints, cameras, *limits), body, FPS, settings, skin)
        results[f"{off:.0%}"] = {
            "fused_mm": round(1000 * float(np.linalg.norm(own - joints, axis=-1).mean()), 1),
            "fitted_mm": round(1000 * float(np.linalg.norm(refined.joints - joints, axis=-1).mean()), 1),
        }
        print(f"depth off by {off:.0%}: {results[f'{off:.0%}']}")
    (Path(__file__).parent / "results" / "fused.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
