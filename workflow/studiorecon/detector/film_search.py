# SPDX-License-Identifier: Apache-2.0
"""The search of one camera's film for people, stretch by stretch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from studiorecon.detector.blazepose import LANDMARKS, LAYOUT
from studiorecon.detector.film_detection import FilmDetector
from studiorecon.detector.frame_detection import Detector
from studiorecon.footage.frames import decode
from studiorecon.footage.source import FootageSource
from studiorecon.keypoints.detections import Settings, as_filmed, detections_from_detector
from studiorecon.machine.threads import in_threads
from studiorecon.progress import progress, say, warn
from studiorecon.scene.people import Detections
from studiorecon.scene.raw_detections import RawDetections, unseen

# Moments of people on which calibrations are judged (``rig.starts.FRAMES``), and seconds that a
# keypoint's error lasts: frames within them are one moment.
_ENOUGH, _MOMENT_S = 24, 0.2


@dataclass(frozen=True)
class Search:
    """One camera's film, and who was ``found`` in it so far; ``film`` is None where it cannot be read."""

    film: FilmDetector | None
    found: RawDetections

    @staticmethod
    def of(
        camera: str, footage: FootageSource | None, network: Detector | None, worth: Mapping[str, list[float]]
    ) -> Search:
        """The search of a film before it begins; ``worth`` as of ``FilmDetector``."""
        if footage is None or network is None:
            title = "footage that cannot be read"
            return Search(None, RawDetections.of(camera, LAYOUT, LANDMARKS, [], [], title))
        (width, height), fps = footage.wh, footage.fps
        title = f"{network.placer.title} at {width}×{height}, {fps:g} per second"
        return Search(
            FilmDetector(network, dict(worth), footage, 0), RawDetections.of(camera, LAYOUT, LANDMARKS, [], [], title)
        )

    def oriented(self, parts: Sequence[tuple[int, int]]) -> Search:
        """The same, knowing how people in the stretches ``parts`` (first frame, count) are turned."""
        if self.film is None or self.found.looked:
            return self
        film = self.film.turned(parts)
        return Search(film, replace(self.found, turns=film.turns))

    def left(self, parts: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """What of the stretches ``parts`` was not searched yet, each frame in one of them."""
        if self.film is None:
            return []
        left = list[tuple[int, int]]()
        for part in parts:
            left += unseen([*self.found.looked, *left], *part)
        return left

    def shows_few(self) -> bool:
        """Whether there are too few people yet to judge a calibration on, and they can be searched for."""
        if self.film is None:
            return False
        return len(np.unique(self.found.frame // max(_MOMENT_S * self.film.footage.fps, 1.0))) < _ENOUGH

    def tracked(self) -> Detections:
        """The people as tracks, by frames of the film and in its pixels."""
        assert self.film is not None
        footage = self.film.footage
        return detections_from_detector(self.found, *as_filmed(self.found.camera, footage, footage.frames), Settings())

    def log(self) -> None:
        """Say who was found."""
        found, total = self.found, sum(count for _, count in self.found.looked)
        if found.turns:
            say(
                f"camera {found.camera}: its pictures are turned by {90 * found.turns}° counter-clockwise, so that "
                "people are upright"
            )
        if shown := len(np.unique(found.frame)):
            say(f"camera {found.camera}: {len(found.frame)} detections in {shown} of {total} frames ({found.note})")
        elif self.film is not None:
            frames = self.film.footage.frames
            warn(f"camera {found.camera}: no person was detected in {total} of its {frames} frames ({found.note})")


def search_on(searches: Mapping[str, Search], parts: Mapping[str, Sequence[tuple[int, int]]]) -> dict[str, Search]:
    """The ``searches`` after the stretches ``parts`` of each film (first frame, count) are searched too.

    Stretches of all films are searched side by side, the longest first: films with many people take several times as
    long as the others.
    """
    ready = dict(zip(searches, in_threads(Search.oriented, searches.values(), [parts[c] for c in searches])))
    jobs = sorted(((c, one) for c in ready for one in ready[c].left(parts[c])), key=lambda job: -job[1][1])

    def rows(job: tuple[str, tuple[int, int]]) -> list[tuple]:
        film = ready[job[0]].film
        assert film is not None
        return film.rows(decode(film.footage, *job[1]), job[1][0])

    found = list(progress(in_threads(rows, jobs), "stretches searched for people", len(jobs)))
    for camera, one in ready.items():
        own = [(part, seen) for (c, part), seen in zip(jobs, found) if c == camera]
        looked = [*one.found.looked, *(part for part, _ in own)]
        rows_of = [row for _, seen in sorted(own, key=lambda job: job[0]) for row in seen]
        ready[camera] = replace(one, found=one.found.completed(rows_of, looked))
    return ready
