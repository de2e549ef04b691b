# SPDX-License-Identifier: Apache-2.0
"""Which effects does this scene call for? Each decision has a statistic, a threshold and a sentence, and can be forced.

Only what a decision is about is simulated later; "undetermined" takes the cheaper branch and says so. What shows only in a trained scene
is listed here, and decided by ``survey.trained``. What later steps divide out of the pictures is written beside the decisions: the
cameras' gains and the light's course, both empty where they are not called for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.exr import read_depth
from studiorecon.images.stills import read_plate
from studiorecon.progress import say
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.decisions import Decision, forced, in_order, switched_on, write_decisions
from studiorecon.scene.factors import write_factors
from studiorecon.scene.files import write_json
from studiorecon.scene.people import read_detections, read_identities, read_people
from studiorecon.scene.shell import read_shell
from studiorecon.survey.bodies import tracks
from studiorecon.survey.course import cost_s, course_of
from studiorecon.survey.effects import Material, Settings, judge
from studiorecon.survey.exposures import View
from studiorecon.survey.films import read_film
from studiorecon.survey.renders import later

__all__ = ["Settings", "run"]


def run(
    settings: Settings,
    manifest: Path,
    model: Path,
    people: list[Path],
    identities: list[Path],
    detections: list[Path],
    videos: list[Path],
    plates: list[Path],
    depths: list[Path],
    shell: Path,
    decisions: Path,
    gains: Path,
    course: Path,
    gloss: Path,
) -> None:
    """Decide from what the earlier stages found; ``people`` and ``identities`` are absent when the room is known to be empty.

    What an earlier run measured to be on is kept in ``.last`` beside ``decisions``, for the hysteresis.
    """
    cameras, capture = read_model(model.parent), read_manifest(manifest)
    if not len(cameras) == len(videos) == len(plates) == len(depths) or len(detections) not in (0, len(cameras)):
        raise Refusal(
            f"{len(cameras)} training cameras, but {len(videos)} videos, {len(plates)} plates, {len(depths)} depth maps and "
            f"{len(detections)} files of keypoints; one of each is needed per camera"
        )
    found = [read_detections(path) for path in detections]
    names = read_people(people[0]) if people else None
    whose = read_identities(identities[0]) if identities else {}
    views = [View(c, *read_plate(p), read_depth(d)[0]) for c, p, d in zip(cameras, plates, depths)]
    films = [
        read_film(
            video, camera, capture.frames, capture.fps, own, pictures=settings.pictures, run=settings.run, longest_px=settings.longest_px
        )
        for video, camera, own in zip(videos, cameras, found or [None] * len(cameras))
    ]  # fmt: skip
    followed = tracks(found, whose, names or [], capture.frames, settings.min_confidence)
    material = Material(cameras, names, views, films, followed, float(read_shell(shell).low_m[2]), capture.fps)
    last = decisions.parent / ".last" / decisions.name
    measured = in_order([*judge(material, settings, switched_on(last)), *later()])
    spared_s = cost_s(cameras, capture.frames)
    made = [
        replace(d, cost_saved_estimate_s=spared_s) if d.effect == "changing_light" and not d.called_for else d
        for d in forced(measured, settings.force)
    ]
    for decision in made:
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    say(f"{len(cameras)} cameras surveyed, {sum(len(f.times) for f in films)} pictures")
    verdicts = {d.effect: d for d in made}
    write_factors(gains, gains_called_for(verdicts["exposure"]))
    changes: dict[str, np.ndarray] = {}
    if verdicts["changing_light"].called_for:
        for video, view, own in zip(videos, views, found or [None] * len(cameras)):
            told = course_of(video, view.camera, capture.frames, own, view, settings.longest_px)
            if told is None:
                say(f"{view.camera.name}: too little of the room is seen without people to follow its light; its frames stay as they are")
            else:
                changes[view.camera.name] = told
    write_factors(course, changes)
    # A file apart, because who waits for the verdict is to run again only when this changes.
    write_json(gloss, {"degree": verdicts["view_dependent_colour"].detail["degree"]})
    write_decisions(last, measured)
    write_decisions(decisions, made)


def gains_called_for(exposure: Decision) -> Mapping[str, np.ndarray]:
    """Camera → (1, 3) gains to divide pictures by; none unless the verdict is on, nor for cameras that could not be compared."""
    if not exposure.called_for:
        return {}
    found = {name: own for name, own in exposure.detail.get("gains", {}).items() if name not in exposure.detail["alone"]}
    if not found:
        say("exposure is forced on, but no two cameras share enough surface to compare their colours: every camera keeps its own")
    return {name: np.array([own]) for name, own in found.items()}
