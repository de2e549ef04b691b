# SPDX-License-Identifier: Apache-2.0
"""Writes a person's joint angles: a table for a spreadsheet, and OpenSim's ``.mot`` with the coordinates of Rajagopal's
full-body model.

Axes are OpenSim's: x forward, y up, z to the person's right. Each limb segment's y axis is its bone, so that all angles
are 0 in the anatomical position: upright, arms hanging, palms forward. A joint turns by flexion about the parent's z,
then adduction about x, then internal rotation about the child's own y (R = Rz Rx Ry), as in ISB's joint coordinate
systems of hip, knee and ankle; the left side is mirrored. Arms use the same order, relative to the thorax, where ISB
has another one for the shoulder: it has its pole where an arm is 90 degrees to the side, which the angles pass
steadily.

The table also has the fingers of a person with fingers: three joints of each from the knuckle on, 0 in the body model's
flat hand. They flex towards the palm, adduct away from the thumb and rotate about their bone. Rajagopal's model has no
fingers.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from studiorecon.body.hands import finger_axes
from studiorecon.body.model import BodyModel
from studiorecon.deliver.motion_files import Y_UP_FROM_Z_UP, euler_zxy_deg
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import FINGER_NAMES, JOINT_NAMES
from studiorecon.scene.files import write_table, write_text
from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Float

# Axes of the body model, x to the left, y up and z forward, as seen in OpenSim's.
_OPENSIM_FROM_BODY = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])


class _Joint(NamedTuple):
    """The body model's joints that make up one, the bones (from, to) of its parent and child segment ("" = the trunk or
    the foot, whose axes are the body's), and OpenSim's coordinates about z, x and y ("" = none)."""

    name: str
    turns: str
    parent: str
    child: str
    coordinates: tuple[str, str, str]


_TRUNK = (
    _Joint("pelvis", "pelvis", "", "", ("pelvis_tilt", "pelvis_list", "pelvis_rotation")),
    _Joint("lumbar", "spine1 spine2 spine3", "", "", ("lumbar_extension", "lumbar_bending", "lumbar_rotation")),
    _Joint("neck", "neck head", "", "", ("", "", "")),
)
_LIMBS = (
    _Joint("hip", "hip", "", "hip knee", ("hip_flexion", "hip_adduction", "hip_rotation")),
    _Joint("knee", "knee", "hip knee", "knee ankle", ("knee_angle", "", "")),
    _Joint("ankle", "ankle", "knee ankle", "", ("ankle_angle", "", "")),
    _Joint("arm", "collar shoulder", "", "shoulder elbow", ("arm_flex", "arm_add", "arm_rot")),
    _Joint("elbow", "elbow", "shoulder elbow", "elbow wrist", ("elbow_flex", "", "pro_sup")),
    _Joint("wrist", "wrist", "elbow wrist", "wrist hand", ("", "", "")),
)


def _of_side(joint: _Joint, side: str) -> _Joint:
    turns, parent, child = (" ".join(f"{side}_{n}" for n in words.split()) for words in joint[1:4])
    ending = f"_{side[0]}"
    coordinates = tuple(name and name + ending for name in joint.coordinates)
    return _Joint(joint.name + ending, turns, parent, child, (coordinates[0], coordinates[1], coordinates[2]))


JOINTS = (*_TRUNK, *(_of_side(joint, side) for side in ("right", "left") for joint in _LIMBS))


def angles_deg(person: Person, body: BodyModel) -> Float[np.ndarray, "T J 3"]:
    """Angles of ``JOINTS`` about z, x and y, mirrored on the left and steady over time, in degrees.

    Positive about z: what is below the joint moves forward (hip and elbow flexion, ankle dorsiflexion), the trunk leans
    back; about x: towards the middle, the trunk to the right; about y: inwards, the trunk to the left. A bent knee is
    positive.
    """
    turned = rotations.exp(person.poses.reshape(-1, 24, 3))
    # Of the pelvis relative to the ground, as of other joints relative to their parents.
    turned[:, 0] = _OPENSIM_FROM_BODY.T @ Y_UP_FROM_Z_UP @ turned[:, 0]
    rest, found = body.rest_joints(person.betas), []
    for joint in JOINTS:
        whole = _from_anatomical(rest, joint.parent).T
        for name in joint.turns.split():
            whole = whole @ turned[:, JOINT_NAMES.index(name)]
        whole = _OPENSIM_FROM_BODY @ whole @ _from_anatomical(rest, joint.child) @ _OPENSIM_FROM_BODY.T
        zxy = euler_zxy_deg(whole)
        if joint.name.startswith("knee"):
            zxy[:, 0] *= -1
        if joint.name.endswith("_l"):
            zxy[:, 1:] *= -1
        found.append(zxy)
    return _steady(np.stack(found, axis=1))


def finger_angles_deg(person: Person, body: BodyModel) -> Float[np.ndarray, "T 30 3"]:
    """Angles of SMPL-H's 30 finger joints as of ``angles_deg``; T x 0 x 3 for a person without fingers."""
    if person.hand_poses is None:
        return np.zeros((len(person.poses), 0, 3))
    twist, spread, flexion = np.moveaxis(np.repeat(finger_axes(body).reshape(10, 3, 3), 3, axis=0), -1, 0)
    axes = np.stack([-spread, twist, flexion], axis=-1)
    turned = rotations.exp(person.hand_poses.reshape(-1, 30, 3))
    return _steady(euler_zxy_deg(np.swapaxes(axes, -1, -2) @ turned @ axes))


def _from_anatomical(rest: Float[np.ndarray, "J 3"], bone: str) -> Float[np.ndarray, "3 3"]:
    """The shortest turn from straight down to a bone at rest, where palms face down; the identity for ""."""
    if not bone:
        return np.eye(3)
    start, end = (rest[JOINT_NAMES.index(name)] for name in bone.split())
    along = (end - start) / np.linalg.norm(end - start)
    axis = np.cross([0.0, -1.0, 0.0], along)
    sine = np.linalg.norm(axis)
    turn = rotations.exp(axis / max(sine, 1e-12) * np.arctan2(sine, -along[1]))
    # Hanging like that, a palm faces the thigh and not forward.
    quarter = {"right_elbow": 1, "right_wrist": 1, "left_elbow": -1, "left_wrist": -1}.get(bone.split()[0], 0)
    return turn @ rotations.exp(np.array([0.0, quarter * np.pi / 2, 0.0]))


def _steady(zxy: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J 3"]:
    """The same rotations, each in the one of its descriptions that is nearest to the frame before."""
    found = zxy.copy()
    # About z and y by half a turn more, the supplement about x is the same rotation.
    other = np.stack([zxy[..., 0] + 180, 180 - zxy[..., 1], zxy[..., 2] + 180], axis=-1)
    for t in range(1, len(zxy)):
        both = np.stack([zxy[t], other[t]])
        both += 360 * np.round((found[t - 1] - both) / 360)
        nearest = np.abs(both - found[t - 1]).sum(-1).argmin(0)
        found[t] = np.take_along_axis(both, nearest[None, :, None], axis=0)[0]
    return found


def table(path: Path, person: Person, body: BodyModel) -> list[Path]:
    """Writes a row per frame and joint, tab-separated: degrees, and whether the frame was measured or interpolated.

    Frames without the person have no rows.
    """
    whole = np.concatenate([angles_deg(person, body), finger_angles_deg(person, body)], axis=1)
    sided = [name.partition("_") for name in FINGER_NAMES] if person.hand_poses is not None else []
    names = [*(joint.name for joint in JOINTS), *(f"{finger}_{side[0]}" for side, _, finger in sided)]
    rows = [
        (t, f"{t / person.fps:.6f}", name, *(f"{angle:.4f}" for angle in angles), int(person.valid[t]))
        for t, every in enumerate(whole)
        if person.present[t]
        for name, angles in zip(names, every, strict=True)
    ]
    columns = ("frame", "time_s", "joint", "flexion_deg", "adduction_deg", "rotation_deg", "measured")
    write_table(path, columns, rows)
    return [path]


def mot(path: Path, person: Person, body: BodyModel) -> list[Path]:
    """Writes OpenSim's motion: a row per frame with the person, seconds, degrees, and the pelvis in metres, y up.

    Interpolated frames are included, which the format cannot mark. The pelvis is the body model's joint, between the
    hips.
    """
    angles, places = angles_deg(person, body), person.trans @ Y_UP_FROM_Z_UP.T
    named = [(j, k, name) for j, joint in enumerate(JOINTS) for k, name in enumerate(joint.coordinates) if name]
    columns = ["time", "pelvis_tx", "pelvis_ty", "pelvis_tz", *(name for _, _, name in named)]
    times = np.flatnonzero(person.present)
    lines = [path.stem, "version=1", f"nRows={len(times)}", f"nColumns={len(columns)}", "inDegrees=yes", "endheader"]
    lines.append("\t".join(columns))
    for t in times:
        values = [t / person.fps, *places[t], *(angles[t, j, k] for j, k, _ in named)]
        lines.append("\t".join(f"{value:.6f}" for value in values))
    write_text(path, "\n".join(lines) + "\n")
    return [path]


WRITERS = {"angles.tsv": table, "mot": mot}
