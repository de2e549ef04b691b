# SPDX-License-Identifier: Apache-2.0
"""Writes a person as a binary glTF 2.0 (``.glb``): skinned mesh, skeleton and animation.

glTF is y up, metres, (x, y, z, w) quaternions, little endian; everything is in one file. The specification allows four
bones per vertex in one attribute set, so the four largest weights of each vertex are kept and renormalised.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel
from studiorecon.deliver.body_colours import BodyColours
from studiorecon.deliver.motion_files import Y_UP_FROM_Z_UP
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.scene.files import atomic_path
from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# glTF's numbers of component types and of what a view is bound as, and its names by components per element.
_COMPONENT_TYPES = {"float32": 5126, "uint8": 5121, "uint16": 5123, "uint32": 5125}
_TARGETS = {"vertices": 34962, "indices": 34963, "": None}
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
# Joints that move a vertex: glTF has room for four at once.
BONES = 4
_MAX_BYTES = 2**32 - 1  # lengths in a GLB are 32 bits


class Buffer:
    """The binary chunk, and the views and accessors into it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Num[np.ndarray, "N C"], bound_as: Literal["vertices", "indices", ""] = "") -> int:
        """Index of a new accessor over ``values``, with minima and maxima, which positions and times require."""
        raw = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)}
        self.views.append(view | ({"target": target} if (target := _TARGETS[bound_as]) else {}))
        self.data += raw + b"\0" * (-len(raw) % 4)
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENT_TYPES[values.dtype.name],
            "count": len(values),
            "type": _KINDS[values.shape[1]],
        }
        if values.dtype == np.float32 and values.shape[1] in (1, 3):
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def strongest_bones(weights: Float[np.ndarray, "V J"]) -> tuple[Integer[np.ndarray, "V 4"], Float[np.ndarray, "V 4"]]:
    """Uint8 joints and float32 weights with sum 1; joints of zero weight are 0, as the specification requires."""
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :BONES]
    kept = np.take_along_axis(weights, joints, axis=1).astype(np.float64)
    kept /= kept.sum(axis=1, keepdims=True)
    return np.where(kept > 0, joints, 0).astype(np.uint8), kept.astype(np.float32)


def vertex_normals(vertices_m: Float[np.ndarray, "V 3"], faces: Integer[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Float32 unit normals, faces weighted by area; straight up where a vertex has no face."""
    corners = vertices_m[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices_m)
    for corner in range(3):
        np.add.at(total, faces[:, corner], across)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), [0.0, 1.0, 0.0]).astype(np.float32)


def srgb_to_linear(rgb: Num[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """Displayed colours (sRGB, IEC 61966-2-1) converted to linear light, as glTF requires for vertices."""
    rgb = np.clip(rgb, 0, 1)
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def add_colours(
    buffer: Buffer,
    rgb: Float[np.ndarray, "V 3"],
    provenance: Integer[np.ndarray, " V"],
    opacities: Float[np.ndarray, " V"] | None = None,
) -> dict[str, int]:
    """``COLOR_0`` and ``_PROVENANCE`` of V vertices: rgb as displayed, provenance, opacities in 0..1."""
    colours = np.full((len(rgb), 4), 65535, np.uint16)
    colours[:, :3] = np.rint(srgb_to_linear(rgb) * 65535)
    if opacities is not None:
        colours[:, 3] = np.rint(opacities * 65535)
    held = buffer.add(colours, "vertices")
    buffer.accessors[held]["normalized"] = True
    marks = buffer.add(provenance.astype(np.float32)[:, None], "vertices")
    return {"COLOR_0": held, "_PROVENANCE": marks}


def add_body(
    buffer: Buffer, body: BodyModel, betas: Float[np.ndarray, " B"], colours: BodyColours | None
) -> tuple[dict[str, Any], list[dict[str, Any]], int]:
    """A primitive of the shaped T-pose, the nodes of its joints, and the accessor of inverse bind matrices.

    Children are counted from the first node.
    """
    rest, joints = body.rest_vertices(betas), body.rest_joints(betas)
    bones, weights = strongest_bones(body.weights)
    attributes = {
        "POSITION": buffer.add(rest.astype(np.float32), "vertices"),
        "NORMAL": buffer.add(vertex_normals(rest, body.faces), "vertices"),
        "JOINTS_0": buffer.add(bones, "vertices"),
        "WEIGHTS_0": buffer.add(weights, "vertices"),
    }
    attributes |= add_colours(buffer, colours.rgb, colours.provenance) if colours else {}
    indices = buffer.add(body.faces.reshape(-1, 1).astype(np.uint32), "indices")
    inverse_bind = np.tile(np.eye(4, dtype=np.float32), (len(joints), 1, 1))
    inverse_bind[:, 3, :3] = -joints  # column-major: the translation is the last row here
    bind = buffer.add(inverse_bind.reshape(-1, 16))
    nodes = []
    for j, (name, parent) in enumerate(zip(body.names, body.parents)):
        offset = joints[j] - (joints[parent] if parent >= 0 else 0)
        children = [k for k, p in enumerate(body.parents) if p == j]
        nodes.append({"name": name, "translation": offset.tolist()} | ({"children": children} if children else {}))
    return {"attributes": attributes, "indices": indices}, nodes, bind


def write_glb(path: Path, person: Person, body: BodyModel, colours: BodyColours | None = None) -> None:
    """Write the shaped body in its T-pose, bound to its joints with the person's motion; grey without ``colours``.

    Interpolated frames are included; while the person is away the body has size zero.
    """
    buffer = Buffer()
    body, poses = posed_skeleton(person, body)
    primitive, nodes, bind = add_body(buffer, body, person.betas, colours)
    document = {
        "asset": {"version": "2.0", "generator": "studiorecon"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(nodes)]}],
        "nodes": [*nodes, {"name": person.name, "mesh": 0, "skin": 0}],
        "meshes": [{"name": person.name, "primitives": [primitive | {"material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": [1.0] * 4 if colours else [0.7, 0.7, 0.7, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.9,
                }
            }
        ],
        "skins": [{"inverseBindMatrices": bind, "joints": list(range(len(nodes))), "skeleton": 0}],
        "animations": [{"name": "capture"} | motion_channels(buffer, person, poses)],
    }
    write_document(path, document, buffer)


def write_document(path: Path, document: dict[str, Any], buffer: Buffer) -> None:
    """Write a ``.glb`` of a document and its accessors' bytes; raises UserError beyond the format's limit."""
    held = {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": len(buffer.data)}]}
    text = json.dumps(document | held, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(buffer.data)
    if total > _MAX_BYTES:
        raise UserError(
            f"{path} would have {total / 1e9:.1f} GB, and a GLB file at most {_MAX_BYTES / 1e9:.1f} GB; the PLY files "
            "and deliver/bodies have no such limit, or take fewer frames (frames: {first: 0, count: N} in capture.yaml)"
        )
    with atomic_path(path) as partial, open(partial, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(buffer.data), b"BIN\0") + bytes(buffer.data))


def motion_channels(
    buffer: Buffer, person: Person | Avatar, poses: Float[np.ndarray, "T 3*J"], first: int = 0
) -> dict[str, Any]:
    """Samplers and channels that animate J joints, the nodes from ``first`` on, with a person's motion.

    While a person is away the root is scaled to zero, which the specification names as the way to animate visibility.
    """
    times = buffer.add((np.arange(len(poses)) / person.fps).astype(np.float32).reshape(-1, 1))
    turned = rotations.exp(poses.reshape(len(poses), -1, 3))
    turned[:, 0] = Y_UP_FROM_Z_UP @ turned[:, 0]
    quaternions = continuous_quaternions(rotations.to_quaternion(turned))[..., [1, 2, 3, 0]].astype(np.float32)
    places = (person.trans @ Y_UP_FROM_Z_UP.T).astype(np.float32)
    outputs = [buffer.add(places), *(buffer.add(quaternions[:, j]) for j in range(turned.shape[1]))]
    samplers = [{"input": times, "output": output, "interpolation": "LINEAR"} for output in outputs]
    paths = [(0, "translation"), *((j, "rotation") for j in range(turned.shape[1]))]
    if not person.present.all():
        sizes = np.repeat(person.present.astype(np.float32)[:, None], 3, axis=1)
        samplers.append({"input": times, "output": buffer.add(sizes), "interpolation": "STEP"})
        paths.append((0, "scale"))
    channels = [{"sampler": i, "target": {"node": first + node, "path": what}} for i, (node, what) in enumerate(paths)]
    return {"samplers": samplers, "channels": channels}


def continuous_quaternions(quaternions: Float[np.ndarray, "T ... 4"]) -> Float[np.ndarray, "T ... 4"]:
    """The same rotations with signs that never flip from frame to frame: viewers interpolate components (R03)."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0
    signs = np.cumprod(np.where(flips, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * signs])
