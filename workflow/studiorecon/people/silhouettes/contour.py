# SPDX-License-Identifier: Apache-2.0
"""One frame's body from silhouettes: contours of body and pictures are matched both ways, the body moves onto them, and
again.

Analysis by synthesis with a closed-form step: a residual is the distance, along the outline's normal, between a point
of the body's outline and its match (Levenberg-Marquardt on rotations, pelvis and shape, with the pose prior of
``body/fitting/prior.py``). On a real take with plates and four cameras joints came within 50 mm; from fewer than three
cameras it is not determined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import scipy

from studiorecon.body.fitting import prior
from studiorecon.body.fitting.basis import Basis, State
from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.images.silhouette import mesh_depth
from studiorecon.people.silhouettes.foreground import FOREGROUND, UNKNOWN
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Weight of an outline's direction in the matching, pixels per unit normal; least agreement of two normals (cosine).
_NORMAL_PX, _SAME_WAY = 12.0, 0.4
# Points of the body's outline further than this from any of its vertices are occlusions or numerical dust, pixels.
_ATTACHED_PX = 4.0
_LONGEST_TURN, _WORST_BETA = 0.5, 3.0


@dataclass(frozen=True)
class ContourSettings:
    """How outlines pull.

    Attributes:
        sigma_px: deviation of an outline, in pixels of the compared pictures; further than three times this pulls with
            constant force.
        points: independent measurements that one outline counts for.
        reach_px: largest distance of a match in the first and in the last step.
        pose_weight, beta_weight: pull of the pose prior and of the mean shape.
        motion_rad_s, motion_m_s: how fast joints turn, and the pelvis moves beside its hull, typically.
    """

    sigma_px: float = 2.0
    points: float = 100.0
    reach_px: tuple[float, float] = (40.0, 4.0)
    pose_weight: float = 1.0
    beta_weight: float = 4.0
    motion_rad_s: float = 9.0
    motion_m_s: float = 1.8


@dataclass(frozen=True)
class Before:
    """The neighbouring frame: its ``state``, with the pelvis moved as the hull moved since, and how long ago it was."""

    state: State
    elapsed_s: float


@dataclass(frozen=True)
class Outline:
    """Points (N, 2) of a contour and their outward normals (N, 2), in pixels."""

    points: Float[np.ndarray, "N 2"]
    normals: Float[np.ndarray, "N 2"]

    @property
    def features(self) -> Float[np.ndarray, "N 4"]:
        return np.concatenate([self.points, _NORMAL_PX * self.normals], axis=1)


def outline(region: Bool[np.ndarray, "H W"], silent: Bool[np.ndarray, "H W"]) -> Outline:
    """The outline of ``region`` (H, W) bool, without what lies at the picture's border or beside ``silent`` (H, W)
    pixels."""
    height, width = region.shape
    points, normals = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for contour in cv2.findContours(region.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)[0]:
        p = contour[:, 0].astype(np.float64)
        if len(p) < 20:
            continue
        along = np.roll(p, -4, 0) - np.roll(p, 4, 0)
        across = np.stack([along[:, 1], -along[:, 0]], axis=1)
        points.append(((p + np.roll(p, 1, 0) + np.roll(p, -1, 0)) / 3)[::2])
        normals.append((across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9))[::2])
    p, n = np.concatenate(points), np.concatenate(normals)
    quiet = cv2.dilate(silent.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    inside = (p > 3).all(1) & (p < [width - 4, height - 4]).all(1)
    p, n = p[inside], n[inside]
    heard = ~quiet[p[:, 1].astype(int), p[:, 0].astype(int)]
    p, n = p[heard], n[heard]
    ahead = np.clip(np.round(p + 3 * n).astype(int), 0, [width - 1, height - 1])
    n[region[ahead[:, 1], ahead[:, 0]]] *= -1
    return Outline(p + 0.5, n)


@dataclass(frozen=True)
class Targets:
    """Silhouettes of one frame: per camera the labels (H, W) and the foreground's outline."""

    labels: tuple[Integer[np.ndarray, "H W"], ...]
    outlines: tuple[Outline, ...]

    @staticmethod
    def of(labels: Sequence[Integer[np.ndarray, "H W"]]) -> Targets:
        return Targets(tuple(labels), tuple(outline(m == FOREGROUND, m == UNKNOWN) for m in labels))


class Silhouette:
    """The body's coarse surface as a function of pose and shape, and how it looks from the cameras."""

    def __init__(self, body: BodyModel, cameras: Sequence[Camera], settings: ContourSettings) -> None:
        self.body, self.cameras, self.settings = body, list(cameras), settings
        chosen = body.proxy_vertices
        share = body.weights[chosen].astype(np.float64)
        surface = np.concatenate([body.template_m[..., None], body.shape_directions], axis=-1)[chosen]
        ancestors = np.eye(24)
        for j, parent in enumerate(body.parents):
            if parent >= 0:
                ancestors[:, j] += ancestors[:, parent]
        self.basis = Basis(body, share, share[:, :, None, None] * surface[:, None], ancestors, False)
        self.precision = prior.precision() * settings.pose_weight

    def joints(self, state: State) -> Float[np.ndarray, "24 3"]:
        """(24, 3) joints in the world, metres."""
        return self.basis.placed(state)[2][0] + state.trans[0]

    def regions(self, state: State) -> list[Bool[np.ndarray, "H W"]]:
        """(H, W) bool per camera: where the body is seen."""
        points = self.basis.points(state)[0]
        return [mesh_depth(points, self.body.proxy_faces, c) > 0 for c in self.cameras]

    def agreement(self, state: State, targets: Targets) -> float:
        """Mean over the cameras of intersection over union, unknown pixels left out; 0 when no camera shows anybody."""
        shares = []
        for region, label in zip(self.regions(state), targets.labels):
            known, there = label != UNKNOWN, label == FOREGROUND
            union = int(((region | there) & known).sum())
            # A camera that sees almost nothing but unknown pixels has no say.
            if union > 0.2 * max(int(region.sum()), 1):
                shares.append(int((region & there).sum()) / union)
        return float(np.mean(shares)) if shares else 0.0

    def strain(self, state: State) -> float:
        """What the pose prior says against a state, nats."""
        return float(0.5 * (self.precision * prior.bend(state.local)[0] ** 2).sum())

    def refine(
        self,
        state: State,
        targets: Targets,
        steps: int,
        *,
        free: str,
        reach_px: tuple[float, float],
        before: Before | None = None,
    ) -> State:
        """The state after ``steps`` steps; ``free``: "root", "pose" or "shape" (pose and shape). ``before``: the
        neighbouring frame."""
        trees = [scipy.spatial.cKDTree(o.features) if len(o.points) else None for o in targets.outlines]
        for step in range(steps):
            reach = reach_px[0] * (reach_px[1] / reach_px[0]) ** (step / max(1, steps - 1))
            state = self._step(state, targets, trees, reach, free, before)
        return state

    def _step(
        self, state: State, targets: Targets, trees: list, reach_px: float, free: str, before: Before | None
    ) -> State:
        linear = self.basis.linear(state)
        shapes = self.body.shapes
        size = 75 + shapes
        matrix, side = np.zeros((size, size)), np.zeros(size)
        for camera, label, target, tree in zip(self.cameras, targets.labels, targets.outlines, trees):
            if tree is None:
                continue
            vertex, normal, residual = self._matches(linear.points[0], camera, label, target, tree, reach_px)
            if not len(vertex):
                continue
            in_camera = linear.points[0, vertex] @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
            a = normal * np.array(camera.focal_px) / in_camera[:, 2:]
            row = (
                np.column_stack([a, -(a * in_camera[:, :2]).sum(1) / in_camera[:, 2]])
                @ camera.camera_from_world[:3, :3]
            )
            jacobian = np.empty((len(vertex), size))
            jacobian[:, :72] = np.cross(linear.turned[0, vertex], row[:, None]).reshape(-1, 72)
            jacobian[:, 72:75] = row
            jacobian[:, 75:] = np.einsum("nx,nxb->nb", row, linear.shaped[0, vertex][..., :shapes])
            units = np.abs(residual) / self.settings.sigma_px
            weight = (
                np.where(units < 3, 1.0, 3 / np.maximum(units, 3))
                * self.settings.points
                / len(vertex)
                / self.settings.sigma_px**2
            )
            matrix += (jacobian * weight[:, None]).T @ jacobian
            side += (jacobian * weight[:, None]).T @ residual
        self._add_priors(state, linear.world[0], matrix, side, before)
        chosen = {"root": [0, 1, 2, 72, 73, 74], "pose": list(range(75)), "shape": list(range(size))}[free]
        damped = matrix[np.ix_(chosen, chosen)]
        damped += np.diag(0.01 * damped.diagonal() + 1e-3)
        change = np.zeros(size)
        change[chosen] = -np.linalg.solve(damped, side[chosen])
        turn = np.einsum("jyx,jy->jx", linear.world[0], change[:72].reshape(24, 3))
        length = np.linalg.norm(turn, axis=1, keepdims=True)
        turn *= np.minimum(1.0, _LONGEST_TURN / np.maximum(length, 1e-9))
        moved = state.moved(turn[None], change[None, 72:75], np.append(change[75:], 0.0))
        return State(moved.local, moved.trans, np.clip(moved.betas, -_WORST_BETA, _WORST_BETA), 0.0, moved.corrections)

    def _matches(
        self,
        points_m: np.ndarray,
        camera: Camera,
        label: np.ndarray,
        target: Outline,
        tree: scipy.spatial.cKDTree,
        reach_px: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices (N,), normals (N, 2) and signed distances (N,) in pixels of all matches of one camera, both ways."""
        own = outline(mesh_depth(points_m, self.body.proxy_faces, camera) > 0, label == UNKNOWN)
        if len(own.points) < 10:
            return np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)
        pixels = camera.project(points_m)[0]
        near, vertex = scipy.spatial.cKDTree(np.nan_to_num(pixels, nan=-1e6)).query(own.points)
        attached = near < _ATTACHED_PX
        own, vertex = Outline(own.points[attached], own.normals[attached]), vertex[attached]
        if len(vertex) < 5:
            return np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)
        there = tree.query(own.features)[1]
        back = scipy.spatial.cKDTree(own.features).query(target.features)[1]
        mine = np.concatenate([np.arange(len(vertex)), back])
        theirs = np.concatenate([there, np.arange(len(back))])
        apart = own.points[mine] - target.points[theirs]
        normals = target.normals[theirs]
        kept = (np.linalg.norm(apart, axis=1) < reach_px) & ((normals * own.normals[mine]).sum(1) > _SAME_WAY)
        return vertex[mine[kept]], normals[kept], (apart * normals).sum(1)[kept]

    def _add_priors(
        self, state: State, world: np.ndarray, matrix: np.ndarray, side: np.ndarray, before: Before | None
    ) -> None:
        bends, precisions = [prior.bend(state.local)[0]], [self.precision]
        if before is not None:
            bends.append(rotations.log(np.swapaxes(before.state.local[0], -1, -2) @ state.local[0]))
            precisions.append(np.full((24, 3), (self.settings.motion_rad_s * before.elapsed_s) ** -2.0))
            still = (self.settings.motion_m_s * before.elapsed_s) ** -2.0
            matrix[range(72, 75), range(72, 75)] += still
            side[72:75] += still * (state.trans[0] - before.state.trans[0])
        for bend, precision in zip(bends, precisions):
            rows = prior.bend_derivative(bend[None])[0] @ np.swapaxes(world, -1, -2)
            weighted = np.swapaxes(rows, -1, -2) * precision[:, None, :]
            block = weighted @ rows
            for j in range(24):
                matrix[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += block[j]
            side[:72] += (weighted @ bend[..., None]).reshape(72)
        shapes = range(75, len(side))
        matrix[shapes, shapes] += self.settings.beta_weight
        side[75:] += self.settings.beta_weight * state.betas
