# SPDX-License-Identifier: Apache-2.0
"""Decides which effects this scene calls for, each by a statistic and a threshold, or as the user forces it.

Only effects that are on are simulated later; "undetermined" takes the cheaper branch and says so. Effects that show
only in a trained scene are listed here, and decided by ``report.audit``. Factors that later steps divide out of the
pictures are written by the effects themselves, next to the decisions; the file is empty where the effect is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_plate
from studiorecon.progress import say
from studiorecon.rig.body_points import person_tracks
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.decisions import apply_forced, write_decisions
from studiorecon.scene.files import require_one_each
from studiorecon.scene.people import Detections, read_detections, read_identities, read_people, split_tracks
from studiorecon.scene.room import read_room
from studiorecon.signature import Written
from studiorecon.survey.clips import read_film
from studiorecon.survey.effect_decisions import Settings, decide_effects
from studiorecon.survey.effects import EARLY, EFFECTS
from studiorecon.survey.evidence import Evidence, Recordings, SurveyInput
from studiorecon.survey.exposures import ExposureView

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
    room_box: Path,
    decisions: Written,
    artefacts: list[Written],
) -> None:
    """Write the decisions on all effects; ``people`` and ``identities`` are absent when the room is known to be empty.

    Effects write their own files to the ``artefacts`` of the same name.
    """
    cameras, capture = read_model(model.parent), read_manifest(manifest)
    require_one_each(cameras, videos=videos, plates=plates, depth_maps=depths, files_of_keypoints=detections or cameras)
    names = read_people(people[0]) if people else None
    whose = read_identities(identities[0]) if identities else {}
    found = [split_tracks(read_detections(path), whose) for path in detections]
    views = [ExposureView(c, *read_plate(p, c.wh), read_depth(d, c.wh)[0]) for c, p, d in zip(cameras, plates, depths)]
    own_points: Sequence[Detections | None] = found or [None] * len(cameras)
    films = [
        read_film(
            video,
            camera,
            capture.frames,
            capture.fps,
            own,
            pictures=settings.pictures,
            run=settings.run,
            longest_px=settings.longest_px,
        )
        for video, camera, own in zip(videos, cameras, own_points)
    ]
    followed = person_tracks(found, whose, names or [], capture.frames, settings.min_confidence)
    film_px = [capture.of(c.name).film_px for c in cameras]
    material = SurveyInput(cameras, names, views, films, followed, read_room(room_box).standing_m, capture.fps, film_px)
    by_file = {path.name: path for path in artefacts}
    evidence = Evidence(material, settings)
    early = {d.effect: d for d in decide_effects(evidence, settings.thresholds, settings.force)}
    measured = [early.get(effect.name) or effect.undecided("report/audit.json") for effect in EFFECTS]
    made = {d.effect: d for d in apply_forced(measured, settings.force)}
    recordings = Recordings(videos, found or [None] * len(cameras), capture.frames)
    for decision in made.values():
        say(f"{decision.effect}: {decision.verdict}; {decision.reason}")
    say(f"{len(cameras)} cameras surveyed, {sum(len(f.times) for f in films)} pictures")
    for effect in EARLY:
        if effect.artefact:
            effect.artefact.write(by_file[effect.artefact.file], made[effect.name], evidence, recordings)
    write_decisions(decisions, list(made.values()))
