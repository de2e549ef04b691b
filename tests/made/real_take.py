# SPDX-License-Identifier: Apache-2.0
"""The front end of the pipeline (capture, cameras, people) on a capture, without the workflow."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from studiorecon.calibration import files as calibration
from studiorecon.cameras import refine
from studiorecon.capture import frames, manifest
from studiorecon.clocks.timeline import clock_as_filmed, common_moments, read_timeline
from studiorecon.configuration import settings as settings_module
from studiorecon.footage.source import open_source
from studiorecon.people import associate, fit
from studiorecon.plan.discovery import open_dataset
from studiorecon.plates import clean as plate
from studiorecon.scene.clocks import write_clocks
from studiorecon.scene.dataset import Dataset
from studiorecon.scene.files import read_json
from studiorecon.scene.people import read_identities, read_people
from studiorecon.tracks import keypoints as detections

from tests.made.imported import imported
from tests.made.recorded import taken_over


def front_end(
    real_data: Path, root: Path, folder: Path, take: str, default_settings: Callable[..., dict[str, Any]]
) -> tuple[list[str], dict[tuple[str, int], str], dict[str, Any]]:
    """People, identities and the refinement's report of ``pose2sim_balancing/<take>``; files under
    ``folder/<take>``."""
    data = open_dataset(real_data / "pose2sim_balancing" / take, root / "tests" / "captures" / f"pose2sim_{take}.yaml")
    return front_end_of(data, root, folder / take, default_settings)


def front_end_of(
    data: Dataset, root: Path, out: Path, default_settings: Callable[..., dict[str, Any]]
) -> tuple[list[str], dict[tuple[str, int], str], dict[str, Any]]:
    """People, identities and the refinement's report of a dataset with plates and keypoints for all cameras; files
    in ``out``."""

    def load(module: Any, **changed: Any) -> Any:
        stage = module.__name__.split(".")[1]
        return settings_module.load(module.Settings, default_settings(stage, **changed), stage)

    lenses, names = out / "calibration.json", list(data.cameras)
    imported(load(calibration), list(data.calibration), names, json.dumps(dict(data.pixel_maps)), lenses)
    for name in names:
        # Filmed in step; no rate is asked of pictures in a folder.
        clock = clock_as_filmed(name, read_timeline(open_source(data.footage[name], 30.0)))
        write_clocks(out / f"{name}.clocks.json", common_moments([clock], 0, 0))
        files = out / f"{name}.mkv", out / f"{name}.json"
        frames.run(load(frames), data.footage[name], lenses, out / f"{name}.clocks.json", name, 0, 0, *files)
    videos = [out / f"{n}.mkv" for n in names]
    manifest.run(out.name, [out / f"{n}.json" for n in names], out / "manifest.json")
    found = [out / f"{n}.npz" for n in names if data.keypoints]
    for name, path in zip(names, found):
        about = data.keypoint_layout, data.keypoint_first_frame.get(name, 0)
        recorded = taken_over(data.keypoints[name], out / f"{name}.recorded.npz", *about)
        detections.run(load(detections), name, recorded, out / f"{name}.json", lenses, path)
    model = out / "model" / "images.txt"
    reports = [out / "refinement.json", out / "refinement.png"]
    plates = [out / "plates" / f"{n}.png" for n in names]
    for name, video, picture in zip(names, videos, plates):
        known = [out / f"{name}.npz"] if data.keypoints else []
        plate.run(load(plate), video, out / f"{name}.json", lenses, known, [data.plates[name]], picture)
    refine.run(
        load(refine), lenses, out / "manifest.json", found, videos, plates, model, out / "heldout/images.txt", *reports
    )
    scene, body = (model, out / "manifest.json"), root / "resources" / "body.npz"
    outputs = [out / "people.tsv", out / "identities.tsv", out / "association.json", out / "who"]
    associate.run(load(associate), *scene, found, videos, [], *outputs)
    for person in read_people(out / "people.tsv"):
        fit.run(load(fit), person, *scene, found, [out / f"who/{person}.tsv"], [], body, out / f"{person}.npz")
    return read_people(out / "people.tsv"), read_identities(out / "identities.tsv"), read_json(out / "refinement.json")
