# SPDX-License-Identifier: Apache-2.0
"""``deliver.scene_glb``: writes the 4D scene as one binary glTF (three.js, PlayCanvas, Babylon.js, Blender).

The room and objects are points with ``KHR_gaussian_splatting`` (ratified by Khronos), which programs without that
extension show as coloured points. People are skinned meshes in the colours of their Gaussians; the training cameras are
glTF cameras. y up, metres. The Gaussians keep their own axes below nodes that rotate them, so harmonics need no
rotation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.deliver.body_colours import body_colours
from studiorecon.deliver.finished import FinishedScene, read_finished
from studiorecon.deliver.gltf import (
    Buffer,
    add_body,
    add_colours,
    continuous_quaternions,
    motion_channels,
    write_document,
)
from studiorecon.deliver.motion_files import Y_UP_FROM_Z_UP
from studiorecon.geometry import rotations
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import SH_C0, Gaussians
from studiorecon.signature import Written
from studiorecon.splatting.rigid_object import RigidObject
from studiorecon.splatting.scene_files import SceneFiles

if TYPE_CHECKING:
    from jaxtyping import Integer

SPLATS, NAMES = "KHR_gaussian_splatting", "KHR_gaussian_splatting:"
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


def add_splats(buffer: Buffer, own: Gaussians, provenance: Integer[np.ndarray, " N"]) -> dict[str, Any]:
    """A primitive of N Gaussians: linear scales, opacities in 0..1, quaternions (x, y, z, w), harmonics as trained.

    The harmonics give display-referred sRGB; ``COLOR_0``, linear, is for programs that draw points.
    """
    opacities = own.opacities
    values = {
        "POSITION": own.means_m,
        f"{NAMES}ROTATION": np.ascontiguousarray(own.unit_quaternions[:, [1, 2, 3, 0]], np.float32),
        f"{NAMES}SCALE": np.exp(own.log_scales),
        f"{NAMES}OPACITY": opacities[:, None],
    }
    for degree in range(own.sh_degree + 1):
        for k in range(2 * degree + 1):
            values[f"{NAMES}SH_DEGREE_{degree}_COEF_{k}"] = own.sh[:, degree**2 + k]
    attributes = {name: buffer.add(array, "vertices") for name, array in values.items()}
    attributes |= add_colours(buffer, 0.5 + SH_C0 * own.sh[:, 0], provenance, opacities)
    looks = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    # glTF's mode of primitives that are points.
    return {"attributes": attributes, "mode": 0, "material": 0, "extensions": {SPLATS: looks}}


def camera_node(camera: Camera) -> tuple[dict[str, Any], dict[str, Any]]:
    """A glTF camera and its node; principal point, focal lengths and size are in ``extras``, in pixels."""
    (width, height), (_, fy) = camera.wh, camera.focal_px
    shown = {"yfov": 2 * float(np.arctan(height / (2 * fy))), "aspectRatio": width / height, "znear": 0.05}
    described = {"wh": list(camera.wh), "focal_px": list(camera.focal_px), "principal_px": list(camera.principal_px)}
    turned = rotations.to_quaternion(Y_UP_FROM_Z_UP @ camera.world_from_camera[:3, :3] @ _OPENGL_FROM_OPENCV)
    place = Y_UP_FROM_Z_UP @ camera.centre_m
    made = {"name": camera.name, "type": "perspective", "perspective": shown, "extras": described}
    return made, {"name": camera.name, "rotation": turned[[1, 2, 3, 0]].tolist(), "translation": place.tolist()}


def thing_motion(buffer: Buffer, thing: RigidObject, fps: float, node: int) -> dict[str, Any] | None:
    """An object's position and rotation in frames in which they are known, for interpolation; None if never."""
    known = np.flatnonzero(thing.present)
    if not len(known):
        return None
    poses = np.stack([thing.pose_at(float(frame)) for frame in known])
    times = buffer.add((known / fps).astype(np.float32)[:, None])
    turns = continuous_quaternions(rotations.to_quaternion(Y_UP_FROM_Z_UP @ poses[:, :3, :3]))[:, [1, 2, 3, 0]]
    places = (poses[:, :3, 3] @ Y_UP_FROM_Z_UP.T).astype(np.float32)
    outputs = {
        "translation": buffer.add(places),
        "rotation": buffer.add(turns.astype(np.float32)),
    }
    return {
        "samplers": [{"input": times, "output": output, "interpolation": "LINEAR"} for output in outputs.values()],
        "channels": [{"sampler": k, "target": {"node": node, "path": what}} for k, what in enumerate(outputs)],
    }


@dataclass
class _Parts:
    """What the document lists; all motion goes into one animation."""

    buffer: Buffer
    nodes: list[dict[str, Any]] = field(default_factory=list)
    roots: list[int] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)
    skins: list[dict[str, Any]] = field(default_factory=list)
    cameras: list[dict[str, Any]] = field(default_factory=list)
    samplers: list[dict[str, Any]] = field(default_factory=list)
    channels: list[dict[str, Any]] = field(default_factory=list)

    def add_root(self, node: dict[str, Any]) -> None:
        self.roots.append(len(self.nodes))
        self.nodes.append(node)

    def add_mesh(self, name: str, primitive: dict[str, Any]) -> int:
        self.meshes.append({"name": name, "primitives": [primitive]})
        return len(self.meshes) - 1

    def add_motion(self, motion: dict[str, Any]) -> None:
        self.channels += [c | {"sampler": c["sampler"] + len(self.samplers)} for c in motion["channels"]]
        self.samplers += motion["samplers"]

    def add_person(self, person: Avatar) -> None:
        first = len(self.nodes)
        primitive, skeleton, bind = add_body(self.buffer, person.model, person.betas, body_colours(person))
        for joint in skeleton:
            below = {"children": [first + k for k in joint["children"]]} if "children" in joint else {}
            self.nodes.append(joint | below)
        self.roots.append(first)
        mesh = self.add_mesh(person.person, primitive | {"material": 0})
        self.add_root({"name": person.person, "mesh": mesh, "skin": len(self.skins)})
        joints = [first + j for j in range(len(skeleton))]
        self.skins.append({"inverseBindMatrices": bind, "joints": joints, "skeleton": first})
        self.add_motion(motion_channels(self.buffer, person, person.poses, first))

    def add_thing(self, thing: RigidObject, fps: float) -> None:
        motion = thing_motion(self.buffer, thing, fps, len(self.nodes))
        if motion is None or not thing.gaussians.count:
            say(f"scene.glb: {thing.person} has no known position and is left out")
            return
        self.add_motion(motion)
        mesh = self.add_mesh(thing.person, add_splats(self.buffer, thing.gaussians, thing.provenance))
        self.add_root({"name": thing.person, "mesh": mesh})


def build_document(scene: FinishedScene, buffer: Buffer) -> dict[str, Any]:
    """The glTF document of a scene, with its numbers in ``buffer``; one animation, ``capture``, moves everything."""
    parts = _Parts(buffer)
    if scene.room.count:
        upright = rotations.to_quaternion(Y_UP_FROM_Z_UP)[[1, 2, 3, 0]].tolist()
        mesh = parts.add_mesh("room", add_splats(buffer, scene.room, scene.provenance))
        parts.add_root({"name": "room", "mesh": mesh, "rotation": upright})
    for person in scene.people:
        parts.add_person(person)
    for thing in scene.things:
        parts.add_thing(thing, scene.capture.fps)
    for camera in scene.cameras:
        made, node = camera_node(camera)
        parts.add_root(node | {"camera": len(parts.cameras)})
        parts.cameras.append(made)
    held = {"meshes": parts.meshes, "skins": parts.skins, "cameras": parts.cameras}
    if parts.channels:
        held["animations"] = [{"name": "capture", "samplers": parts.samplers, "channels": parts.channels}]
    unlit = "KHR_materials_unlit"
    material = {
        "name": "as filmed",
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
        "extensions": {unlit: {}},
    }
    about = {"_PROVENANCE": "0 measured, 1 inferred, 2 invented"}
    return {
        "asset": {"version": "2.0", "generator": "studiorecon", "extras": about},
        "extensionsUsed": [unlit, *([SPLATS] if any("mode" in m["primitives"][0] for m in parts.meshes) else [])],
        "scene": 0,
        "scenes": [{"name": scene.name, "nodes": parts.roots}],
        "nodes": parts.nodes,
        "materials": [material],
    } | {name: several for name, several in held.items() if several}


def run(
    manifest: Path,
    model: Path,
    files: SceneFiles,
    glb: Written,
) -> None:
    """Write the finished scene as ``glb``."""
    finished = read_finished(manifest, model, files)
    buffer = Buffer()
    write_document(glb, build_document(finished, buffer), buffer)
    say(
        f"scene.glb: {finished.contents}, {glb.stat().st_size / 1e6:.1f} MB; "
        f"opens in three.js, PlayCanvas and Blender: {glb}"
    )
