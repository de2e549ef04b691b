# SPDX-License-Identifier: Apache-2.0
"""Scores of a real take at a left-out camera: whole picture, people, background, and the photos-only baseline.

    STUDIORECON_REAL_DATA=... python -m benchmarks.captures --folder DIR [--cameras cam01 cam02 …] [--frames 50]
    [--cores 2]

Reconstructs ``pose2sim_balancing/single`` (one man, four real cameras 49 to 120 degrees apart) once with all cameras,
for masks of the man in every camera, then once without each camera in turn, with the default settings and with
``config/presets/fourview.yaml`` (the photos alone, random start). Pictures of the camera that was left out are measured
as ``report.score`` measures them. DIR keeps the runs: stopped and started again, it goes on where it was. Eight to
fifteen minutes per camera on two cores; writes benchmarks/results/captures.json after every camera.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from studiorecon.footage.video import read_frames, write_lossless
from studiorecon.report.score import score

ROOT = Path(__file__).resolve().parents[1]
RESULT = Path(__file__).parent / "results" / "captures.json"
TAKE, MAN = "pose2sim_balancing/single", ("cam01", "cam02", "cam03", "cam04")
MEASURES = ("psnr", "ssim", "psnr_people", "ssim_people", "psnr_background", "ssim_background")
UNASSIGNED = 255
FILMS = {"ours": "enhance/heldout.mkv", "render": "render/heldout.mkv"}


def workflow(
    folder: Path,
    scene: str,
    held_out: list[str],
    frames: int,
    cores: str,
    targets: list[str],
    overlays: list[str],
    *,
    take: str = TAKE,
    first: int = 0,
) -> None:
    """Make ``targets`` (below results/<scene>) of the take without ``held_out``; raises with the end of the log when
    that fails."""
    text = (ROOT / f"tests/captures/{take.replace('_balancing/', '_')}.yaml").read_text(encoding="utf-8")
    reported = yaml.safe_load(text) | {"held_out": held_out, "frames": {"first": first, "count": frames}}
    description = folder / f"{scene}.yaml"
    description.write_text(yaml.safe_dump(reported), encoding="utf-8")
    dataset = Path(os.environ.get("STUDIORECON_REAL_DATA", "../shared/data")).resolve() / take
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", cores]
    command += ["--directory", str(folder), "--configfile", str(ROOT / "config/config.yaml")]
    command += [*(str(ROOT / overlay) for overlay in overlays), "--config", f"dataset={dataset}", f"scene={scene}"]
    command += [f"capture_yaml={description}", "body=" + str(ROOT / "resources/body.npz"), "--"]
    command += [f"results/{scene}/{target}" for target in targets]
    log = folder / f"{scene}.log"
    with open(log, "a", encoding="utf-8") as file:
        ended = subprocess.run(
            command, cwd=ROOT, env={**os.environ, "PATH": path}, stdout=file, stderr=subprocess.STDOUT, check=False
        )
    if ended.returncode:
        raise SystemExit(log.read_text(encoding="utf-8")[-3000:])


def people_only(masks: Path) -> Iterator[np.ndarray]:
    """(H, W) uint8 per frame, 1 where anybody was identified: what is nobody's does not count as a person."""
    for labels in read_frames(masks):
        yield ((labels > 0) & (labels != UNASSIGNED)).astype(np.uint8)


def measured(folder: Path, scene: str, camera: str, film: str) -> dict[str, float]:
    """Measures of one film at the camera that was left out; the man's mask comes from the run with all cameras."""
    made = folder / "score" / camera
    shutil.rmtree(made, ignore_errors=True)
    for part in ("renders", "truth", "masks"):
        (made / part).mkdir(parents=True)
    shutil.copy(folder / f"results/{scene}/{film}", made / f"renders/{camera}.mkv")
    shutil.copy(folder / f"results/{scene}/capture/{camera}.mkv", made / f"truth/{camera}.mkv")
    write_lossless(made / f"masks/{camera}.mkv", people_only(folder / f"results/all/masks/{camera}.mkv"), 60.0)
    found = score(made / "renders", made / "truth", made / "masks")["pictures"]["renders"]
    return {name: found[name]["value"] for name in MEASURES}


def main() -> None:
    """One row per camera and version."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--cameras", nargs="+", choices=MAN, default=list(MAN))
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--cores", default="2")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    folder, about = given.folder.resolve(), (given.frames, given.cores)
    workflow(folder, "all", [], *about, [f"masks/{camera}.mkv" for camera in MAN], [])
    rows: dict[str, Any] = {}
    for camera in given.cameras:
        scene = f"without_{camera}"
        workflow(folder, scene, [camera], *about, list(FILMS.values()), [])
        row = {version: measured(folder, scene, camera, film) for version, film in FILMS.items()}
        workflow(folder, scene, [camera], *about, ["render/heldout.mkv"], ["config/presets/fourview.yaml"])
        row["three photos"] = measured(folder, scene, camera, "render/heldout.mkv")
        rows[camera] = row
        for version, values in row.items():
            print(
                f"{camera} {version:>12}: " + ", ".join(f"{name} {value:.3f}" for name, value in values.items()),
                flush=True,
            )
        means = {v: {m: float(np.mean([r[v][m] for r in rows.values()])) for m in MEASURES} for v in row}
        result = {"take": TAKE, "frames": given.frames, "date": str(date.today()), "left_out": rows, "mean": means}
        RESULT.write_text(json.dumps(result, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
