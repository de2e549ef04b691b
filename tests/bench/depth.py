# SPDX-License-Identifier: Apache-2.0
"""Seconds and accuracy of depth and views on a made capture: ``python tests/bench/depth.py TRUTH_FOLDER [--preset standard] [--set k=v]``.

TRUTH_FOLDER is the ``truth`` folder of a studio capture (plates, depth, cameras). Plates are the true empty room, so people and the
temporal plate play no part; depth is compared with the exact one, views with the held-out plates. Run alone on the machine: one thread is
used, and other work halves its speed.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import time
from datetime import date
from pathlib import Path

import cv2
import numpy as np
import yaml
from studiorecon.depth import refine, shell, sweep
from studiorecon.images.exr import read_depth
from studiorecon.images.stills import read_plate
from studiorecon.images.video import to_bytes
from studiorecon.scene.camera import Camera
from studiorecon.scene.colmap import write_model
from studiorecon.scene.files import read_json
from studiorecon.scene.shell import read_shell
from studiorecon.settings import load
from studiorecon.views import synthesize
from studiorecon.views.forward import Source, blend, source

ROOT = Path(__file__).resolve().parents[2]


def section(stage: str, preset: str, changes: list[str]) -> dict:
    values = yaml.safe_load((ROOT / "config/config.yaml").read_text())[stage]
    if preset:
        values |= (yaml.safe_load((ROOT / f"config/presets/{preset}.yaml").read_text()) or {}).get(stage) or {}
    given = {k: yaml.safe_load(v) for k, v in (change.split("=", 1) for change in changes)}
    return values | {k: v for k, v in given.items() if k in values}


def seen_by(cameras: list[Camera], depths: list[np.ndarray], index: int) -> np.ndarray:
    """(H, W) number of training cameras that see each pixel's surface, by exact depth."""
    points = cameras[index].unproject(cameras[index].pixel_centres(), depths[index].astype(np.float64))
    count = np.zeros(depths[index].shape, int)
    for camera, depth in zip(cameras, depths):
        pixels, z = camera.project(points)
        at = np.floor(np.nan_to_num(pixels, nan=-1)).astype(int)
        inside = (z > 0.05) & (at >= 0).all(-1) & (at[..., 0] < camera.wh[0]) & (at[..., 1] < camera.wh[1])
        there = depth[at[..., 1].clip(0, camera.hw[0] - 1), at[..., 0].clip(0, camera.wh[0] - 1)]
        count += inside & (np.abs(there - z) < 0.03 * z + 0.03)
    return np.maximum(count, 1)


def picture(path: Path, rows: list[list[np.ndarray]]) -> None:
    """Rows of pictures (uint8 RGB) or maps in [0, 1] (shown in colours) as one PNG."""
    shown = [[cv2.applyColorMap(to_bytes(x), cv2.COLORMAP_TURBO) if x.ndim == 2 else x[..., ::-1] for x in row] for row in rows]
    cv2.imwrite(str(path), np.concatenate([np.concatenate(row, axis=1) for row in shown]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--preset", default="")
    parser.add_argument("--set", nargs="*", default=[], dest="changes")
    parser.add_argument("--pictures", type=Path, default=None, help="folder for colour-mapped depth and views")
    given = parser.parse_args()
    held_out = set(read_json(given.truth / "truth.json")["held_out"])
    everyone = [Camera.from_json(c) for c in read_json(given.truth / "cameras.json")]
    cameras = [c for c in everyone if c.name not in held_out]
    print(f"{date.today()} {platform.processor() or platform.machine()}, {given.truth}, preset {given.preset or 'draft'} {given.changes}")
    values = section("depth", given.preset, given.changes)
    plates = [given.truth / f"plates/{c.name}.png" for c in cameras]
    truth = [read_depth(given.truth / f"depth/{c.name}.exr")[0] for c in cameras]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_model(folder, cameras)
        model, box, passes = folder / "images.txt", folder / "shell.json", folder / "passes.npz"
        sweeps, maps = [folder / f"{c.name}.npz" for c in cameras], [folder / f"{c.name}.exr" for c in cameras]
        clock = [time.perf_counter()]
        for camera, path in zip(cameras, sweeps):
            sweep.run(load(sweep.Settings, values, "depth"), camera.name, model, plates, path)
        clock.append(time.perf_counter())
        solids, drawn = folder / "solids.json", folder / "solids.png"
        shell.run(load(shell.Settings, values, "depth"), model, plates, sweeps, box, solids, drawn, passes)
        clock.append(time.perf_counter())
        for camera, path in zip(cameras, maps):
            refine.run(load(refine.Settings, values, "depth"), camera.name, model, plates, passes, box, solids, path)
        clock.append(time.perf_counter())
        found, confidence = map(list, zip(*map(read_depth, maps)))
        gains = read_shell(box).gains
    print("seconds: sweeps {:.1f}, shell {:.1f}, refinement {:.1f}, all {:.1f}".format(*np.diff(clock), clock[-1] - clock[0]))
    error = np.concatenate([(np.abs(d - t) / t).ravel() for d, t in zip(found, truth)])
    count = np.concatenate([seen_by(cameras, truth, i).ravel() for i in range(len(cameras))])
    for label, where in (("all", count > 0), ("seen by two", count > 1), ("seen by one", count == 1)):
        print(f"{label} ({where.mean():.0%}): AbsRel {error[where].mean():.4f}, within 5 % {(error[where] < 0.05).mean():.1%}")
    warp = load(synthesize.Settings, section("views", given.preset, given.changes), "views")

    def photos(depths: list[np.ndarray]) -> list[Source]:
        read = [read_plate(p) for p in plates]
        even = [np.clip(rgb / gains[c.name].astype(np.float32), 0, 1) for c, (rgb, _) in zip(cameras, read)]
        return [source(c, e, m, d, warp.depth_jump) for c, e, (_, m), d in zip(cameras, even, read, depths)]

    sheets = []
    for label, depths in (("found", found), ("true", truth)):
        carried, scores, started = photos(depths), [], time.perf_counter()
        for camera in (c for c in everyone if c.name in held_out):
            rgb, support, _ = blend(camera, carried, warp.oversampling, warp.z_tolerance, np.radians(warp.fade_deg))
            painted = synthesize.paint_holes(rgb, support, warp.inpaint_radius)
            target = read_plate(given.truth / f"plates/{camera.name}.png")[0]
            scores.append((-10 * np.log10(((painted / 255 - target) ** 2).mean()), (support == 0).mean()))
            sheets.append([painted, to_bytes(target), support])
        each = (time.perf_counter() - started) / max(len(scores), 1)
        quality, holes = np.mean(scores, axis=0)
        print(f"warp through {label} depth: {quality:.2f} dB over {len(scores)} held-out views, {holes:.1%} hole, {each:.2f} s a view")
    if given.pictures:
        given.pictures.mkdir(parents=True, exist_ok=True)
        columns = [[d / 8 for d in found], [t / 8 for t in truth], [np.abs(d - t) * 0.5 for d, t in zip(found, truth)], confidence]
        picture(given.pictures / "depth.png", columns)
        picture(given.pictures / "views.png", sheets)


if __name__ == "__main__":
    main()
