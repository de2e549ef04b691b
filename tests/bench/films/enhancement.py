# SPDX-License-Identifier: Apache-2.0
"""What enhancement buys and costs on the finished demo: ``python -m tests.bench.films [--scene results/demo]
[--pictures 60]``, after what pictures cost.

Warp error (along the true film's flow, and the true film's own as the floor), PSNR and SSIM, overall, where a training
camera sees the surface, on people and at their outlines, without injection, with the paper's constants and with those
of config.yaml; the residual transfer against none; seconds per picture at 640×352 and 1280×704. ``--orbit-truth FILE``
also measures the orbit; the true orbit is ray-traced into FILE where it is missing (half an hour). Writes
``tests/bench/results/films.json``.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from studiorecon.body.model import BodyModel
from studiorecon.camera_files.colmap import read_model
from studiorecon.enhance import shot as enhance_shot
from studiorecon.enhance.backends import ResidualTransfer
from studiorecon.enhance.photos import training_of
from studiorecon.enhance.pilot import worth
from studiorecon.footage.video import read_frames, write_lossless
from studiorecon.images import metrics
from studiorecon.images.flow import consistent, dis_flow, grey_levels, one_thread
from studiorecon.images.transfer import ResidualSource, carried_over
from studiorecon.models.protocols import Enhancer
from studiorecon.recursive.clip import enhanced, for_path
from studiorecon.recursive.flows import DisFlow
from studiorecon.recursive.injection import Injection
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.effects import ENHANCEMENT
from studiorecon.scene.files import write_json
from studiorecon.scene.path import PathStep, read_path
from studiorecon.studio.actors import Actors
from studiorecon.studio.description import RESOURCES, read_description
from studiorecon.studio.film import backdrop, exposed, touched_pixels
from studiorecon.studio.room import room
from studiorecon.studio.sensor import Sensor, developed
from studiorecon.studio.tracing import Tracer

from tests.defaults import loaded

ROOT = Path(__file__).parents[3]
RESULT = Path(__file__).parents[1] / "results" / "films.json"
BARS_S = {(640, 352): 0.35, (1280, 704): 1.5}


@dataclass
class Film:
    """A rendered shot with the true pictures: steps, renders, depths in millimetres, truth, and people's masks where
    they are known."""

    steps: list[PathStep]
    raw: list[np.ndarray]
    depth_mm: list[np.ndarray]
    truth: list[np.ndarray]
    people: list[np.ndarray] | None


def true_orbit(scene: Path, description: Path, file: Path) -> None:
    """Ray-trace what a camera on the orbit's path would have filmed."""
    described = read_description(description)
    steps, fps = read_path(scene / "render/orbit.json")
    troupe = Actors(
        described, BodyModel.load(RESOURCES / "body.npz"), np.array([step.frame for step in steps]) / described.fps
    )
    soles, solids = troupe.soles_m(), room(described.seed, described.effects.glossy_floor)

    def pictures() -> Iterator[np.ndarray]:
        for index, step in enumerate(steps):
            one = step.camera
            lens = Lens(one.name, one.wh, one.intrinsics, "opencv", np.zeros(5), one.camera_from_world, np.eye(3)[:2])
            moving, _ = troupe.at(index)
            touched = touched_pixels(lens, moving)
            still = backdrop(lens, solids, described.supersampling)
            seen = exposed(still, Tracer(solids + moving), moving, touched, soles[index], described.effects)
            yield developed(seen, Sensor.perfect(), index)

    write_lossless(file, pictures(), fps)


def heldout_film(scene: Path, truth: Path, pictures: int) -> Film:
    """The first ``pictures`` of every held-out camera."""
    steps, _ = read_path(scene / "render/heldout.json")
    names = list(dict.fromkeys(step.segment for step in steps))
    within = [
        index - next(i for i, s in enumerate(steps) if s.segment == step.segment) for index, step in enumerate(steps)
    ]
    chosen = [index for index, place in enumerate(within) if place < pictures]
    take = lambda source: [frame for i, frame in enumerate(source) if i in set(chosen)]  # noqa: E731
    true, people = [], []
    for name in names:
        true += list(read_frames(scene / f"capture/{name}.mkv", 0, pictures))
        people += [mask.reshape(mask.shape[:2]) > 0 for mask in read_frames(truth / f"masks/{name}.mkv", 0, pictures)]
    renders, depths = (take(read_frames(scene / f"render/heldout{kind}.mkv")) for kind in ("", ".depth"))
    return Film([steps[i] for i in chosen], renders, depths, true, people)


def orbit_film(scene: Path, true: Path, pictures: int) -> Film:
    steps, _ = read_path(scene / "render/orbit.json")
    renders, depths, photos = (
        list(read_frames(file, 0, pictures))
        for file in (scene / "render/orbit.mkv", scene / "render/orbit.depth.mkv", true)
    )
    return Film(steps[:pictures], renders, depths, photos, None)


def true_flows(film: Film) -> list[tuple[np.ndarray, np.ndarray] | None]:
    """Backward flow of the true film and where it leads back; None at the start of every segment."""
    flows: list[tuple[np.ndarray, np.ndarray] | None] = []
    for index, step in enumerate(film.steps):
        if index == 0 or film.steps[index - 1].segment != step.segment:
            flows.append(None)
            continue
        now, before = grey_levels(film.truth[index]), grey_levels(film.truth[index - 1])
        backward = dis_flow(now, before, "medium")
        flows.append((backward, consistent(backward, dis_flow(before, now, "medium"))))
    return flows


def warp_levels(pictures: list[np.ndarray], flows: list[tuple[np.ndarray, np.ndarray] | None]) -> float:
    """Root mean square change along the flow, in levels of 255, mean over pictures: what papers call Warp-L2."""
    values = []
    for index, found in enumerate(flows):
        if found is not None:
            _, square = metrics.change_maps(pictures[index], pictures[index - 1], *found)
            values.append(255 * np.sqrt(square[found[1]].mean()))
    return float(np.mean(values))


def quality(pictures: list[np.ndarray], film: Film, flows: list, seen: list[np.ndarray]) -> dict[str, float]:
    """Every figure of one version of a film."""
    rows = []
    for index, (picture, true) in enumerate(zip(pictures, film.truth)):
        errors, similar = metrics.error_map(picture, true), metrics.ssim_map(picture, true)
        row = {"psnr": metrics.psnr_of(errors), "ssim": metrics.ssim(similar)}
        row |= {"psnr_seen": metrics.psnr_of(errors, seen[index]), "ssim_seen": metrics.ssim(similar, seen[index])}
        if film.people is not None:
            people, window = film.people[index].astype(np.uint8), np.ones((7, 7), np.uint8)
            outline = cv2.dilate(people, window) > cv2.erode(people, window)
            row |= {
                "psnr_people": metrics.psnr_of(errors, people > 0),
                "psnr_outlines": metrics.psnr_of(errors, outline),
            }
        rows.append(row)
    means = {name: metrics.mean_of(row[name] for row in rows) for name in rows[0]}
    return {**means, "warp_levels": warp_levels(pictures, flows)}


class Bench:
    """Settings, training footage and the judged strength of one scene."""

    def __init__(self, scene: Path) -> None:
        paper = yaml.safe_load((ROOT / "config/presets/paper.yaml").read_text())["enhance"]
        self.settings: enhance_shot.Settings = loaded(enhance_shot.Settings)
        self.paper: Injection = loaded(enhance_shot.Settings, injection=paper["injection"]).injection
        cameras, capture = read_model(scene / "cameras"), read_manifest(scene / "capture/manifest.json")
        videos = [scene / f"capture/{camera.name}.mkv" for camera in cameras]
        steps, _ = read_path(scene / "render/train.json")
        self.training = training_of(
            cameras, steps, videos, scene / "render/train.mkv", scene / "render/train.depth.mkv", capture.frames
        )
        self.strength, decision = worth(
            self.training, self.settings.judged_frames, self.settings.transfer, ENHANCEMENT.threshold
        )
        self.why = f"{decision.verdict}: {decision.reason}"

    def sources(self, frame: float) -> list[ResidualSource]:
        return self.training.sources(self.training.nearest_frame(frame), self.settings.transfer)

    def residual(self) -> ResidualTransfer:
        return ResidualTransfer(lru_cache(maxsize=1)(self.sources), self.strength, self.settings.transfer)

    def play(self, film: Film, enhancer: Enhancer, injection: Injection) -> list[np.ndarray]:
        def reference(step: PathStep) -> np.ndarray:
            return self.training.reference(step.camera, self.training.nearest_frame(step.frame))

        return list(
            enhanced(
                film.steps, film.raw, film.depth_mm, reference, enhancer, injection, DisFlow(self.settings.flow_preset)
            )
        )

    def measured(self, film: Film) -> dict[str, Any]:
        """Every version of a film."""
        with one_thread():
            flows = true_flows(film)
        transfer, settings = self.settings.transfer, self.settings
        seen = [
            carried_over(s.camera, d.astype(np.float32) / 1000, self.sources(s.frame), transfer)[1] > 0
            for s, d in zip(film.steps, film.depth_mm)
        ]
        off, injection = replace(settings.injection, history=0), for_path(settings.injection, film.steps)
        versions: dict[str, Callable[[], list[np.ndarray]]] = {
            "render": lambda: film.raw,
            "residual": lambda: self.play(film, self.residual(), off),
            "residual, paper's injection": lambda: self.play(film, self.residual(), self.paper),
            "residual, injection": lambda: self.play(film, self.residual(), injection),
        }
        found: dict[str, Any] = {name: quality(make(), film, flows, seen) for name, make in versions.items()}
        for name in ("residual, paper's injection", "residual, injection"):
            found[name]["warp_lower_by"] = 1 - found[name]["warp_levels"] / found["residual"]["warp_levels"]
        found["truth"] = {"warp_levels": warp_levels(film.truth, flows)}
        return found

    def seconds(self, film: Film, wh: tuple[int, int], pictures: int) -> dict[str, float]:
        """Least wall and processor seconds per picture with the default settings, everything resized to ``wh``."""
        count = min(pictures, len(film.raw))
        sized = [cv2.resize(picture, wh, interpolation=cv2.INTER_LINEAR) for picture in film.raw[:count]]
        depths = [cv2.resize(depth, wh, interpolation=cv2.INTER_NEAREST) for depth in film.depth_mm[:count]]
        steps = [replace(step, camera=step.camera.resized(wh)) for step in film.steps[:count]]
        sources = [
            ResidualSource(
                one.camera.resized(wh),
                cv2.resize(one.residual, wh),
                cv2.resize(one.depth_m, wh, interpolation=cv2.INTER_NEAREST),
            )
            for one in self.sources(steps[0].frame)
        ]
        enhancer = ResidualTransfer(lambda frame: sources, self.strength or 1.0, self.settings.transfer)
        wall, worked = [], []
        began, cpu = time.perf_counter(), time.process_time()
        search = DisFlow(self.settings.flow_preset)
        for _ in enhanced(steps, sized, depths, lambda step: sized[0], enhancer, self.settings.injection, search):
            wall.append(time.perf_counter() - began)
            worked.append(time.process_time() - cpu)
            began, cpu = time.perf_counter(), time.process_time()
        # The first pictures have no full history.
        full = slice(self.settings.injection.history + 1, None)
        return {"wall_s": min(wall[full]), "median_wall_s": float(np.median(wall[full])), "cpu_s": min(worked[full])}


def measure(scene: Path, truth: Path, pictures: int, orbit_truth: Path | None) -> None:
    """Measure, print, write."""
    bench = Bench(scene)
    film = heldout_film(scene, truth, pictures)
    result: dict[str, Any] = {
        "machine": {"processor": platform.machine(), "cores": os.cpu_count(), "load_before": os.getloadavg()[0]},
        "strength": {"value": bench.strength, "why": bench.why},
        "seconds": {f"{w}x{h}": {**bench.seconds(film, (w, h), 12), "bar_s": bar} for (w, h), bar in BARS_S.items()},
    }
    for name, times in result["seconds"].items():
        print(
            f"{name}: {times['wall_s']:.2f} s a picture, {times['cpu_s']:.2f} s processor (bar {times['bar_s']} s)",
            flush=True,
        )
    films = {"heldout": film}
    if orbit_truth is not None:
        if not orbit_truth.is_file():
            true_orbit(scene, ROOT / "resources/studio/demo.yaml", orbit_truth)
        films["orbit"] = orbit_film(scene, orbit_truth, 2 * pictures)
    for name, one in films.items():
        result[name] = bench.measured(one)
        print(f"{name}, {len(one.raw)} pictures, residual strength {bench.strength:.2f}")
        for version, figures in result[name].items():
            print(f"  {version:28s}" + "  ".join(f"{key} {value:.4f}" for key, value in figures.items()), flush=True)
    write_json(RESULT, result)
