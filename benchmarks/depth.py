# SPDX-License-Identifier: Apache-2.0
"""Seconds and accuracy of depth on made rooms and on posed renderings with dense depth, with and without errors of
exposure and pose.

``python -m benchmarks.depth --rooms TRUTH ... [--posed FOLDER [--views K ...]] [--set k=v] [--pictures FOLDER]``
writes benchmarks/results/depth.json.

TRUTH is the ``truth`` folder of a studio capture (plates, depth, cameras); plates are the true empty room, so people
and the temporal plate play no part. Depth is compared with the exact one per class (seen by two cameras or more, seen
by one), walls with where they stand, and the held-out plates with the photos carried there through the depth (holes
inpainted). FOLDER holds ``rgb/*.png`` and ``condition.npz`` (poses, intrinsics, depths). Seconds are of this process on
this machine, processor time beside wall time: other work on it slows both.
"""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
import time
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import cv2
import numpy as np
import yaml
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration.settings import load
from studiorecon.depth import box as walls
from studiorecon.depth import refine, sweep
from studiorecon.depth import room as room_box
from studiorecon.depth.layout.primitives import read_primitives
from studiorecon.footage.exr import read_depth, write_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import to_bytes
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.room import read_room
from studiorecon.scene.schema import record
from studiorecon.studio.room import HALF_X_M, HALF_Y_M
from studiorecon.views import synthesize
from studiorecon.views.forward_warp import blend_photos, warp_source

from tests.defaults import default_settings, loaded
from tests.made.bent_depth import bent

ROOT = Path(__file__).resolve().parents[1]
# Cases in which the settings differ: without boxes.
CHANGES = {"bare": ["primitives=0"]}
# Cases with a planted network's depth (``tests.made.bent_depth``): the cameras of which it is wrong altogether.
NETWORK: dict[str, set[int]] = {"network": set(), "network, one wrong": {1}}


def section(stage: str, preset: str, changes: list[str]) -> dict:
    values = default_settings(stage)
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
    shown = [
        [cv2.applyColorMap(to_bytes(x), cv2.COLORMAP_TURBO) if x.ndim == 2 else x[..., ::-1] for x in row]
        for row in rows
    ]
    cv2.imwrite(str(path), np.concatenate([np.concatenate(row, axis=1) for row in shown]))


@dataclass(frozen=True)
class Room:
    """A scene with exact depth: training cameras, their plates and depths, and held-out cameras with theirs."""

    name: str
    cameras: list[Camera]
    plates: list[np.ndarray]
    truth: list[np.ndarray]
    views: list[Camera]
    targets: list[np.ndarray]
    made: bool


def made_room(folder: Path) -> Room:
    held_out = set(read_json(folder / "truth.json")["held_out"])
    everyone = [record(Camera, c) for c in read_json(folder / "cameras.json")]
    plates = {c.name: read_plate(folder / f"plates/{c.name}.png")[0] for c in everyone}
    cameras, views = [c for c in everyone if c.name not in held_out], [c for c in everyone if c.name in held_out]
    truth = [read_depth(folder / f"depth/{c.name}.exr")[0] for c in cameras]
    return Room(
        folder.name, cameras, [plates[c.name] for c in cameras], truth, views, [plates[c.name] for c in views], True
    )


def posed(folder: Path, chosen: list[int]) -> Room:
    """Renderings with camera-to-world poses (OpenCV axes, z up) and z-depth; the floor is put to z = 0."""
    with np.load(folder / "condition.npz") as stored:
        chosen = chosen or list(range(len(stored["poses"])))
        poses, lenses, truth = (stored[k][chosen].astype(np.float64) for k in ("poses", "intrinsics", "depths"))
    plates = [read_plate(folder / f"rgb/{k}.png")[0] for k in chosen]
    wh = (plates[0].shape[1], plates[0].shape[0])
    cameras = [Camera(f"cam{k}", wh, lens, np.linalg.inv(pose)) for k, pose, lens in zip(chosen, poses, lenses)]
    heights = np.concatenate([c.unproject(c.pixel_centres(), d)[..., 2][d > 0] for c, d in zip(cameras, truth)])
    poses[:, 2, 3] -= np.percentile(heights, 1)
    cameras = [replace(c, camera_from_world=np.linalg.inv(pose)) for c, pose in zip(cameras, poses)]
    return Room(folder.name, cameras, plates, [d.astype(np.float32) for d in truth], [], [], False)


def disturbed(room: Room, what: str, rng: np.random.Generator) -> Room:
    """The room with ±12 % gains and ±5 % white balance, or with cameras 0.3° and 2 cm off (r.m.s.)."""
    if what == "gains":
        gain = rng.uniform(0.88, 1.12, (len(room.plates), 1)) * rng.uniform(0.95, 1.05, (len(room.plates), 3))
        return replace(room, plates=[np.clip(p * g, 0, 1).astype(np.float32) for p, g in zip(room.plates, gain)])
    if what == "poses":
        moved = []
        for camera in room.cameras:
            pose = np.eye(4)
            pose[:3, :3] = (
                cv2.Rodrigues(rng.normal(0, np.radians(0.3) / np.sqrt(3), 3))[0] @ camera.rotation_camera_from_world
            )
            pose[:3, 3] = -pose[:3, :3] @ (camera.centre_m + rng.normal(0, 0.02 / np.sqrt(3), 3))
            moved.append(replace(camera, camera_from_world=pose))
        return replace(room, cameras=moved)
    return room


def planted(room: Room, wrong: set[int]) -> list[np.ndarray]:
    """A planted network's depth (H, W) of every camera; of the ``wrong`` ones the mirrored depth of the next."""
    truth = room.truth + room.truth[:1]
    shown = [truth[i + 1][:, ::-1] if i in wrong else truth[i] for i in range(len(room.cameras))]
    return [bent(depth, np.random.default_rng([i, 7])) for i, depth in enumerate(shown)]


def measure(room: Room, values: dict, pictures: Path | None, network: list[np.ndarray] | None = None) -> dict:
    """One estimate of all cameras' depth, compared with the truth; with a ``network``'s depth (H, W) of each."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_model(folder, room.cameras)
        plates = [folder / f"{c.name}.png" for c in room.cameras]
        for path, plate in zip(plates, room.plates):
            cv2.imwrite(str(path), to_bytes(plate)[..., ::-1])
        model, box, primitives = (folder / n for n in ("images.txt", "room.json", "primitives.json"))
        sweeps, maps = (
            [folder / f"{c.name}.npz" for c in room.cameras],
            [folder / f"{c.name}.exr" for c in room.cameras],
        )
        wall, cpu = [time.perf_counter()], [time.process_time()]

        def lap() -> None:
            wall.append(time.perf_counter())
            cpu.append(time.process_time())

        for camera, path in zip(room.cameras, sweeps):
            sweep.run(load(sweep.Settings, values, "depth"), camera.name, model, plates, path)
        lap()
        walls.run(load(walls.Settings, values, "depth"), model, plates, sweeps, folder / "box.json")
        files = folder / "box.json", [], box, primitives, folder / "primitives.png"
        room_box.run(load(room_box.Settings, values, "depth"), model, plates, sweeps, *files)
        lap()
        settings, estimates = load(refine.Settings, values, "depth"), [[] for _ in maps]
        for camera, numbers, paths in zip(room.cameras, network or [], estimates):
            paths.append(folder / f"{camera.name}.estimate.exr")
            write_depth(paths[0], numbers, np.ones_like(numbers))
        for camera, given, path in zip(room.cameras, estimates, maps):
            refine.run(settings, camera.name, model, plates, box, primitives, given, path)
        lap()
        found = [read_depth(path)[0] for path in maps]
        fitted, furniture = read_room(box), read_primitives(primitives)
        if pictures:
            pictures.mkdir(parents=True, exist_ok=True)
            (pictures / f"{room.name}.primitives.png").write_bytes((folder / "primitives.png").read_bytes())
    result = {
        "cpu_s": {k: round(v, 1) for k, v in zip(("sweeps", "room_box", "refine"), np.diff(cpu))},
        "wall_s": round(wall[-1] - wall[0], 1),
    }
    result["primitives"] = len(furniture)
    error = np.concatenate([(np.abs(d - t) / np.maximum(t, 1e-6))[t > 0] for d, t in zip(found, room.truth)])
    count = np.concatenate([seen_by(room.cameras, room.truth, i)[t > 0] for i, t in enumerate(room.truth)])
    for label, where in (("all", count > 0), ("seen_by_two", count > 1), ("seen_by_one", count == 1)):
        result[label] = {
            "share": round(float(where.mean()), 3),
            "abs_rel": round(float(error[where].mean()), 4),
            "within_5_percent": round(float((error[where] < 0.05).mean()), 4),
        }
    if room.made:
        true_m = np.array([HALF_X_M, HALF_Y_M])[[0 if abs(face[0]) > abs(face[1]) else 1 for face in fitted.faces[:4]]]
        result["walls_off_m"] = [round(float(abs(abs(f[3]) - t)), 4) for f, t in zip(fitted.faces[:4], true_m)]
    result["walls_fitted"] = [bool(f) for f in fitted.fitted]
    if room.views:
        result["warp_db"], sheets = carried(room, found, fitted.gains)
        if pictures:
            maps_in_colour = [
                [d / 8 for d in found],
                [t / 8 for t in room.truth],
                [np.abs(d - t) * 0.5 for d, t in zip(found, room.truth)],
            ]
            picture(pictures / f"{room.name}.depth.png", maps_in_colour)
            picture(pictures / f"{room.name}.views.png", sheets)
    return result


def carried(room: Room, depths: list[np.ndarray], gains: dict[str, np.ndarray]) -> tuple[float, list[list[np.ndarray]]]:
    """Mean PSNR over the held-out views of the photos carried there through ``depths``, and the pictures beside the
    truth."""
    warp = loaded(synthesize.Settings)
    even = [np.clip(p / gains[c.name].astype(np.float32), 0, 1) for c, p in zip(room.cameras, room.plates)]
    photos = [warp_source(c, e, np.ones(c.hw, bool), d, warp.depth_jump) for c, e, d in zip(room.cameras, even, depths)]
    scores, sheets = [], []
    for camera, target in zip(room.views, room.targets):
        rgb, support, _ = blend_photos(camera, photos, warp.oversampling, warp.z_tolerance, np.radians(warp.fade_deg))
        painted = synthesize.paint_holes(rgb, support, warp.inpaint_radius)
        scores.append(-10 * np.log10(((painted / 255 - target) ** 2).mean()))
        sheets.append([painted, to_bytes(target)])
    return round(float(np.mean(scores)), 2), sheets


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=Path, nargs="*", default=[])
    parser.add_argument("--posed", type=Path)
    parser.add_argument("--views", type=int, nargs="*", default=[], help="of the posed renderings, only these")
    parser.add_argument(
        "--cases", nargs="*", default=["plain", "bare", "gains", "poses"], help="see CHANGES and NETWORK"
    )
    parser.add_argument("--preset", default="")
    parser.add_argument("--set", nargs="*", default=[], dest="changes")
    parser.add_argument("--pictures", type=Path, default=None, help="folder for depth, views and primitives")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks/results/depth.json")
    given = parser.parse_args()
    stored = read_json(given.out) if given.out.is_file() else {"runs": {}}
    stored |= {"date": str(date.today()), "machine": platform.processor() or platform.machine()}
    rooms = [made_room(folder) for folder in given.rooms] + ([posed(given.posed, given.views)] if given.posed else [])
    for what in given.cases:
        for room in rooms:
            values = section("depth", given.preset, given.changes + CHANGES.get(what, []))
            # Every room its own errors, the same in every run.
            rng = np.random.default_rng([len(what), *room.name.encode()])
            shown = given.pictures / what if given.pictures and what == "plain" else None
            network = planted(room, NETWORK[what]) if what in NETWORK else None
            result = measure(disturbed(room, what, rng), values, shown, network)
            reported = {"changes": given.changes} | ({} if room.made else {"views": given.views})
            stored["runs"][f"{room.name} {what}"] = result | {k: v for k, v in reported.items() if v}
            print(room.name, what, json.dumps(result), flush=True)
            write_json(given.out, stored)


if __name__ == "__main__":
    main()
