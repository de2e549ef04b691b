# SPDX-License-Identifier: Apache-2.0
"""Whether people have left ghosts in the room: the room alone against the true empty room, where people were and where
none ever was.

    snakemake --cores 2 results/demo/background/scene.ply          # once
    python -m tests.bench.ghosts [--scene results/demo] [--truth results/studio/demo/truth]

PSNR of the trained background without people, at the working size: on the pixels that the truth calls a person's in any
frame, and on all others; at the training cameras, where a ghost would stand, and at the held-out ones, where misplaced
furniture costs more than any ghost. Table to tests/bench/results/ghosts.json.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import read_frames
from studiorecon.images.metrics import psnr
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.splatting.cpu.rasterise import Rasteriser

RESULTS = Path(__file__).parent / "results" / "ghosts.json"
BAR_DB = 26.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", type=Path, default=Path("results/demo"))
    parser.add_argument("--truth", type=Path, default=Path("results/studio/demo/truth"))
    options = parser.parse_args()
    room, rasteriser = read_ply(options.scene / "background/scene.ply"), Rasteriser(near_m=0.05)
    table: dict[str, dict[str, float]] = {}
    for kind, folder in (("training", "cameras"), ("held out", "cameras/heldout")):
        for camera in read_model(options.scene / folder):
            empty = cv2.imread(str(options.truth / "plates" / f"{camera.name}.png"))[..., ::-1].astype(np.float32) / 255
            people = np.zeros(empty.shape[:2], bool)
            for labels in read_frames(options.truth / "masks" / f"{camera.name}.mkv", 0, None):
                people |= labels > 0
            shown = rasteriser.forward(room, camera.resized(empty.shape[1::-1])).rgb.clip(0, 1)
            former, others = psnr(shown, empty, people), psnr(shown, empty, ~people)
            table[camera.name] = {"where_people_were_db": round(former, 2), "elsewhere_db": round(others, 2)}
            verdict = "" if kind == "held out" else "holds  " if former >= BAR_DB else "MISSED "
            print(
                f"{verdict}{kind} {camera.name}: {former:.2f} dB where people were "
                f"({people.mean():.0%}), {others:.2f} dB elsewhere"
            )
    RESULTS.write_text(json.dumps({"bar_db": BAR_DB, "cameras": table}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
