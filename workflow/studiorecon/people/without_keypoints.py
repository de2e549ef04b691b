# SPDX-License-Identifier: Apache-2.0
"""``people.without_keypoints``: people who stand out from clean plates beside those with keypoints.

A detector may miss somebody whom several cameras see against plates that the user brought. Whoever has keypoints is
already fitted: what those bodies cover is theirs, and the rest is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.people.fit_settings import Hulled
from studiorecon.people.silhouettes.foreground import open_view
from studiorecon.people.silhouettes.silhouette_people import find_standing, write_standing
from studiorecon.progress import say, warn
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import add_people, read_detections, read_people
from studiorecon.signature import Written


@dataclass(frozen=True)
class Settings(Hulled):
    """How people without keypoints are found."""


def run(
    settings: Settings,
    model: Path,
    manifest: Path,
    associated: Path,
    fits: list[Path],
    videos: list[Path],
    plates: list[Path],
    body: Path,
    people: Written,
    silhouettes: Written,
    detections: list[Path] | None = None,
) -> None:
    """Write ``people``: the table ``associated`` of those with keypoints, and below them who has none.

    ``fits`` are the bodies of the former. ``videos`` and ``plates`` are those of the cameras whose clean plates the
    user brought. The folder ``silhouettes`` has <person>.npz for everybody without keypoints: where the
    cameras show them, and where their fit starts. What the detector saw of anybody in ``detections`` says which way
    they face.
    """
    cameras = {camera.name: camera for camera in read_model(model.parent)}
    footage, body_model = read_manifest(manifest), BodyModel.load(body)
    known = [read_person(path) for path in fits]
    views = [
        open_view(cameras[video.stem], video, plate, settings.hull.foreground)
        for video, plate in zip(videos, plates, strict=True)
    ]
    seen = [read_detections(path) for path in detections or []]
    sizes = [cameras[d.camera].wh for d in seen]
    found = find_standing(views, known, body_model, footage.frames, footage.fps, settings.hull, seen, sizes)
    add_people(
        associated, people, [(p.name, len(p.frames), ",".join(p.seen_by), p.start.agreement, "hull") for p in found]
    )
    # Also where nobody is.
    silhouettes.mkdir(parents=True, exist_ok=True)
    for person in found:
        write_standing(silhouettes / f"{person.name}.npz", [person])
    if not found:
        say("nobody without keypoints stands out from the given plates")
    if not read_people(people):
        warn(
            f"nobody was found in any camera: {footage.frames} frames each of {', '.join(v.stem for v in videos)} were "
            "looked at; if somebody is there, bring keypoints of another detector; write people: 0 "
            "into capture.yaml if the room is empty"
        )
