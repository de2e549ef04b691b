# SPDX-License-Identifier: Apache-2.0
"""A small scene scored and reported without truth, with the footage itself as renders."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import read_frame, write_lossless, write_watchable
from studiorecon.report import evaluate, page
from studiorecon.scene.decisions import Decision, write_decisions
from studiorecon.scene.effects import INJECTION
from studiorecon.scene.files import write_json, write_table, write_text
from studiorecon.scene.path import PathStep, write_path

from tests.made.scene import FPS, FRAMES, WH, write_scene
from tests.made.steps import call


def nobody_recognised(folder: Path) -> Path:
    """What ``report.recognition`` writes where the photos show nobody."""
    none = {"pck_0.05": None, "pck_0.1": None, "detection_rate": None, "reason": "no person is in the photos"}
    write_json(folder / "recognition.json", {"raw": none, "enhanced": none, "detector": "made"})
    return folder / "recognition.json"


def poses_of_nobody(folder: Path) -> Path:
    """What ``cameras.held_out`` writes where nobody was looked for."""
    write_json(folder / "poses.json", {"cameras": []})
    return folder / "poses.json"


LEFT_OUT = {
    "name": "r0",
    "seconds": 2.53,
    "cameras": ["left", "right"],
    "reason": "it has no <depth>",
    "tracks": [["left", 3], ["right", 1]],
    "lines": ["left\t3\tp0", "right\t1\tp0"],
}


def report_scene(folder: Path, root: Path, default_settings: Callable, lpips: Path = Path("none")) -> Path:
    """Write the scene, its scores and its page into ``folder``; returns it. ``lpips`` holds LPIPS' weights."""
    cameras = write_scene(folder, root, people=0)
    held_out, training = cameras["held_out"], cameras["training"]
    pictures = [read_frame(folder / f"capture/{c.name}.mkv", f) for c in held_out for f in range(FRAMES)]
    write_lossless(
        folder / "render/heldout.mkv", [np.clip(p.astype(int) + 5, 0, 255).astype(np.uint8) for p in pictures], FPS
    )
    write_lossless(folder / "enhance/heldout.mkv", pictures, FPS)
    write_watchable(folder / "enhance/heldout.mp4", pictures, FPS)
    write_lossless(folder / "render/heldout.truth.mkv", [np.full((WH[1], WH[0]), 128, np.uint8)] * len(pictures), FPS)
    write_path(
        folder / "render/heldout.json", [PathStep(c, float(f), c.name) for c in held_out for f in range(FRAMES)], FPS
    )
    columns = ("picture", "segment", "frame", "measured", "inferred", "invented", "angle_deg", "near")
    write_table(
        folder / "render/heldout.tsv",
        columns,
        [(0, "00", 0, 0.4, 0.6, 0, 10, ""), (1, "00", 1, 0.9, 0.1, 0, 10, "<p1>")],
    )
    for camera in training:
        write_depth(folder / f"depth/{camera.name}.exr", np.full((WH[1], WH[0]), 3.0), np.ones((WH[1], WH[0])))
        plate = np.dstack(
            [read_frame(folder / f"capture/{camera.name}.mkv", 0)[..., ::-1], np.full((WH[1], WH[0]), 255, np.uint8)]
        )
        (folder / "plates").mkdir(exist_ok=True)
        cv2.imwrite(str(folder / f"plates/{camera.name}.png"), plate)
    early = [
        Decision("people", "s", 0.0, (0.0, 0.0), 0.5, "off", "an <empty> room"),
        INJECTION.decide(None, None, "not measured here: too early"),
    ]
    write_decisions(folder / "survey/decisions.json", early)
    write_decisions(
        folder / "report/audit.json",
        [Decision("injection", "s", 0.3, (0.28, 0.32), 0.2, "on", "it flickers", used_by="X")],
    )
    write_json(folder / "cameras/refinement.json", {"cameras": [c.name for c in training]})
    cv2.imwrite(str(folder / "cameras/refinement.png"), np.full((60, 90, 3), 128, np.uint8))
    write_json(folder / "people/association.json", {"corrected": False, "tracks": [], "left_out": [LEFT_OUT]})
    section = default_settings("report")
    common = {"manifest": folder / "capture/manifest.json", "model": folder / "cameras/images.txt"}
    shot = {"render": [folder / "render/heldout.mkv"], "render_path": [folder / "render/heldout.json"]}
    call(
        evaluate.run,
        settings_module.load(evaluate.Settings, section, "report"),
        **common,
        **shot,
        heldout_model=folder / "cameras/heldout/images.txt",
        poses=poses_of_nobody(folder / "cameras/heldout"),
        videos=[folder / f"capture/{c.name}.mkv" for c in reversed(held_out)],
        enhanced=[folder / "enhance/heldout.mkv"],
        truth_maps=[folder / "render/heldout.truth.mkv"],
        metrics=folder / "report/metrics.json",
        lpips=lpips,
    )
    (folder / "deliver").mkdir()
    cv2.imwrite(str(folder / "deliver/player.jpg"), np.full((54, 96, 3), 90, np.uint8))
    write_text(folder / "deliver/player.html", "<!doctype html><title>player</title>")
    write_text(folder / "logs/render/shot/orbit.log", "drawn\nwarning: the path passes through <p0>\n")
    call(
        page.run,
        settings_module.load(page.Settings, section, "report"),
        **common,
        metrics=folder / "report/metrics.json",
        recognition=[nobody_recognised(folder / "report")],
        decisions=[folder / "survey/decisions.json", folder / "report/audit.json"],
        films=[folder / "enhance/heldout.mp4"],
        association=[folder / "people/association.json"],
        linked=[],
        benchmarks=folder / "none",
        logs=folder / "logs",
        configuration=json.dumps({"dataset": "x"}),
        budget="{}",
        licences=root / "resources/licences",
        paper=root / "resources/paper/results.tsv",
        poster=folder / "deliver/player.jpg",
        costs=folder / "report/cost.json",
        page=folder / "report/index.html",
    )
    return folder
