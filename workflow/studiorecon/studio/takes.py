# SPDX-License-Identifier: Apache-2.0
"""Films a capture: cameras of one clock see the same people at the same moments, posed for all of them once.

Takes, cameras that are filmed together, are distributed over processes. Each camera traces the empty room once and then
the moving solids.
"""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.footage.exr import write_depth
from studiorecon.footage.streams import Writer, parallel_writers
from studiorecon.footage.video import write_lossless, write_watchable
from studiorecon.images.encoded import write_png
from studiorecon.keypoints.layouts import HAND_POINT_NAMES, LAYOUTS
from studiorecon.scene.camera import Lens
from studiorecon.scene.files import write_json, write_npz
from studiorecon.studio import rig
from studiorecon.studio.actors import Actors
from studiorecon.studio.description import Description
from studiorecon.studio.detections import detect, openpose_json, true_hands
from studiorecon.studio.film import render_frame, touched_pixels, trace_backdrop
from studiorecon.studio.meshes import Mesh
from studiorecon.studio.room import build_room
from studiorecon.studio.sensor import Sensor, camera_sensor, develop
from studiorecon.studio.tracing import Tracer
from studiorecon.studio.truth import TruthFrames

LAYOUT = "body_25"


@dataclass(frozen=True)
class Films:
    """Inputs of one process that films some cameras of one clock."""

    description: Description
    lenses: list[Lens]
    body: Path
    dataset: Path
    truth: Path


def share_takes(description: Description, lenses: Sequence[Lens], processes: int) -> list[list[Lens]]:
    """Lenses in takes of one clock each, no larger than a process's share or memory, the largest first."""
    rays = description.size[0] * description.size[1] * description.supersampling**2
    # Most rays of the cameras whose empty rooms one process stores: each takes 34 bytes.
    most = max(1, min(-(-len(lenses) // processes), 8_000_000 // rays))
    of_clock: dict[float, list[Lens]] = {}
    for lens in lenses:
        of_clock.setdefault(rig.sync_offsets_frames(description)[lens.name], []).append(lens)
    takes = [group[k : k + most] for group in of_clock.values() for k in range(0, len(group), most)]
    return sorted(takes, key=len, reverse=True)


def film_takes(films: Sequence[Films], processes: int) -> Iterator[None]:
    """Film all takes, in parallel with more than one process; yields after every picture."""
    workers = min(processes, len(films))
    if workers <= 1:
        for one in films:
            for _ in _pictures(one):
                yield from (None for _ in one.lenses)
        return
    # Spawned, not forked: the ray caster's and the decoder's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    done = context.Queue()
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_log_progress, initargs=(done,)) as pool:
        yield from _receive(done, [pool.submit(_film, one) for one in films])


def _receive(done: multiprocessing.Queue[int], takes: Sequence[Future[None]]) -> Iterator[None]:
    """Yields for every picture that a process has done, until all have ended; raises their errors."""
    running = set(takes)
    while True:
        ended = {take for take in running if take.done()}
        for take in ended:
            take.result()
        try:
            yield from (None for _ in range(done.get(timeout=0.2)))
        except queue.Empty:
            if not running:
                return
        running -= ended


_done: multiprocessing.Queue[int]


def _log_progress(done: multiprocessing.Queue[int]) -> None:
    global _done
    _done = done


def _film(films: Films) -> None:
    for _ in _pictures(films):
        _done.put(len(films.lenses))


def _pictures(films: Films) -> Iterator[None]:
    """Write all files of these cameras; yields after every moment."""
    described = films.description
    offset = rig.sync_offsets_frames(described)[films.lenses[0].name]
    times_s = (np.arange(described.frames) + offset) / described.fps
    actors = Actors(described, BodyModel.load(films.body), times_s)
    solids = build_room(described.seed, described.effects.glossy_floor)
    cameras = [_Camera(films, lens, actors, solids) for lens in films.lenses]
    with parallel_writers([writer for camera in cameras for writer in camera.writers()]) as put:
        for frame in range(described.frames):
            moving, values = actors.at(frame)
            tracer = Tracer(solids + moving)
            following = None
            if described.truth.flow and frame + 1 < described.frames:
                following = actors.at(frame + 1)[0]
            pictures = [camera.picture(frame, moving, values, tracer, following) for camera in cameras]
            put(*(picture for camera, picture in zip(cameras, pictures) for _ in camera.writers()))
            yield
    for camera in cameras:
        camera.write_rest()


class _Camera:
    """One camera of a take: its empty room, and its results moment by moment."""

    def __init__(self, films: Films, lens: Lens, actors: Actors, solids: list[Mesh]) -> None:
        described = films.description
        self._films, self._lens, self._solids = films, lens, solids
        self._sensor = camera_sensor(described, lens.name)
        self._training = lens.name in described.training
        self._backdrop = trace_backdrop(lens, solids, described.supersampling)
        self._truth = TruthFrames(lens, solids, described.truth)
        self._detector = np.random.default_rng([described.seed, 31, described.names.index(lens.name)])
        names = LAYOUTS[LAYOUT].keypoints
        self._body_points = len(names)
        wanted = (*names, *HAND_POINT_NAMES[0], *HAND_POINT_NAMES[1]) if described.hands else names
        self._keypoints_m, self._soles_m = actors.keypoints_m(wanted), actors.soles_m()
        self._hands: list[np.ndarray] = []
        self._times_s = actors.times_s

    def writers(self) -> list[Writer]:
        """The writers of every picture."""
        described, name = self._films.description, self._lens.name
        video = self._films.dataset / "videos" / f"{name}.mp4"
        found: list[Writer] = [partial(write_watchable, video, fps=described.fps, crf=described.crf)]
        if not self._training:
            # Held-out pictures are the reference: the truth keeps them without the video's losses.
            lossless = self._films.truth / "frames" / f"{name}.mkv"
            found.append(partial(write_lossless, lossless, fps=described.fps))
        return found

    def picture(
        self, frame: int, moving: list[Mesh], values: list[int], tracer: Tracer, following: list[Mesh] | None
    ) -> np.ndarray:
        """(H, W, 3) uint8 of one moment; stores its truth, and writes its keypoints where some are recorded."""
        described, name = self._films.description, self._lens.name
        touched = touched_pixels(self._lens, moving)
        centres = touched_pixels(self._truth.lens, moving) if self._lens.distortion.any() else touched
        self._truth.add(tracer, moving, centres, values, following)
        points_m, first = self._keypoints_m[frame], len(self._solids)
        if described.hands:
            self._hands.append(true_hands(points_m[:, self._body_points :], self._lens, tracer, first))
        if self._training and described.keypoints:
            options = described.detections
            people = detect(points_m, self._lens, tracer, first, options, self._detector, self._body_points)
            path = self._films.dataset / "keypoints" / name / f"{name}_{frame:012d}_keypoints.json"
            write_json(path, openpose_json(people, self._body_points))
        light = lamp_swing(described, float(self._times_s[frame]))
        seen = render_frame(self._backdrop, tracer, moving, touched, self._soles_m[frame], described.effects)
        return develop(light * seen, self._sensor, frame)

    def write_rest(self) -> None:
        """Write the empty room, the dataset's plate of it, and the truth of all moments."""
        described, name, truth = self._films.description, self._lens.name, self._films.truth
        empty, depth_m = self._backdrop.picture(), self._truth.room_depth_m
        write_png(truth / "plates" / f"{name}.png", develop(empty, Sensor.perfect(), 0))
        write_depth(truth / "depth" / f"{name}.exr", depth_m, np.ones_like(depth_m))
        if described.plates and self._training:
            write_png(self._films.dataset / "plates" / f"{name}.png", develop(empty, self._sensor, described.frames))
        if self._hands:
            write_npz(truth / "hands" / f"{name}.npz", {"points": np.stack(self._hands).astype(np.float32)})
        self._truth.write(truth, described.fps)


def lamp_swing(described: Description, time_s: float) -> float:
    """Brightness of the lamps at a moment: one slow swing over the clip around 1."""
    length_s = described.frames / described.fps
    return 1 + described.effects.changing_light * float(np.sin(2 * np.pi * time_s / length_s))
