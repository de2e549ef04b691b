# SPDX-License-Identifier: Apache-2.0
"""All moving solids as painted meshes at any moment: dressed people, the bouncing ball and the held stick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.scene.people import Person
from studiorecon.studio.clothing import OUTFITS, body_texture
from studiorecon.studio.description import Description
from studiorecon.studio.hand_motion import finger_poses
from studiorecon.studio.meshes import Mesh, Texture, lathe, sphere
from studiorecon.studio.performance import PARTS, perform, random_betas

if TYPE_CHECKING:
    from jaxtyping import Float

UNOWNED = 255  # mask value of moving objects that are not people: ball and stick
_BALL_RADIUS_M = 0.12
_STICK_RADIUS_M, _STICK_LENGTH_M = 0.016, 0.9
_LEFT_HAND = 22
_FEET = (7, 8, 10, 11)


@dataclass(frozen=True)
class Actor:
    """One person at all moments of one clock; ``number`` is 0-based, masks hold number + 1; ``texture``: clothes."""

    number: int
    betas: Float[np.ndarray, " 10"]
    poses: Float[np.ndarray, "T 3*J"]
    trans_m: Float[np.ndarray, "T 3"]
    texture: Texture


class Actors:
    """The people and props of a description, posed at the moments (T,) of one clock in seconds."""

    def __init__(self, description: Description, body: BodyModel, times_s: Float[np.ndarray, " T"]) -> None:
        self.body = body.with_fingers if description.hands else body
        self.times_s = times_s
        self.effects = description.effects
        self.fps = description.fps
        self.actors = []
        for number in range(description.people):
            betas = random_betas(description.seed, number)
            poses, trans_m = perform(PARTS[number], body, betas, times_s)
            if description.hands:
                fingers = finger_poses(body, description.seed + number, times_s)
                poses = np.concatenate([poses, fingers], axis=1)
            self.actors.append(Actor(number, betas, poses, trans_m, body_texture(OUTFITS[number], body)))
        # Faces around every vertex, to average their normals: (V, F) sparse.
        self._faces_of_vertices = _incidence(body) if self.actors else None
        self._template_m = body.template_m.astype(np.float32)

    def at(self, frame: int) -> tuple[list[Mesh], list[int]]:
        """All moving solids in one frame and the mask value of each."""
        solids = [self._person(actor, frame) for actor in self.actors]
        values = [actor.number + 1 for actor in self.actors]
        if self.effects.ball:
            solids.append(_ball(float(self.times_s[frame])))
            values.append(UNOWNED)
        if self.effects.stick and self.actors:
            solids.append(self._stick(frame))
            values.append(UNOWNED)
        return solids, values

    def soles_m(self) -> Float[np.ndarray, "T P 4 3"]:
        """Ankles and balls of all people's feet, lowered to the sole: they darken the floor beneath."""
        found = np.zeros((len(self.times_s), len(self.actors), len(_FEET), 3))
        for number, actor in enumerate(self.actors):
            joints = self.body.joints(actor.poses, actor.betas, actor.trans_m)[:, list(_FEET)]
            rest = self.body.rest_joints(actor.betas)[list(_FEET), 1] - self.body.rest_vertices(actor.betas)[:, 1].min()
            found[:, number] = joints - [0, 0, 1] * rest[:, None]
        return found

    def keypoints_m(self, names: tuple[str, ...]) -> Float[np.ndarray, "T P K 3"]:
        """World keypoints of all people."""
        found = [self.body.keypoints(names, actor.poses, actor.betas, actor.trans_m) for actor in self.actors]
        return np.stack(found, axis=1) if found else np.zeros((len(self.times_s), 0, len(names), 3))

    def person(self, actor: Actor) -> Person:
        """The exact body of one person, in the pipeline's own file format."""
        frames, with_fingers = len(self.times_s), len(self.body.names) > 24
        joints = self.body.joints(actor.poses, actor.betas, actor.trans_m)
        return Person(
            name=f"p{actor.number}",
            body=self.body.identity,
            fps=self.fps,
            poses=actor.poses[:, :72],
            trans=actor.trans_m,
            betas=actor.betas,
            joints=joints[:, :24],
            valid=np.ones(frames, dtype=bool),
            sigma=np.zeros((frames, 24)),
            metric=True,
            hand_poses=actor.poses[:, 72:] if with_fingers else None,
            hand_joints=joints[:, 24:] if with_fingers else None,
            hand_sigma=np.zeros((frames, 30)) if with_fingers else None,
            hand_scale=np.ones(2) if with_fingers else None,
        )

    def _person(self, actor: Actor, frame: int) -> Mesh:
        vertices = self.body.vertices(actor.poses[frame : frame + 1], actor.betas, actor.trans_m[frame : frame + 1])[0]
        a, b, c = (vertices[self.body.faces[:, k]] for k in range(3))
        normals = self._faces_of_vertices @ np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return Mesh(
            f"person {actor.number}",
            vertices,
            self.body.faces,
            actor.texture,
            np.eye(4),
            texture_vertices=self._template_m,
            vertex_normals=normals,
        )

    def _stick(self, frame: int) -> Mesh:
        holder = self.actors[0]
        hand = self.body.joint_transforms(
            holder.poses[frame : frame + 1], holder.betas, holder.trans_m[frame : frame + 1]
        )[0, _LEFT_HAND]
        grip = np.eye(4)
        grip[:3, 3] = self.body.rest_joints(holder.betas)[_LEFT_HAND] + [0, -0.02, -0.5 * _STICK_LENGTH_M]
        profile = [(0.0, 0.0), (_STICK_RADIUS_M, 0.0), (_STICK_RADIUS_M, _STICK_LENGTH_M), (0.0, _STICK_LENGTH_M)]
        return lathe("stick", profile, hand @ grip, _band_colours, segments=16)


def _ball(time_s: float) -> Mesh:
    """A ball that bounces in place between the people: free fall between exact bounces."""
    phase = (time_s / 0.82 + 0.3) % 1
    height = _BALL_RADIUS_M + 0.95 * 4 * phase * (1 - phase)
    across = abs((time_s / 3.0 + 0.2) % 2 - 1) * 1.6 - 0.4
    return sphere("ball", _BALL_RADIUS_M, np.array([across, -1.45, height]), _beach_ball)


def _beach_ball(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    sector = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * 6) % 3
    colours = np.array([(0.62, 0.05, 0.04), (0.72, 0.70, 0.62), (0.04, 0.16, 0.46)])
    return colours[sector.astype(int)]


def _band_colours(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return np.where(
        ((points[:, 2] / 0.15) % 1 < 0.3)[:, None], np.array((0.66, 0.10, 0.04)), np.array((0.60, 0.47, 0.25))
    )


def _incidence(body: BodyModel):
    from scipy.sparse import csr_matrix

    count = len(body.faces)
    rows = body.faces.T.ravel()
    return csr_matrix(
        (np.ones(3 * count, dtype=np.float32), (rows, np.tile(np.arange(count), 3))), shape=(body.vertex_count, count)
    )
