# SPDX-License-Identifier: Apache-2.0
"""``results/<scene>`` as numpy arrays, for people: cameras, the room, people, loose things and the films' paths."""

from __future__ import annotations

from pathlib import Path

from studiorecon.deliver.finished import FinishedScene, read_finished
from studiorecon.errors import UserError
from studiorecon.home import RESOURCES
from studiorecon.progress import warn
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.people import read_people


def load(folder: str | Path, body: str | Path | None = None) -> FinishedScene:
    """The finished scene of ``results/<scene>``.

    ``body`` is the body model that people were fitted with, where that is not the bundled one. Who has no Gaussians,
    since training failed or has not run, is said and left out; things are read where the survey asked for them, not
    where an earlier run left some.

    Raises:
        UserError: there is no finished scene, a file is missing or broken, or the body model is another one.
    """
    place = Path(folder)
    manifest = place / "capture" / "manifest.json"
    if not manifest.is_file():
        raise UserError(
            f"{place} holds no finished scene; give the folder results/<scene>, or make one: uv run snakemake "
            "--cores all"
        )
    capture = read_manifest(manifest)
    people = _people(place, capture.scene)
    decisions, objects = place / "survey" / "decisions.json", place / "objects" / "objects.npz"
    loose = decisions.is_file() and read_decisions(decisions)["dynamic_objects"].called_for and objects.is_file()
    shots = sorted(path for path in (place / "render").glob("*.json") if path.with_suffix(".mkv").is_file())
    scene = read_finished(
        scene=capture.scene,
        manifest=manifest,
        model=place / "cameras" / "images.txt",
        background=place / "background" / "scene.ply",
        provenance=place / "background" / "provenance.npz",
        gaussians=[place / "humans" / f"{person}.ply" for person in people],
        avatars=[place / "humans" / f"{person}.npz" for person in people],
        body=Path(body) if body else RESOURCES / "body.npz",
        objects=[objects] if loose else [],
        paths=[path for path in shots if path.stem != "train"],
    )
    lengths = {p.person: p.frames for p in scene.people} | {o.person: len(o.centres_m) for o in scene.things}
    for moving, frames in lengths.items():
        if frames != capture.frames:
            raise UserError(
                f"the motion of {moving} in scene {capture.scene} has {frames} frames and the capture "
                f"{capture.frames}; run snakemake again"
            )
    return scene


def _people(place: Path, scene: str) -> list[str]:
    """Everybody whose Gaussians are there; the others are said."""
    table, there = place / "people" / "people.tsv", []
    for person in read_people(table) if table.is_file() else []:
        if all((place / "humans" / f"{person}.{ending}").is_file() for ending in ("ply", "npz")):
            there.append(person)
        else:
            warn(
                f"{person} of scene {scene} has no Gaussians (humans/{person}.ply): training failed or has not run, "
                "and the scene is read without this person; run snakemake again"
            )
    return there
