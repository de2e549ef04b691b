# SPDX-License-Identifier: Apache-2.0
"""How far ``deliver/room.glb`` of the synthetic studio is from the studio's own meshes.

Run ``uv run --extra mesh snakemake --cores all room_mesh``, then
``uv run --group test --extra mesh python -m tests.bench.room_mesh`` (the demo, unless told otherwise).
Accuracy: from points of the mesh to the true surfaces. Completeness: true surfaces of furniture that the mesh has
within 5 cm.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import trimesh
from studiorecon.deliver.fusion import open3d
from studiorecon.studio.description import read_description
from studiorecon.studio.meshes import Mesh
from studiorecon.studio.room import room

SAMPLES = 20_000
NEAR_M = 0.05
_SHELL = ("floor", "ceiling", "wall", "lamp")


def scene_of(meshes: list[tuple[np.ndarray, np.ndarray]]):
    """A ray casting scene of triangle meshes (vertices, faces), for distances."""
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    for vertices, faces in meshes:
        scene.add_triangles(o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    return lambda points: scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()


def z_up(part: trimesh.Trimesh) -> trimesh.Trimesh:
    turned = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return trimesh.Trimesh(part.vertices @ turned.T, part.faces, process=False)


def points_on(part: trimesh.Trimesh, count: int) -> np.ndarray:
    return trimesh.sample.sample_surface(part, count, seed=0)[0]


def furniture(solids: list[Mesh]) -> list[Mesh]:
    return [solid for solid in solids if not any(word in solid.name for word in _SHELL)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mesh", type=Path, default=Path("results/demo/deliver/room.glb"))
    parser.add_argument("--studio", type=Path, default=Path("resources/studio/demo.yaml"))
    given = parser.parse_args()
    described = read_description(given.studio)
    solids = room(described.seed, described.effects.glossy_floor)
    parts = {name: z_up(part) for name, part in trimesh.load_scene(given.mesh, process=False).geometry.items()}
    truth = scene_of([(s.vertices_m, s.faces) for s in solids])
    ours = scene_of([(p.vertices, p.faces) for p in parts.values()])
    result: dict[str, dict[str, float]] = {}
    for name, part in parts.items():
        off_m = truth(points_on(part, SAMPLES))
        result[name] = {
            "median_mm": 1e3 * np.median(off_m),
            "p90_mm": 1e3 * np.percentile(off_m, 90),
            "triangles": len(part.faces),
        }
    for solid in furniture(solids):
        off_m = ours(points_on(trimesh.Trimesh(solid.vertices_m, solid.faces, process=False), 2000))
        result[f"true {solid.name}"] = {"share_within_5_cm": float((off_m < NEAR_M).mean())}
    print(json.dumps({k: {n: round(float(v), 3) for n, v in row.items()} for k, row in result.items()}, indent=1))


if __name__ == "__main__":
    main()
