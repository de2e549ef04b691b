# SPDX-License-Identifier: Apache-2.0
"""A person taken out of a real take, against the same take filmed without her.

    STUDIORECON_REAL_DATA=... python -m tests.bench.takes --folder DIR [--frames 99] [--cores 2]

``pose2sim_balancing/multi`` is ``single`` with a woman put in; she has no keypoints and is found by what stands out
from the clean plates. ``multi`` is reconstructed, room and man are rendered without her at the training cameras, and
compared with ``single``'s frames: where she stood, and where nobody is. Her pixels are those in which the two takes
differ, not what the masks say. Small on purpose (``SMALL``); DIR keeps the runs. Pictures go to DIR, the table to
tests/bench/results/multi.json.
"""

from __future__ import annotations

import argparse
import json
from datetime import date
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from studiorecon.body.avatar.avatar_files import Avatar, read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames, to_bytes
from studiorecon.images.metrics import psnr
from studiorecon.images.warp import sample
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.people import read_people
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.bench.captures import MAN, ROOT, workflow

RESULT = Path(__file__).parent / "results" / "multi.json"
MULTI = "pose2sim_balancing/multi"
# Frame k of multi is frame k - 1 of single.
LAG = 1
SMALL: dict[str, Any] = {
    "capture": {"width": 320},
    "depth": {"sweep_width": 120, "refine_width": 160, "primitives": 0},
    "views": {"views_per_segment": 6},
    "background": {"training": {"iterations": 700}},
    "humans": {"gaussians": 4000, "iterations": 400},
}
# Difference of the two takes that is the woman and not their compression: grey levels of 255, and pixels around.
_DIFFERENT, _AROUND = 30.0, 7


def where_she_is(multi: np.ndarray, single: np.ndarray) -> np.ndarray:
    """(H, W) bool: the two takes differ by more than compression; specks are left out, and what is within some pixels
    is counted in."""
    differs = (np.abs(multi.astype(np.float32) - single).mean(axis=-1) > _DIFFERENT).astype(np.uint8)
    differs = cv2.morphologyEx(differs, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return cv2.dilate(differs, np.ones((_AROUND, _AROUND), np.uint8)) > 0


def shown(rasteriser: Rasteriser, room: Gaussians, people: list[Avatar], camera: Camera, frame: int) -> np.ndarray:
    """(H, W, 3) room and people as one camera sees them."""
    return rasteriser.forward(concatenate([room, *(person.posed(frame) for person in people)]), camera).rgb.clip(0, 1)


def pictures(folder: Path, scene: str, camera: str) -> list[np.ndarray]:
    return list(read_frames(folder / f"results/{scene}/capture/{camera}.mkv"))


def the_man(scene: Path, cameras: list[Camera], single: dict[str, np.ndarray]) -> str:
    """The person whose joints lie on what differs from the plates in ``single``: nobody else is in that take.

    The keypoints of ``multi`` hold a skeleton of nobody as well, which a clip too short for movement does not tell from
    a person.
    """
    share = {}
    for path in sorted((scene / "people").glob("p*.npz")):
        person, on = read_person(path), []
        for camera in cameras:
            plate, _ = read_plate(scene / f"plates/{camera.name}.png")
            differs = np.abs(single[camera.name] / 255 - plate).mean(axis=-1) > _DIFFERENT / 255
            pixels, _ = camera.project(person.joints[0])
            on.append(sample(differs.astype(np.float32), pixels[None], "nearest")[0])
        share[person.name] = float(np.mean(on))
    print(
        "joints on what differs from the plates: " + ", ".join(f"{name} {value:.2f}" for name, value in share.items()),
        flush=True,
    )
    return max(sorted(share), key=share.__getitem__)


def compared(folder: Path, frames: int) -> dict[str, Any]:
    """Decibels per camera of three pictures against ``single``: room and man, the room alone, and ``multi``'s own
    photo."""
    scene = folder / "results/multi"
    body = BodyModel.load(ROOT / "resources/body.npz")
    room, cameras = read_ply(scene / "background/scene.ply"), read_model(scene / "cameras")
    man = the_man(scene, cameras, {c.name: pictures(folder, "single", c.name)[0] for c in cameras})
    avatar = read_avatar(scene / f"humans/{man}.ply", scene / f"humans/{man}.npz", body)
    rasteriser = Rasteriser(near_m=0.05)
    table: dict[str, Any] = {}
    for camera in cameras:
        multi, single = pictures(folder, "multi", camera.name), pictures(folder, "single", camera.name)
        labels = list(read_frames(scene / f"masks/{camera.name}.mkv"))
        made = {"room and man": [avatar], "room": []}
        errors: dict[str, list[tuple[float | None, float | None]]] = {name: [] for name in (*made, "photo with her")}
        share = []
        for k in range(min(frames, len(multi), len(single))):
            hers = where_she_is(multi[k], single[k])
            nobody = ~hers & (cv2.dilate((labels[k] > 0).astype(np.uint8), np.ones((_AROUND, _AROUND), np.uint8)) == 0)
            truth = single[k].astype(np.float32) / 255
            looks = {name: shown(rasteriser, room, people, camera, k) for name, people in made.items()}
            looks["photo with her"] = multi[k].astype(np.float32) / 255
            for name, look in looks.items():
                errors[name].append((psnr(look, truth, hers), psnr(look, truth, nobody)))
            share.append(float(hers.mean()))
            if k == frames // 2:
                row = [
                    multi[k],
                    to_bytes(looks["room and man"]),
                    single[k],
                    np.repeat(hers[..., None] * np.uint8(255), 3, 2),
                ]
                cv2.imwrite(str(folder / f"{camera.name}.png"), np.concatenate(row, axis=1)[..., ::-1])
        table[camera.name] = {"her_share": round(float(np.mean(share)), 4)} | {
            name: {
                part: round(float(np.mean(known)), 2) if (known := [v[i] for v in values if v[i] is not None]) else None
                for i, part in enumerate(("where_she_was_db", "nobody_db"))
            }
            for name, values in errors.items()
        }
        print(camera.name, json.dumps(table[camera.name]), flush=True)
    return table


def main() -> None:
    """One row per camera."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=99)
    parser.add_argument("--cores", default="2")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    folder = given.folder.resolve()
    overlay = folder / "small.yaml"
    overlay.write_text(yaml.safe_dump(SMALL), encoding="utf-8")
    plain = [f"capture/{camera}.mkv" for camera in MAN]
    workflow(folder, "single", [], given.frames, given.cores, plain, [str(overlay)])
    # Who is there is known after the identities alone.
    about = (given.frames, given.cores)
    workflow(folder, "multi", [], *about, ["people/people.tsv"], [str(overlay)], take=MULTI, first=LAG)
    everybody = read_people(folder / "results/multi/people/people.tsv")
    wanted = ["background/scene.ply", *(f"humans/{name}.ply" for name in everybody)]
    workflow(folder, "multi", [], *about, wanted, [str(overlay)], take=MULTI, first=LAG)
    result = {
        "take": MULTI,
        "frames": given.frames,
        "date": str(date.today()),
        "settings": SMALL,
        "cameras": compared(folder, given.frames),
    }
    RESULT.write_text(json.dumps(result, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
