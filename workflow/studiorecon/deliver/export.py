# SPDX-License-Identifier: Apache-2.0
"""``deliver.export``: writes the result in other tools' formats into one folder, with a manifest of digests."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model, read_points
from studiorecon.configuration.setting import setting
from studiorecon.deliver import camera_files, joint_angles, keypoint_files, motion_files
from studiorecon.deliver.body_colours import BodyColours, body_colours
from studiorecon.deliver.gltf import write_glb
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.files import atomic_path, write_json, write_text
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.people import Person, read_detections, read_identities, split_tracks
from studiorecon.signature import Written
from studiorecon.splatting.scene_files import SceneFiles


@dataclass(frozen=True)
class Settings:
    """Settings of the exports to other programs."""

    pictures: Literal["first", "all", "none"] = setting(
        "first",
        "Undistorted pictures for COLMAP and nerfstudio: first frame; all (about 1 MB per camera "
        "and frame at 960 pixels); or none (these programs cannot load the scene).",
    )
    bvh_unit: Literal["m", "cm"] = setting(
        "m",
        "Unit of deliver/bodies/*.bvh: m for Blender, cm for Unreal and MotionBuilder.",
    )


README = """{scene}: a 4D scene of {people} and a static room, exported by studiorecon.

background.ply    the static room: 3D Gaussians, binary PLY in the layout of the original 3DGS code
{still}{persons}cameras/          training cameras for COLMAP, EasyMocap, nerfstudio, Pose2Sim: undistorted pinholes
{pictures}{keypoints}films/            H.264 films, enhanced: {films}
player.html       the scene to move through, in a browser, without a network
blender.py        opens scene.glb in Blender with the cameras' films behind it: blender --python blender.py
scene.glb         room (KHR_gaussian_splatting), people, things and cameras for three.js, PlayCanvas, Blender; y up
room.glb          only on request (snakemake room_mesh): the room as a coloured mesh, y up, in metres
scene.usdc        only on request (snakemake scene_usd): room, people, things and cameras as a stage for usdview, z up
manifest.json     size and SHA-256 of every other file here, frame rate, and the cameras as blender.py reads them

World: right-handed, metres, z up, floor near z = 0. Camera axes as in OpenCV and COLMAP: x right, y down, z forward;
pixel centres at +0.5 (EasyMocap's and Pose2Sim's files have them at 0, as those tools do; nerfstudio's axes are
OpenGL's). Time is counted from 0, {frames} frames at {fps:g} per second. Gaussians hold log scales, logit opacities
and spherical harmonics; quaternions are (w, x, y, z).

Limits: the Gaussians show what the cameras' pictures support. Surfaces that no camera saw were inferred or
invented (the report shows where), and a PLY cannot say which. The people's PLY files show one frame; their motion is
in bodies/.
"""
# Files that other steps write into the same folder; a file being written has a longer name.
OTHER_STEPS_FILES = ("room.glb", "scene.glb", "scene.usdc", "player.html", "player.jpg")
# Frame of the merged scene of background and people: the first, which every capture has.
_STILL_FRAME = 0
_STILL = "still.ply         the room and everybody in it at frame {frame}, for viewers of static scenes\n"
_KEYPOINTS = (
    "keypoints/        2D keypoints with identities, in pixels of the exported cameras: "
    "OpenPose JSON and EasyMocap annots ({layouts};\n"
    "                  with 21 points of each hand where hands were searched for)\n"
)
_PICTURES = {
    "none": "",
    "first": "                  and the undistorted pictures of frame 0 that COLMAP's and nerfstudio's files name\n",
    "all": "                  and the undistorted pictures of all frames that COLMAP's and nerfstudio's files name\n",
}
_PERSONS = (
    "people/           each person at frame {frame}, or the first one with them, in the world, same layout\n"
    "bodies/           each person's motion; .npz is this project's own (AMASS-style, SMPL's "
    "24-joint order, trans = pelvis, which frames\n"
    "                  were measured and which have the person at all, deviations), .amass.npz has SMPL's trans;\n"
    "                  .bvh (y up, {bvh_unit}; goes on while the person is away), .trc (OpenSim markers, y up,\n"
    "                  metres), .c3d (the same markers, z up, millimetres), .mot (joint angles for OpenSim's "
    "full-body model by\n                  Rajagopal), .angles.tsv (joint angles as a table; degrees, 0 in the "
    "anatomical position: flexion,\n                  then adduction, then internal rotation; left mirrored), "
    ".openpose3d.json (BODY_25, z up) and .glb "
    "(coloured mesh, skeleton\n                  and animation, y up) are for other programs\n"
)
_FINGERS = (
    "                  Fingers ({people}): 30 joints after the 24 in .bvh, .glb, scene.glb and scene.usdc, in SMPL-H's "
    "order in\n                  .npz (hand_*) and .amass.npz (52 joints); 20 markers of each hand in .trc and .c3d; "
    "angles in .angles.tsv\n                  (0 = flat hand); 21 points of each hand in .openpose3d.json. "
    ".mot has none: its model has no fingers\n"
)


def gaussian_files(background: Gaussians, people: Sequence[Avatar], frame: int) -> dict[str, Gaussians]:
    """File name → Gaussians: the room, each person, and the room with all persons present, at one frame.

    A person who is absent at that frame is exported alone, in the first frame of presence.
    """
    posed = {
        f"people/{person.person}.ply": person.posed(frame if person.is_present(frame) else int(person.present.argmax()))
        for person in people
    }
    together = [one for person, one in zip(people, posed.values()) if person.is_present(frame)]
    still = {"still.ply": concatenate([background, *together])} if posed else {}
    return {"background.ply": background, **still, **posed}


def readme_text(
    scene: str,
    people: Sequence[str],
    films: Sequence[str],
    frame: int,
    frames: int,
    fps: float,
    layouts: Sequence[str] = (),
    settings: Settings | None = None,
    fingers: Sequence[str] = (),
) -> str:
    """The text that explains the files; it mentions only those that exist. ``fingers``: people who have some."""
    chosen = settings or Settings()
    unit = {"m": "metres", "cm": "centimetres"}[chosen.bvh_unit]
    return README.format(
        scene=scene,
        pictures=_PICTURES[chosen.pictures],
        people=f"{len(people)} people" if len(people) != 1 else "one person",
        still=_STILL.format(frame=frame) if people else "",
        persons=(_PERSONS.format(frame=frame, bvh_unit=unit) if people else "")
        + (_FINGERS.format(people=", ".join(fingers)) if fingers else ""),
        keypoints=_KEYPOINTS.format(layouts=", ".join(layouts)) if layouts else "",
        films=", ".join(films) if films else "none",
        frames=frames,
        fps=fps,
    )


def digest(path: Path) -> dict[str, int | str]:
    """Size and SHA-256 of a file."""
    with open(path, "rb") as file:
        return {"bytes": path.stat().st_size, "sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def copy_files(copies: Mapping[Path, Path]) -> None:
    """Copy source → target, each completely or not at all."""
    for source, target in copies.items():
        with atomic_path(target) as partial:
            shutil.copyfile(source, partial)


def write_motion(
    folder: Path,
    person: Person,
    body: BodyModel,
    colours: BodyColours | None = None,
    bvh_unit: Literal["m", "cm"] = "m",
) -> list[Path]:
    """One person's motion in every format, ``<folder>/<person>.<ending>``, the mesh grey without ``colours``.

    Raises UserError when the fit is of another body model.
    """
    body.require_same(person.body, person.name)
    written = []
    writers = motion_files.WRITERS | joint_angles.WRITERS | {"bvh": partial(motion_files.bvh, unit=bvh_unit)}
    for ending, write in writers.items():
        written += write(folder / f"{person.name}.{ending}", person, body)
    written.append(folder / f"{person.name}.glb")
    write_glb(written[-1], person, body, colours)
    return written


def run(
    settings: Settings,
    manifest: Path,
    model: Path,
    files: SceneFiles,
    fits: list[Path],
    films: list[Path],
    videos: list[Path],
    detections: list[Path],
    identities: list[Path],
    blender: Path,
    contents: Written,
) -> None:
    """Fill the folder of ``contents`` (its manifest.json), and remove other files of an earlier export."""
    capture, folder = read_manifest(manifest), contents.parent
    cameras, people = read_model(model.parent), files.people()
    written = gaussian_files(read_ply(files.background), people, _STILL_FRAME)
    for name, one in written.items():
        write_ply(folder / name, one)
    frames = list(range(capture.frames)) if settings.pictures == "all" else [None]
    points_m, other = read_points(model.parent), list[Path]()
    for form, write in camera_files.WRITERS.items():
        named = {"frames": frames} if form in camera_files.PICTURES else {}
        other += write(folder / "cameras" / form, cameras, points_m, **named)
    if settings.pictures != "none":
        filmed = {video.stem: video for video in videos}
        other += camera_files.write_pictures(folder / "cameras", filmed, frames)
    known = {k: v for path in identities for k, v in read_identities(path).items()}
    seen, names = [split_tracks(read_detections(path), known) for path in detections], [p.person for p in people]
    by_name = {c.name: c for c in cameras}
    for form, write in keypoint_files.WRITERS.items():
        for d in seen:
            numbers = keypoint_files.track_numbers(d.camera, known, names)
            other += write(folder / "keypoints" / form, d, by_name[d.camera], capture.frames, numbers)
    other += _motions(folder / "bodies", fits, files.body, people, settings)
    copies = {film: folder / "films" / film.name for film in films}
    copies |= {fit: folder / "bodies" / fit.name for fit in fits}
    copies[blender] = folder / blender.name
    copy_files(copies)
    layouts, shots = sorted({d.layout for d in seen}), [film.stem for film in films]
    fingers = [p.person for p in people if p.hand_scale is not None]
    about = _STILL_FRAME, capture.frames, capture.fps, layouts, settings, fingers
    write_text(folder / "README.txt", readme_text(capture.scene, names, shots, *about))
    paths = [*copies.values(), *other]
    delivered = sorted(["README.txt", *written, *(str(path.relative_to(folder)) for path in paths)])
    there = {path: str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    for path, name in there.items():
        if name not in delivered and not name.endswith(OTHER_STEPS_FILES):
            path.unlink()
    described = {"scene": capture.scene, "still_frame": _STILL_FRAME, "fps": capture.fps, "frames": capture.frames}
    listed = {"cameras": [_camera_json(camera) for camera in cameras]}
    write_json(contents, described | listed | {"files": {name: digest(folder / name) for name in delivered}})
    size_mb = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6
    say(f"{len(delivered)} files are in {folder}, {size_mb:.1f} MB")


def _motions(
    folder: Path, fits: Sequence[Path], body: Path | None, people: Sequence[Avatar], settings: Settings
) -> list[Path]:
    """Everybody's motion in every format."""
    if not fits:
        return []
    model, written = BodyModel.load(body), list[Path]()
    colours = {one.person: body_colours(one) for one in people}
    for person in map(read_person, fits):
        if colours.get(person.name) is None:
            say(f"{person.name} has no Gaussians, so bodies/{person.name}.glb is grey")
        written += write_motion(folder, person, model, colours.get(person.name), settings.bvh_unit)
    return written


def _camera_json(camera: Camera) -> dict[str, Any]:
    """A camera as blender.py reads it, with its film."""
    return {
        "name": camera.name,
        "wh": camera.wh,
        "focal_px": camera.focal_px,
        "principal_px": camera.principal_px,
        "film": f"../capture/{camera.name}.mkv",
    }
