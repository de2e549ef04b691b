# SPDX-License-Identifier: Apache-2.0
"""People from clean plates alone, without a single keypoint: ``python -m tests.bench.hull``.

Made takes of 24 frames at 320×180, twelve a second, with plates: one person and three cameras, two people and four,
three and four, of whom one never leaves the spot. Front end, association by the visual hull and fit as the workflow
runs them, against the exact truth: joints, facing with what it rests on, and where the time goes (processor seconds of
one thread). Writes ``tests/bench/results/hull.json``. A few minutes of an idle core.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from studiorecon.body.person_files import read_person
from studiorecon.geometry import rotations
from studiorecon.people import fit
from studiorecon.people.silhouettes.silhouette_people import read_standing
from studiorecon.plan.discovery import open_dataset
from studiorecon.scene.files import write_json
from studiorecon.studio import capture

from tests.defaults import default_settings, loaded
from tests.made.real_take import front_end_of

ROOT = Path(__file__).resolve().parents[2]
RESULT = Path(__file__).resolve().parent / "results" / "hull.json"
# name → people, training cameras
TAKES = {"one person, three cameras": (1, 3), "two people, four cameras": (2, 4), "three people, four cameras": (3, 4)}
BAR_MM = 60.0


def make(folder: Path, people: int, cameras: int) -> None:
    """A take with plates and without keypoints in ``folder/dataset``, its truth in ``folder/truth``."""
    described = {
        "seed": 5,
        "frames": 24,
        "fps": 12.0,
        "size": [320, 180],
        "people": people,
        "plates": True,
        "cameras": {"training": cameras, "held_out": 0},
    }
    folder.mkdir(parents=True)
    (folder / "take.yaml").write_text(yaml.safe_dump(described))
    capture.run(folder / "take.yaml", folder / "dataset", folder / "truth", None, 1)


def score(folder: Path) -> dict[str, Any]:
    """Find and fit everybody of a take; errors against the nearest true person."""
    data, out = open_dataset(folder / "dataset"), folder / "out"
    keypoints = data.folder / "keypoints"
    if keypoints.is_dir():
        keypoints.rename(folder / "keypoints")
        data = open_dataset(folder / "dataset")
    started = time.process_time()
    names = front_end_of(data, ROOT, out, default_settings)[0]
    found_s = time.process_time() - started
    options = loaded(fit.Settings)
    truth = [dict(np.load(path)) for path in sorted((folder / "truth" / "bodies").glob("p*.npz"))]
    people = []
    for name in names:
        model, manifest, standing = out / "model/images.txt", out / "manifest.json", [out / f"silhouettes/{name}.npz"]
        started = time.process_time()
        fit.run(options, name, model, manifest, [], [], standing, [], ROOT / "resources/body.npz", out / f"{name}.npz")
        fit_s = time.process_time() - started
        person, (start,) = read_person(out / f"{name}.npz"), read_standing(out / f"silhouettes/{name}.npz")
        errors = [1000 * np.linalg.norm(person.joints - t["joints"], axis=-1) for t in truth]
        who = int(np.argmin([np.linalg.norm(person.trans - t["trans"], axis=-1).mean() for t in truth]))
        true_root = rotations.exp(truth[who]["poses"][:, :3])
        turned = rotations.angle(rotations.exp(person.poses[:, :3]), true_root)
        people.append(
            {
                "true person": who,
                "joints_mm": float(errors[who].mean()),
                "joints_p95_mm": float(np.percentile(errors[who], 95)),
                "stated_mm": float(1000 * np.sqrt(3) * np.median(person.sigma[person.valid])),
                "frames measured": int(person.valid.sum()),
                "agreement": start.start.agreement,
                "facing right": bool(np.median(turned) < np.pi / 2),
                "facing": vars(start.start.facing),
                "fit_s": fit_s,
            }
        )
    return {"found": len(names), "true": len(truth), "front end and finding_s": found_s, "people": people}


def main() -> None:
    results: dict[str, Any] = {"date": str(date.today()), "bar_mm": BAR_MM}
    with tempfile.TemporaryDirectory() as folder:
        for name, (people, cameras) in TAKES.items():
            take = Path(os.environ.get("HULL_TAKES", folder)) / f"take{people}{cameras}"
            if not take.is_dir():
                make(take, people, cameras)
            results[name] = score(take)
            for person in results[name]["people"]:
                print(f"{name}: {person}", flush=True)
    results["most memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    write_json(RESULT, results)
    print(
        f"bar of {BAR_MM:g} mm: "
        + ", ".join(f"{p['joints_mm']:.0f} mm" for name in TAKES for p in results[name]["people"])
    )


if __name__ == "__main__":
    main()
