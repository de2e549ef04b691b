# SPDX-License-Identifier: Apache-2.0
"""``results/<scene>`` as numpy arrays: cameras, the room, people, objects and the films' paths; and renders of it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.deliver.finished import FinishedScene, read_finished
from studiorecon.errors import UserError
from studiorecon.home import RESOURCES
from studiorecon.progress import warn
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.gaussians import concatenate
from studiorecon.scene.people import read_people
from studiorecon.scene.step_files import require
from studiorecon.splatting.device import DRAWN_FROM_M, rasteriser
from studiorecon.splatting.rendering import Rendering
from studiorecon.splatting.rigid_object import RigidObject
from studiorecon.splatting.scene_files import SceneFiles


def load(folder: str | Path, body: str | Path | None = None) -> FinishedScene:
    """The finished scene of ``results/<scene>``.

    ``body`` is the body model of the fit if it is not the bundled one. A person without Gaussians, because training
    failed or has not run, is named in a message and left out. Objects are read if the survey turned them on, and not
    from files of an earlier run.

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
    loose = decisions.is_file() and read_decisions(decisions)["dynamic_objects"].is_on and objects.is_file()
    shots = sorted(path for path in (place / "render").glob("*.json") if path.with_suffix(".mkv").is_file())
    files = SceneFiles(
        background=place / "background" / "scene.ply",
        provenance=place / "background" / "provenance.npz",
        gaussians=[place / "humans" / f"{person}.ply" for person in people],
        avatars=[place / "humans" / f"{person}.npz" for person in people],
        body=Path(body) if body else RESOURCES / "body.npz",
        objects=[objects] if loose else [],
    )
    scene = read_finished(manifest, place / "cameras/images.txt", files, [p for p in shots if p.stem != "train"])
    lengths = {p.person: p.frames for p in scene.people} | {o.person: len(o.centres_m) for o in scene.things}
    for moving, frames in lengths.items():
        words = f"it has {capture.frames} frames, the motion of {moving} {frames}"
        require(manifest, frames == capture.frames, words)
    return scene


def draw(
    scene: FinishedScene,
    camera: Camera,
    frame: float,
    without: Collection[str] = (),
    background_rgb: Sequence[float] = (0.0, 0.0, 0.0),
) -> Rendering:
    """A render of the scene at a 0-based, possibly fractional frame of the capture: colours, alpha and depth.

    It shows the room, all persons and all objects except those named in ``without`` (``p0``, ``o1``, ``room``). Films
    of the workflow also have people's shadows and the plates' light (``render.shot``).

    Raises:
        UserError: the frame is outside of the capture, or a name is unknown.
    """
    moving: dict[str, Avatar | RigidObject] = {one.person: one for one in scene.people}
    moving |= {one.person: one for one in scene.things}
    if unknown := sorted(set(without) - {"room", *moving}):
        raise UserError(f"scene {scene.name} has no {unknown[0]}; it has room, {', '.join(moving) or 'and no people'}")
    if not 0 <= frame <= scene.capture.frames - 1:
        raise UserError(f"scene {scene.name} has frames 0 to {scene.capture.frames - 1}, not {frame:g}")
    shown = [] if "room" in without else [scene.room]
    shown += [one.posed(frame) for name, one in moving.items() if name not in without]
    return rasteriser("cpu", near_m=DRAWN_FROM_M).forward(concatenate(shown), camera, background_rgb)


def _people(place: Path, scene: str) -> list[str]:
    """The people with Gaussians; the others are named in a message."""
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
