# SPDX-License-Identifier: Apache-2.0
"""The body model: shape and pose to joints, surface and keypoints, for the bundled body and for a user's SMPL ``.npz``.

Body axes are SMPL's (x to the body's left, y up, z forward); the world is z-up, and ``poses[:, :3]``, the rotation of
the pelvis, carries one into the other. ``trans`` is the world position of the pelvis joint. Betas are coordinates of
one shape space and mean nothing in another: files name the space (``identity``).

Betas may hold one number more than the shape space has: a body whose template and shape directions are s times as large
(the paper's s*, Eq. 4) has the betas (s β, s − 1), see ``of_size``. So everything that a shape does, a size does too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body import skinning
from studiorecon.body.fingers import Fingers, add_fingers
from studiorecon.errors import UserError
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import JOINT_NAMES
from studiorecon.scene.user_files import read_npz, user_file_context

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Vertices of SMPL's own topology (6,890) for points without a joint; limb points are taken at the joints.
_SMPL_VERTICES = {
    "nose": 332, "right_eye": 6260, "left_eye": 2800, "right_ear": 4071, "left_ear": 583, "head_top": 411,
    "left_big_toe": 3216, "left_small_toe": 3226, "left_heel": 3387,
    "right_big_toe": 6617, "right_small_toe": 6624, "right_heel": 6787,
}  # fmt: skip
_SMPL_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class BodyModel:
    """A skinned body with J joints: SMPL's 24, and 30 of the fingers after them where ``with_fingers`` added those.

    Attributes:
        identity: names the model and its shape space; betas are only comparable within one identity.
        parents: −1 for the root.
        faces: outward by the right-hand rule.
        template_m, shape_directions: T-pose, and metres per unit of beta.
        joint_template_m, joint_directions: the same of the joints.
        weights: float32 skinning weights, rows sum to 1.
        pose_directions: pose correctives of an SMPL file, or None.
        keypoint_names: names that ``keypoint_vertices`` and ``keypoint_joints`` regress, see ``layouts``.
        region: uint8 index into ``region_names``, for clothes and colours; all "skin" for an SMPL file.
        proxy_vertices: vertices of a coarse mesh with ``proxy_faces``, for silhouettes.
        fingers: joints that ``with_fingers`` can add, or None.
    """

    identity: str
    names: tuple[str, ...]
    parents: Integer[np.ndarray, " J"]
    faces: Integer[np.ndarray, "F 3"]
    template_m: Float[np.ndarray, "V 3"]
    shape_directions: Num[np.ndarray, "V 3 B"]
    joint_template_m: Num[np.ndarray, "J 3"]
    joint_directions: Num[np.ndarray, "J 3 B"]
    weights: Float[np.ndarray, "V J"]
    pose_directions: Num[np.ndarray, "V 3 207"] | None
    keypoint_names: tuple[str, ...]
    keypoint_vertices: Num[np.ndarray, "K V"]
    keypoint_joints: Num[np.ndarray, "K J"]
    region_names: tuple[str, ...]
    region: Integer[np.ndarray, " V"]
    proxy_vertices: Num[np.ndarray, " P"]
    proxy_faces: Integer[np.ndarray, "Q 3"]
    fingers: Fingers | None = None

    @staticmethod
    def load(path: Path | None) -> BodyModel:
        """The bundled body or an SMPL ``.npz``; raises UserError with one sentence for anything else."""
        if path is None or not path.exists():
            raise UserError(f"body model {path} is missing; resources/body.npz is bundled, or give an SMPL .npz")
        cure = (
            "convert an SMPL .pkl with v_template, shapedirs, J_regressor, weights, kintree_table and f to an .npz of "
            "plain arrays"
        )
        data = read_npz(path, remedy=cure)
        with user_file_context(path, "a body model with the arrays of SMPL's .npz"):
            return _read(data, path)

    def require_same(self, identity: str, owner: str) -> None:
        """Raises UserError unless ``owner``, a file or a person, is of this body model."""
        if identity != self.identity:
            raise UserError(f"{owner} is of the body model {identity}, not {self.identity}; use the same body file")

    @property
    def vertex_count(self) -> int:
        return len(self.template_m)

    @property
    def shapes(self) -> int:
        """Number of shape coordinates."""
        return self.shape_directions.shape[-1]

    def scaled(self, scale: float) -> BodyModel:
        """The body with all lengths times ``scale``; its betas β are the unscaled body's ``of_size(β, scale)`` (paper,
        Eq. 4).
        """
        lengths = ("template_m", "shape_directions", "joint_template_m", "joint_directions", "pose_directions")
        held = {name: getattr(self, name) for name in lengths}
        longer: dict[str, Any] = {name: scale * array for name, array in held.items() if array is not None}
        if (own := self.fingers) is not None:
            longer["fingers"] = replace(own, template_m=scale * own.template_m, directions=scale * own.directions)
        return replace(self, **longer)

    @cached_property
    def with_fingers(self) -> BodyModel:
        """The same body with 54 joints, whose keypoints include ``HAND_POINT_NAMES``; itself where it has no fingers.

        With the fingers' rotations zero its surface is that of 24 joints.
        """
        return self if self.fingers is None else add_fingers(self, self.fingers)

    def rest_vertices(self, betas: Num[np.ndarray, " B"]) -> Num[np.ndarray, "V 3"]:
        """The shaped T-pose, pelvis at its rest position. Raises ValueError for more betas than shape and size."""
        shape, size = _betas(betas, self.shapes)
        return size * self.template_m + self.shape_directions @ shape

    def rest_joints(self, betas: Num[np.ndarray, " B"]) -> Num[np.ndarray, "J 3"]:
        """Joints of the shaped T-pose. Raises ValueError for more betas than shape and size."""
        shape, size = _betas(betas, self.shapes)
        return size * self.joint_template_m + self.joint_directions @ shape

    def joints(
        self, poses: Num[np.ndarray, "T 3*J"], betas: Num[np.ndarray, " B"], trans_m: Num[np.ndarray, "T 3"]
    ) -> Num[np.ndarray, "T J 3"]:
        """World joints, metres; ``trans_m`` is the pelvis. Raises ValueError for other shapes, as the functions
        below."""
        poses, trans_m = self._frames(poses, trans_m)
        local = rotations.exp(poses.reshape(len(poses), -1, 3))
        return skinning.forward_kinematics(local, self.rest_joints(betas), self.parents)[1] + trans_m[:, None]

    def joint_transforms(
        self, poses: Num[np.ndarray, "T 3*J"], betas: Num[np.ndarray, " B"], trans_m: Num[np.ndarray, "T 3"]
    ) -> Num[np.ndarray, "T J 4 4"]:
        """``world_from_rest`` of every joint; rest is the shaped T-pose. Raises as ``joints`` does."""
        poses, trans_m = self._frames(poses, trans_m)
        rest = self.rest_joints(betas)
        world, joints = skinning.forward_kinematics(rotations.exp(poses.reshape(len(poses), -1, 3)), rest, self.parents)
        return skinning.world_from_rest(world, joints + trans_m[:, None], rest)

    def vertices(
        self,
        poses: Num[np.ndarray, "T 3*J"],
        betas: Num[np.ndarray, " B"],
        trans_m: Num[np.ndarray, "T 3"],
        chosen: Integer[np.ndarray, " C"] | None = None,
    ) -> Float[np.ndarray, "T V 3"]:
        """World vertices, float32; only those ``chosen`` (e.g. ``proxy_vertices``) if given. Raises as ``joints``
        does."""
        poses, trans_m = self._frames(poses, trans_m)
        everything = slice(None) if chosen is None else chosen
        rest = self.rest_vertices(betas)[everything]
        if self.pose_directions is not None:
            bend = (rotations.exp(poses.reshape(len(poses), -1, 3)[:, 1:24]) - np.eye(3)).reshape(len(poses), -1)
            rest = rest + _betas(betas, self.shapes)[1] * np.einsum(
                "vxp,tp->tvx", self.pose_directions[everything], bend
            )
        transforms = self.joint_transforms(poses, betas, trans_m)
        return skinning.skin(rest, self.weights[everything], transforms)

    def keypoints(
        self,
        names: Sequence[str],
        poses: Num[np.ndarray, "T 3*J"],
        betas: Num[np.ndarray, " B"],
        trans_m: Num[np.ndarray, "T 3"],
    ) -> Num[np.ndarray, "T K 3"]:
        """World keypoints by name; exact for the surface without pose correctives.

        Raises as ``joints`` does, and KeyError for a name that the body lacks.
        """
        poses, trans_m = self._frames(poses, trans_m)
        share, anchors = self.keypoint_anchors(names)
        shape, size = _betas(betas, self.shapes)
        anchors = anchors @ np.append(size, shape)
        rest = self.rest_joints(betas)
        world, joints = skinning.forward_kinematics(rotations.exp(poses.reshape(len(poses), -1, 3)), rest, self.parents)
        offsets = anchors - share[..., None] * rest
        return np.einsum("tjxy,kjy->tkx", world, offsets) + np.einsum("kj,tjx->tkx", share, joints) + trans_m[:, None]

    def _frames(self, poses: np.ndarray, trans_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses, trans_m = np.asarray(poses, dtype=np.float64), np.asarray(trans_m, dtype=np.float64)
        size = 3 * len(self.parents)
        if poses.ndim != 2 or poses.shape[1] != size or trans_m.shape != (len(poses), 3):
            raise ValueError(f"poses must be (T, {size}) and trans (T, 3), not {poses.shape} and {trans_m.shape}")
        return poses, trans_m

    def keypoint_anchors(self, names: Sequence[str]) -> tuple[Num[np.ndarray, "K J"], Num[np.ndarray, "K J 3 1+B"]]:
        """Shares and anchors that give K keypoints without the mesh. Raises KeyError for a name that the body lacks.

        A linear surface point under skinning is Σ_j G_j (anchor_kj(β) − share_kj J_j(β)) + share_kj J_j^posed, G_j the
        joint's world rotation: the sums over vertices are done once, here.
        """
        rows = [self.keypoint_names.index(n) if n in self.keypoint_names else _missing(n) for n in names]
        vertices, joints = self.keypoint_vertices[rows], self.keypoint_joints[rows]
        share = np.zeros((len(rows), len(self.parents)))
        anchors = np.zeros((*share.shape, 3, 1 + self.shapes))
        skeleton = np.concatenate([self.joint_template_m[..., None], self.joint_directions], axis=-1)
        for k, row in enumerate(vertices):
            used = np.flatnonzero(row)
            carried = row[used, None] * self.weights[used].astype(np.float64)
            surface = np.concatenate([self.template_m[used, :, None], self.shape_directions[used]], axis=-1)
            share[k] = carried.sum(0) + joints[k]
            anchors[k] = np.einsum("vj,vxb->jxb", carried, surface) + joints[k][:, None, None] * skeleton
        return share, anchors

    def vertex_anchors(
        self, vertices: Integer[np.ndarray, " V"]
    ) -> tuple[Num[np.ndarray, "V J"], Num[np.ndarray, "V J 3 1+B"]]:
        """Shares and anchors of surface points; without pose correctives, see ``keypoint_anchors``."""
        share = self.weights[vertices].astype(np.float64)
        share /= share.sum(1, keepdims=True)
        surface = np.concatenate([self.template_m[vertices, :, None], self.shape_directions[vertices]], axis=-1)
        return share, share[:, :, None, None] * surface[:, None]


def upright_global_orientation(heading_rad: float) -> Num[np.ndarray, " 3"]:
    """Axis-angle for ``poses[:, :3]`` of an upright body in the z-up world, facing (cos, sin) of ``heading_rad``."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    # Columns: directions of the body's left (x), up (y) and forward (z) in the world.
    return rotations.log(np.array([[-s, 0.0, c], [c, 0.0, s], [0.0, 1.0, 0.0]]))


def _missing(name: str) -> int:
    raise KeyError(name)


def of_size(betas: Num[np.ndarray, " B"], scale: float) -> Num[np.ndarray, " B+1"]:
    """Betas of the body with ``betas`` and all its lengths times ``scale`` (paper, Eq. 4: s* J(β))."""
    return np.append(scale * np.asarray(betas, dtype=np.float64), scale - 1.0)


def shape_and_size(betas: Num[np.ndarray, " _"], shapes: int) -> tuple[Num[np.ndarray, " B"], float]:
    """Coordinates of the shape space and scale in ``betas``, the inverse of ``of_size``. Raises as ``rest_joints``."""
    shape, size = _betas(betas, shapes)
    return shape / size, size


def _betas(betas: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """Factors of the shape directions and the template; missing betas are 0, surplus ones must be, except the size."""
    given = np.asarray(betas, dtype=np.float64).reshape(-1)
    if np.any(given[count + 1 :] != 0) or (len(given) > count and not given[count] > -1):
        raise ValueError(f"{len(given)} betas for a shape space of {count}")
    size = 1.0 + given[count] if len(given) > count else 1.0
    return np.append(given[:count], np.zeros(max(count - len(given), 0))), float(size)


def _read(data: dict[str, np.ndarray], path: Path) -> BodyModel:
    parents = data["kintree_table"][0].astype(np.int64)
    # SMPL files store the root's parent as 2³² − 1.
    parents[parents > 1000] = -1
    template = data["v_template"].astype(np.float64)
    shapes = data["shapedirs"][..., :10].astype(np.float64)
    if len(parents) != 24 or parents[0] >= 0 or np.any(parents[1:] >= np.arange(1, 24)):
        raise UserError(
            f"body model {path} has {len(parents)} joints; only SMPL's tree of 24 joints, parents first, is supported"
        )
    if "J_template" in data:
        joint_template, joint_directions = data["J_template"].astype(np.float64), data["J_shapedirs"].astype(np.float64)
    else:
        regressor = data["J_regressor"].astype(np.float64)
        joint_template, joint_directions = regressor @ template, np.einsum("jv,vxb->jxb", regressor, shapes)
    if "weight_joints" in data:
        weights = np.zeros((len(template), 24))
        np.put_along_axis(
            weights, data["weight_joints"].astype(np.int64), data["weight_values"].astype(np.float64), axis=1
        )
    else:
        weights = data["weights"].astype(np.float64)
    # Stored weights are rounded: renormalised here, else a sum off by 4e-4 moves a point 5 m away by 2 mm (
    # L07).
    weights = (weights / weights.sum(1, keepdims=True)).astype(np.float32)
    names, on_vertices, on_joints = _keypoints(data, len(template))
    faces = data["f"].astype(np.int64)
    plain = "identity" not in data
    digest = hashlib.sha256(template.tobytes() + shapes.tobytes()).hexdigest()[:8]
    arrays = (template, shapes, joint_template, joint_directions, weights)
    if not all(np.isfinite(a).all() for a in arrays):
        raise UserError(f"body model {path} holds numbers that are not finite")
    return BodyModel(
        identity=f"smpl {digest}" if plain else str(data["identity"]),
        names=JOINT_NAMES,
        parents=parents,
        faces=faces,
        template_m=template,
        shape_directions=shapes,
        joint_template_m=joint_template,
        joint_directions=joint_directions,
        weights=weights,
        pose_directions=data["posedirs"].astype(np.float64) if "posedirs" in data else None,
        keypoint_names=names,
        keypoint_vertices=on_vertices,
        keypoint_joints=on_joints,
        region_names=tuple(str(n) for n in data["region_names"]) if "region" in data else ("skin",),
        region=data["region"] if "region" in data else np.zeros(len(template), dtype=np.uint8),
        proxy_vertices=data["proxy_vertices"].astype(np.int64) if "proxy_faces" in data else np.arange(len(template)),
        proxy_faces=data["proxy_faces"].astype(np.int64) if "proxy_faces" in data else faces,
        fingers=Fingers(
            data["finger_template"].astype(np.float64),
            data["finger_shapedirs"].astype(np.float64),
            data["finger_vertices"].astype(np.int64),
            data["finger_joints"].astype(np.int64),
            data["finger_shares"] / data["finger_shares"].sum(1, keepdims=True, dtype=np.float64),
            data["finger_tips"].astype(np.int64),
        )
        if "finger_template" in data
        else None,
    )


def _keypoints(data: dict[str, np.ndarray], vertex_count: int) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names and regressors, from the file or from SMPL's vertices and joints; every joint is ``<name>_joint``."""
    rows: dict[str, tuple[dict[int, float], dict[int, float]]] = {
        f"{n}_joint": ({}, {j: 1.0}) for j, n in enumerate(JOINT_NAMES)
    }
    if "keypoint_names" in data:
        names = [str(n) for n in data["keypoint_names"]]
        rows |= {n: ({}, {}) for n in names}
        for k, v, value in zip(data["keypoint_rows"], data["keypoint_vertices"], data["keypoint_values"]):
            rows[names[int(k)]][0][int(v)] = float(value)
    elif vertex_count == 6890:
        joint = {n: j for j, n in enumerate(JOINT_NAMES)}
        rows |= {n: ({v: 1.0}, {}) for n, v in _SMPL_VERTICES.items()}
        rows |= {f"{s}_{n}": ({}, {joint[f"{s}_{n}"]: 1.0}) for s in ("left", "right") for n in _SMPL_LIMBS}
        for name, part in (("neck", "shoulder"), ("mid_hip", "hip")):
            rows[name] = ({}, {joint[f"left_{part}"]: 0.5, joint[f"right_{part}"]: 0.5})
        rows["upper_neck"] = ({}, {joint["neck"]: 0.5, joint["head"]: 0.5})
    on_vertices, on_joints = np.zeros((len(rows), vertex_count)), np.zeros((len(rows), 24))
    for k, (vertices, joints) in enumerate(rows.values()):
        on_vertices[k, list(vertices)] = list(vertices.values())
        on_joints[k, list(joints)] = list(joints.values())
    return tuple(rows), on_vertices, on_joints
