# SPDX-License-Identifier: Apache-2.0
"""What the export of a made scene takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import write_person
from studiorecon.deliver.export import Settings
from studiorecon.footage.video import write_watchable

from tests.made.fitted import fitted_person
from tests.made.scene import FPS, FRAMES, render_options

ROOT = Path(__file__).resolve().parents[2]


def options(folder: Path, people: int) -> dict:
    """The options of ``deliver.export`` for a scene of ``write_scene``: people who stand still, and a black film."""
    identity = BodyModel.load(render_options(folder, "orbit", people)["body"]).identity
    fits = [folder / f"people/p{i}.npz" for i in range(people)]
    for fit in fits:
        write_person(fit, fitted_person(fit.stem, identity, FPS, FRAMES))
    write_watchable(folder / "enhance/orbit.mp4", [np.zeros((32, 32, 3), np.uint8)] * 2, FPS)
    render = render_options(folder, "orbit", people)
    return {
        **{name: render[name] for name in ("manifest", "model", "background", "provenance")},
        **{name: render[name] for name in ("gaussians", "avatars", "body")},
        "fits": fits,
        "settings": Settings(),
        "videos": sorted((folder / "capture").glob("cam*.mkv")),
        "films": [folder / "enhance/orbit.mp4"],
        "detections": [],
        "identities": [],
        "blender": ROOT / "resources/blender.py",
        "contents": folder / "deliver/manifest.json",
    }
