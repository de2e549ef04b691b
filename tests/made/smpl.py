# SPDX-License-Identifier: Apache-2.0
"""A body in SMPL's file format and of SMPL's size, made of the bundled body: for what runs with SMPL alone."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree
from studiorecon.body.model import _SMPL_VERTICES, BodyModel

VERTICES, JOINTS, SHAPES = 6890, 24, 10
_AROUND = 60


def smpl_entries(body: BodyModel) -> dict[str, np.ndarray | sparse.csc_matrix]:
    """The arrays of an SMPL pickle whose shape space and skeleton are those of ``body``.

    Its coarse mesh with points put into the middle of faces until there are 6,890, the points of the face and feet
    where SMPL has them; joints come of the vertices around them; no pose correctives.
    """
    faces = _among(body.proxy_faces, body.proxy_vertices)
    columns = [body.template_m[:, None], np.moveaxis(body.shape_directions[..., :SHAPES], -1, 1)]
    values = np.concatenate(columns, axis=1)[body.proxy_vertices]
    weights = body.weights[body.proxy_vertices].astype(np.float64)
    values, weights, faces = _grown(values, weights, faces)
    order = _landmarks_first(values[:, 0], body)
    values, weights, faces = values[order], weights[order], np.argsort(order)[faces]
    table = np.array([np.where(body.parents < 0, 2**32 - 1, body.parents), np.arange(JOINTS)], dtype=np.int64)
    return {
        "v_template": values[:, 0],
        "shapedirs": np.moveaxis(values[:, 1:], 1, -1),
        "posedirs": np.zeros((VERTICES, 3, 9 * (JOINTS - 1))),
        "J_regressor": sparse.csc_matrix(_regressor(values, body)),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": table,
        "f": faces.astype(np.uint32),
    }


def write_smpl(path: Path, body: BodyModel) -> Path:
    """``smpl_entries`` as SMPL's own pickle."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(smpl_entries(body), protocol=2))
    return path


def _among(faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Faces in indices of the whole mesh as indices into ``vertices``."""
    if faces.max() < len(vertices):
        return faces
    place = np.full(faces.max() + 1, -1)
    place[vertices] = np.arange(len(vertices))
    return place[faces]


def _grown(values: np.ndarray, weights: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A point in the middle of the largest faces, again and again, until there are as many as SMPL has."""
    while (missing := VERTICES - len(values)) > 0:
        corners = values[faces, 0]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        chosen = np.argsort(-area, kind="stable")[: min(missing, len(faces) // 2)]
        middle = len(values) + np.arange(len(chosen))
        a, b, c = faces[chosen].T
        values = np.concatenate([values, values[faces[chosen]].mean(axis=1)])
        weights = np.concatenate([weights, weights[faces[chosen]].mean(axis=1)])
        split = [np.stack(corner, axis=1) for corner in ((a, b, middle), (b, c, middle), (c, a, middle))]
        faces = np.concatenate([np.delete(faces, chosen, axis=0), *split])
    return values, weights, faces


def _landmarks_first(points: np.ndarray, body: BodyModel) -> np.ndarray:
    """An order of the points in which SMPL's numbers of nose, ears, toes and heels are the points nearest to them."""
    wanted = body.keypoints(tuple(_SMPL_VERTICES), np.zeros((1, 72)), np.zeros(body.shapes), np.zeros((1, 3)))[0]
    wanted = wanted + body.joint_template_m[0]
    order, tree = np.arange(len(points)), cKDTree(points)
    for index, place in zip(_SMPL_VERTICES.values(), wanted):
        nearest = int(tree.query(place)[1])
        at = int(np.flatnonzero(order == nearest)[0])
        order[[index, at]] = order[[at, index]]
    return order


def _regressor(values: np.ndarray, body: BodyModel) -> np.ndarray:
    """(24, V) shares of the vertices around a joint that give its place in every shape."""
    made, tree = np.zeros((JOINTS, len(values))), cKDTree(values[:, 0])
    for joint in range(JOINTS):
        near = tree.query(body.joint_template_m[joint], k=_AROUND)[1]
        rows = np.concatenate([values[near].reshape(_AROUND, -1).T, np.ones((1, _AROUND))])
        of_joint = np.column_stack([body.joint_template_m[joint], body.joint_directions[joint, :, :SHAPES]]).T.ravel()
        made[joint, near] = np.linalg.lstsq(rows, np.append(of_joint, 1.0), rcond=None)[0]
    return made
