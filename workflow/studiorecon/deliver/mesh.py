# SPDX-License-Identifier: Apache-2.0
"""``deliver.mesh``: writes the room as one coloured mesh, ``deliver/room.glb``, only on request.

Floor and walls are the fitted room's own planes; the objects between them come from rendered depth
(``deliver.fusion``). y up, metres.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.camera_files.colmap import read_model
from studiorecon.deliver.fusion import FusedSurface, decimate, fuse, remove_vertices, render_views
from studiorecon.deliver.gltf import Buffer, add_colours, vertex_normals, write_document
from studiorecon.deliver.motion_files import Y_UP_FROM_Z_UP
from studiorecon.deliver.room_planes import Plane, build_planes, distance_m, mesh_faces
from studiorecon.progress import say
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.path import read_path
from studiorecon.scene.provenance import INVENTED, MEASURED, read_provenance
from studiorecon.scene.room import FACES, read_room
from studiorecon.signature import Written

VOXEL_M = 0.02
VIEWPOINTS = 48
"""Number of viewpoints on the path between the training cameras, in addition to these."""
TRIANGLES = 60_000
"""Number of triangles of the room's contents: few enough for an engine's collision mesh."""
PLANE_STEP_M, PLANE_VERTICES = 0.05, 40_000
# Surface this near a plane of the mesh is a noisy copy of that plane.
_OF_PLANE_M = 0.06


def write_room(path: Path, surfaces: list[Plane], standing: FusedSurface, left_out: list[str]) -> None:
    """Write one node per plane and one for the contents; ``_PROVENANCE`` is 0 measured or 2 invented."""
    buffer, meshes = Buffer(), []
    parts = [(p.name, p.vertices_m, p.triangles, p.rgb, p.provenance) for p in surfaces]
    if len(standing.triangles):
        nothing_invented = np.full(len(standing.vertices_m), MEASURED, np.uint8)
        parts.append(("standing", standing.vertices_m, standing.triangles, standing.rgb, nothing_invented))
    for name, vertices_m, triangles, rgb, provenance in parts:
        places = (vertices_m @ Y_UP_FROM_Z_UP.T).astype(np.float32)
        attributes = {
            "POSITION": buffer.add(places, "vertices"),
            "NORMAL": buffer.add(vertex_normals(places.astype(np.float64), triangles), "vertices"),
        } | add_colours(buffer, rgb, provenance)
        indices = buffer.add(triangles.astype(np.uint32).reshape(-1, 1), "indices")
        meshes.append({"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]})
    document: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": "studiorecon",
            "extras": {
                "_PROVENANCE": "0 measured, 2 invented (colour of its neighbours)",
                "left out: not in the photos": left_out,
            },
        },
        # The colours are filmed light: a viewer's lamps would light the room twice.
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"name": mesh["name"], "mesh": index} for index, mesh in enumerate(meshes)],
        "meshes": meshes,
        "materials": [
            {
                "name": "as filmed",
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
    }
    write_document(path, document, buffer)


def run(model: Path, background: Path, provenance: Path, room_box: Path, path: Path, mesh: Written) -> None:
    """Write ``mesh`` (GLB) of the room's Gaussians, seen from the cameras of ``model`` and along ``path``."""
    gaussians, box = read_ply(background), read_room(room_box)
    marks = read_provenance(provenance, gaussians.count)
    steps, _ = read_path(path)
    between = [steps[i].camera for i in spread_indices(len(steps), VIEWPOINTS)] if steps else []
    views = render_views(gaussians, marks, [*read_model(model.parent), *between])
    surface = fuse(views, VOXEL_M)
    standing = decimate(remove_vertices(surface, distance_m(box, surface.vertices_m) < _OF_PLANE_M), TRIANGLES)
    flat = build_planes(box, views, PLANE_STEP_M, PLANE_VERTICES)
    left_out = [FACES[index] for index in range(len(FACES)) if index not in mesh_faces(box)]
    write_room(mesh, flat, standing, left_out)
    unseen = sum(int(np.count_nonzero(plane.provenance == INVENTED)) for plane in flat) / max(
        1, sum(len(p.rgb) for p in flat)
    )
    say(
        f"room.glb: {', '.join(p.name for p in flat)} as planes ({100 * unseen:.0f} % unseen and marked) and "
        f"{len(standing.triangles)} triangles of furniture, {mesh.stat().st_size / 1e6:.1f} MB"
    )
    if left_out:
        say(f"room.glb is open where the photos show no wall: {', '.join(left_out)}")
