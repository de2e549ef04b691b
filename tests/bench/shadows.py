# SPDX-License-Identifier: Apache-2.0
"""What thrown shadows buy: a synthetic studio whose people shade the floor, filmed again at its held-out cameras with
and without them.

    python -m tests.bench.shadows [--house FOLDER] [--picture FILE]

Runs the small studio below up to background, people and light (some minutes on two cores), draws the held-out cameras
twice and measures PSNR against the true films outside people: on pixels that people shade there (by more than 3 %), on
floor within 1 m of their feet, and on all, beside how far the floor's brightness is off there. Table to
tests/bench/results/shadows.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import read_stack
from studiorecon.geometry.floor import floor_points
from studiorecon.images.metrics import psnr
from studiorecon.render.canvas import Canvas
from studiorecon.render.room_light import read_light
from studiorecon.render.shot import read_composite
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.studio.room import LAMP_SHARES, LAMPS_M

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).parent / "results" / "shadows.json"
STUDIO = {
    "seed": 3,
    "frames": 24,
    "fps": 15.0,
    "size": [320, 180],
    "people": 2,
    "cameras": {"held_out": 2},
    "effects": {"moving_shadows": True, "contact_shading": 0.5},
    "detections": {"noise_px": 0.5},
}
_SHADED, _RING_M = 0.03, 1.0
KINDS = ("shaded", "ring", "everywhere")


def made(house: Path) -> Path:
    """Result folder of the small studio below ``house``, made as far as films need it."""
    (house / "shadows.yaml").write_text(yaml.safe_dump(STUDIO), encoding="utf-8")
    scene = house / "results/shadows"
    wanted = ["background/scene.ply", "humans/p0.ply", "humans/p1.ply", "render/room.light.json"]
    targets = [f"results/shadows/{name}" for name in wanted]
    command = [sys.executable, "-m", "snakemake", *targets, "--snakefile", str(ROOT / "Snakefile"), "--cores", "2"]
    subprocess.run([*command, "--config", f"dataset={house / 'shadows.yaml'}"], cwd=house, check=True)
    return scene


def measured(scene: Path, truth: Path, picture: Path | None) -> dict[str, dict[str, dict[str, float]]]:
    """PSNR by held-out camera, kind of pixel, and with or without shadows."""
    people = sorted((scene / "humans").glob("p?.ply"))
    room, light = scene / "background", scene / "render/room.light.json"
    shaded = read_composite(
        *(room / "scene.ply", room / "provenance.npz"),
        *(people, [p.with_suffix(".npz") for p in people]),
        *(ROOT / "resources/body.npz", "heldout", {}, [light]),
    )
    films = {"without": Canvas(replace(shaded, shading=None), 0.2), "with": Canvas(shaded, 0.2)}
    table: dict[str, dict[str, dict[str, float]]] = {}
    rows = []
    for camera in read_model(scene / "cameras/heldout"):
        true, masks = (
            read_stack(scene / f"capture/{camera.name}.mkv"),
            read_stack(truth / "masks" / f"{camera.name}.mkv"),
        )
        empty = cv2.imread(str(truth / "plates" / f"{camera.name}.png"))[..., ::-1].astype(np.float32) / 255
        depth = Rasteriser(near_m=0.05).forward(shaded.background, camera).depth_m
        points, floor = floor_points(camera, depth, read_light(light).floor_m)
        drawn: dict[str, list[np.ndarray]] = {name: [] for name in films}
        chosen: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
        for frame, (photo, labels) in enumerate(zip(true, masks)):
            free = cv2.dilate((labels > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
            level = photo.astype(np.float32).mean(axis=-1) / 255
            feet = np.concatenate([person.joints_m(frame)[[7, 8], :2] for person in shaded.people])
            near = np.min([np.hypot(*(points[..., :2] - foot).transpose(2, 0, 1)) for foot in feet], axis=0) < _RING_M
            chosen["shaded"].append(free & (level < (1 - _SHADED) * empty.mean(axis=-1)) & floor)
            chosen["ring"].append(free & floor & near)
            chosen["everywhere"].append(np.ones_like(free))
            for name, canvas in films.items():
                drawn[name].append(canvas.draw(camera, float(frame), (0.0, 0.0, 0.0))[0].rgb.clip(0, 1))
        photos = true.astype(np.float32) / 255
        table[camera.name] = {
            kind: {name: round(psnr(_one(drawn[name]), _one(photos), _one(pixels)), 2) for name in films}
            for kind, pixels in chosen.items()
        }
        levels = {name: round(_level_off_by(drawn[name], photos, chosen["ring"]), 4) for name in films}
        table[camera.name]["level_off_by"] = levels
        middle = len(true) // 2
        rows.append(np.hstack([photos[middle], drawn["without"][middle], drawn["with"][middle]]))
    if picture is not None:
        cv2.imwrite(str(picture), np.rint(np.vstack(rows)[..., ::-1] * 255).astype(np.uint8))
    return table


def _level_off_by(pictures: Sequence[np.ndarray], photos: np.ndarray, chosen: Sequence[np.ndarray]) -> float:
    """Root mean square log ratio of brightness to the photo's, both averaged over 9 × 9 of the chosen pixels: shade,
    not detail."""
    squares, count = 0.0, 0
    for picture, photo, pixels in zip(pictures, photos, chosen):
        here = pixels.astype(np.float32)
        sums = [cv2.blur(image.mean(axis=-1) * here, (9, 9)) for image in (picture, photo)]
        whole = pixels & (cv2.blur(here, (9, 9)) > 0.5)
        squares += float((np.log(sums[0][whole] / sums[1][whole]) ** 2).sum())
        count += int(whole.sum())
    return float(np.sqrt(squares / max(count, 1)))


def _one(pictures: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate(list(pictures))


def lamp_error_deg(scene: Path) -> list[float]:
    """Angle at the middle of the floor between each true lamp and the middle of the patches nearest to it, degrees."""
    light = read_light(scene / "render/room.light.json")
    truth = np.array([[x, y, 2.94] for x, y, *_ in LAMPS_M])
    directions = light.lamps.positions_m / np.linalg.norm(light.lamps.positions_m, axis=1, keepdims=True)
    wanted = truth / np.linalg.norm(truth, axis=1, keepdims=True)
    whose = (directions @ wanted.T).argmax(axis=1)
    angles = []
    for lamp in range(len(LAMP_SHARES)):
        middle = (light.share[:, None] * directions)[whose == lamp].sum(axis=0)
        cosine = middle @ wanted[lamp] / max(np.linalg.norm(middle), 1e-9)
        angles.append(round(float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))), 1))
    return angles


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--house", type=Path, default=None, help="working directory that is kept; made and removed when not given"
    )
    parser.add_argument("--picture", type=Path, default=None, help="photo, without and with shadows, side by side")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        house = (options.house or Path(temporary)).resolve()
        scene = made(house)
        begun = time.perf_counter()
        table = measured(scene, house / "results/studio/shadows/truth", options.picture)
        light = json.loads((scene / "render/room.light.json").read_text())
        angles = lamp_error_deg(scene)
    for camera, kinds in table.items():
        print(
            camera,
            ", ".join(f"{kind} {kinds[kind]['without']:.2f} → {kinds[kind]['with']:.2f} dB" for kind in KINDS),
            end=", ",
        )
        print(
            f"brightness in the ring off by {kinds['level_off_by']['without']:.1%} → "
            f"{kinds['level_off_by']['with']:.1%}"
        )
    print(f"light: {light['reason']}; lamps off by {angles} degrees; {time.perf_counter() - begun:.0f} s")
    result = {"studio": STUDIO, "cameras": table, "light": light["figures"], "lamps_off_by_deg": angles}
    RESULTS.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
