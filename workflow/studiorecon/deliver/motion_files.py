# SPDX-License-Identifier: Apache-2.0
"""Writes a person's motion for other tools: AMASS npz, BVH, TRC, C3D and OpenPose's 3D JSON.

BVH, TRC and glTF viewers have y up, this project has z up: their files hold the world turned by −90 degrees about x,
and say so.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel, shape_and_size
from studiorecon.geometry import rotations
from studiorecon.keypoints.hands import SIDES
from studiorecon.keypoints.layouts import HAND_POINT_NAMES, LAYOUTS
from studiorecon.machine.libraries import install_remedy
from studiorecon.progress import say, warn
from studiorecon.scene.files import atomic_path, write_npz, write_text
from studiorecon.scene.people import Person

if TYPE_CHECKING:
    from jaxtyping import Float

# Rotation from the z-up world to a y-up one: (x, y, z) → (x, z, −y).
Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
# Points of TRC and OpenPose files, in OpenPose's order and under OpenPose's names.
_BODY_25 = LAYOUTS["body_25"].keypoints
_C3D_FRAMES = 65_535
"""Most frames of a C3D file: its header and POINT:FRAMES count with 16 bits. Programs store longer motions in their own
ways, of which ezc3d reads Vicon's only and Mokka none.
"""


def amass(path: Path, person: Person, body: BodyModel) -> list[Path]:
    """Writes ``poses trans betas mocap_framerate gender`` with SMPL's own ``trans``: pelvis = J(betas)₀ + trans.

    A person with fingers has SMPL-H's 52 joints. In the project's own files ``trans`` is the pelvis itself. A person
    with a size in addition to the shape (``people.fit.scale``) has ``scale``: multiply the shaped model by it.
    """
    betas, scale = shape_and_size(person.betas, body.shapes)
    poses = person.poses
    if person.hand_poses is not None:
        # SMPL-H has fingers in the place of the two hand joints.
        poses = np.concatenate([poses[:, :66], person.hand_poses], axis=1)
    arrays = {
        "poses": poses,
        "trans": person.trans - body.rest_joints(person.betas)[0],
        "betas": betas,
        **({} if scale == 1.0 else {"scale": scale}),
        "mocap_framerate": person.fps,
        "gender": "neutral",
        "body": person.body,
        "valid": person.valid,
        "present": person.present,
    }
    write_npz(path, arrays)
    return [path]


def bvh(path: Path, person: Person, body: BodyModel, unit: Literal["m", "cm"] = "m") -> list[Path]:
    """Writes a Biovision hierarchy: the skeleton in its T-pose, then a line of channels per frame; y up, degrees.

    Channels are ``Zrotation Xrotation Yrotation``, applied in that order to column vectors as R = Rz Rx Ry.
    Interpolated frames are included, and so are those in which the person is away, which the format cannot mark: there
    the skeleton moves from the place of leaving to the place of return. A BVH file names no unit: Blender reads metres,
    which every other file here has, Unreal and MotionBuilder read centimetres.
    """
    per_m = {"m": 1.0, "cm": 100.0}[unit]
    body, poses = posed_skeleton(person, body)
    rest = per_m * body.rest_joints(person.betas)
    children: dict[int, list[int]] = {
        j: [k for k, parent in enumerate(body.parents) if parent == j] for j in range(len(rest))
    }
    lines, order = ["HIERARCHY"], []

    def describe(joint: int, depth: int) -> None:
        pad = "\t" * depth
        order.append(joint)
        offset = rest[joint] - rest[body.parents[joint]] if depth else np.zeros(3)
        place = "Xposition Yposition Zposition " if not depth else ""
        lines.extend(
            [
                f"{pad}{'JOINT' if depth else 'ROOT'} {body.names[joint]}",
                pad + "{",
                f"{pad}\tOFFSET {_numbers(offset)}",
            ]
        )
        lines.append(f"{pad}\tCHANNELS {6 if not depth else 3} {place}Zrotation Xrotation Yrotation")
        for child in children[joint]:
            describe(child, depth + 1)
        if not children[joint]:
            # The end of a leaf joint extends its bone by half of its length.
            lines.extend([f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\tOFFSET {_numbers(0.5 * offset)}", pad + "\t}"])
        lines.append(pad + "}")

    describe(0, 0)
    turned = rotations.exp(poses.reshape(len(poses), -1, 3))
    turned[:, 0] = Y_UP_FROM_Z_UP @ turned[:, 0]
    angles = euler_zxy_deg(turned)[:, order].reshape(len(turned), -1)
    places = per_m * person.trans @ Y_UP_FROM_Z_UP.T
    lines += ["MOTION", f"Frames: {len(angles)}", f"Frame Time: {1 / person.fps:.9f}"]
    lines += [f"{_numbers(place)} {_numbers(row)}" for place, row in zip(places, angles)]
    write_text(path, "\n".join(lines) + "\n")
    return [path]


def trc(path: Path, person: Person, body: BodyModel) -> list[Path]:
    """Writes OpenSim's marker file: surface points under OpenPose BODY_25 names, fingers under Pose2Sim's (LIndex1).

    y up, metres, frames from 1. Unmeasured frames are empty, which OpenSim reads as missing.
    """
    markers, points = _markers(person, body)
    points = points @ Y_UP_FROM_Z_UP.T
    # A program that computes time from the rate must be right after hours: 29.97 for 30000/1001 is not enough.
    count, fps = len(markers), f"{person.fps:.10g}"
    names = "\t".join(f"{name}\t\t" for name in map(openpose_name, markers))
    axes = "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, count + 1))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{fps}\t{fps}\t{len(points)}\t{count}\tm\t{fps}\t1\t{len(points)}",
        f"Frame#\tTime\t{names}".rstrip("\t") + "\t\t",
        f"\t\t{axes}",
        "",
    ]
    for frame, (values, measured) in enumerate(zip(points, person.valid)):
        cells = [f"{v:.6f}" for v in values.reshape(-1)] if measured else [""] * (3 * count)
        lines.append("\t".join([str(frame + 1), f"{frame / person.fps:.6f}", *cells]))
    write_text(path, "\n".join(lines) + "\n")
    return [path]


def c3d(path: Path, person: Person, body: BodyModel) -> list[Path]:
    """Writes C3D for biomechanics (Vicon, Qualisys, Visual3D, OpenSim, Mokka): the points of ``trc``, mm, z up.

    An unmeasured frame has NaN points with the residual -1 that marks them; other residuals are 0, because points come
    from pictures. The format counts frames, from 1, with 16 bits: a longer motion becomes several files,
    ``<name>_frames_<first>-<last>.c3d``. Where ezc3d has no wheel a warning says so and no file is written.
    """
    if importlib.util.find_spec("ezc3d") is None:
        warn(f"{person.name}: no C3D file, for ezc3d is missing ({install_remedy('ezc3d')}); .trc has the same markers")
        return []
    frames = len(person.valid)
    if frames <= _C3D_FRAMES:
        _c3d_bytes(path, person, body, slice(0, frames))
        return [path]
    written = []
    for first in range(0, frames, _C3D_FRAMES):
        last = min(first + _C3D_FRAMES, frames)
        written.append(path.with_name(f"{path.stem}_frames_{first + 1}-{last}{path.suffix}"))
        _c3d_bytes(written[-1], person, body, slice(first, last))
    path.unlink(missing_ok=True)
    say(
        f"{person.name}: a C3D file holds at most {_C3D_FRAMES:,} frames, so the {frames:,} frames are in "
        f"{len(written)} files: {', '.join(part.name for part in written)}"
    )
    return written


def _c3d_bytes(path: Path, person: Person, body: BodyModel, frames: slice) -> None:
    import ezc3d  # takes 0.2 s, and only this format needs it

    valid = person.valid[frames]
    markers, points_m = _markers(person, body, frames)
    points = np.ones((4, len(markers), len(points_m)))
    points[:3] = np.moveaxis(1000 * points_m, -1, 0).swapaxes(1, 2)
    points[:3, :, ~valid] = np.nan
    file = ezc3d.c3d()
    file["header"]["points"]["first_frame"] = 0
    file["parameters"]["POINT"]["RATE"]["value"] = [person.fps]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = [openpose_name(name) for name in markers]
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(valid, 0.0, -1.0) * np.ones((1, len(markers), 1))
    with atomic_path(path) as partial:
        file.write(str(partial))
        back = ezc3d.c3d(str(partial))["data"]["points"]
        if back.shape != points.shape:
            raise OSError(f"{path} has {back.shape[2]} frames when read back, {points.shape[2]} were written")


def _markers(person: Person, body: BodyModel, frames: slice = slice(None)) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and world points (T, K, 3) of a person's markers: BODY_25, then 20 of each hand where there are fingers."""
    body, poses = posed_skeleton(person, body)
    hands = [name for side in HAND_POINT_NAMES for name in side[1:]] if person.hand_poses is not None else []
    names = (*_BODY_25, *hands)
    return names, body.keypoints(names, poses[frames], person.betas, person.trans[frames])


def openpose_3d(path: Path, person: Person, body: BodyModel) -> list[Path]:
    """Writes OpenPose's JSON with ``pose_keypoints_3d``: BODY_25, metres, z up, confidence 0 in interpolated frames.

    A person with fingers also has ``hand_left_keypoints_3d`` and ``hand_right_keypoints_3d``, 21 points each. One file
    for the clip: a list with one OpenPose document per frame, empty while the person is away.
    """
    skeleton, poses = posed_skeleton(person, body)
    parts = {"pose": _BODY_25}
    if person.hand_poses is not None:
        parts |= {f"hand_{side}": names for side, names in zip(SIDES, HAND_POINT_NAMES)}
    rows = {}
    for part, names in parts.items():
        points = skeleton.keypoints(names, poses, person.betas, person.trans)
        confident = np.broadcast_to(person.valid[:, None, None].astype(np.float64), (*points.shape[:2], 1))
        whole = np.concatenate([points, confident], axis=2)
        rows[f"{part}_keypoints_3d"] = np.round(whole, 6).reshape(len(points), -1).tolist()
    frames = [
        {
            "version": 1.3,
            "people": [{"person_id": [int(person.name[1:])]} | {k: v[t] for k, v in rows.items()}] if there else [],
        }
        for t, there in enumerate(person.present)
    ]
    write_text(path, json.dumps(frames, separators=(",", ":")) + "\n")
    return [path]


WRITERS: dict[str, Callable[[Path, Person, BodyModel], list[Path]]] = {
    "amass.npz": amass,
    "bvh": bvh,
    "trc": trc,
    "c3d": c3d,
    "openpose3d.json": openpose_3d,
}


def euler_zxy_deg(rotation: Float[np.ndarray, "... 3 3"]) -> Float[np.ndarray, "... 3"]:
    """Angles about z, x, y in degrees with R = Rz Rx Ry, for BVH only (R21); where x is ±90 degrees y is 0."""
    sine = np.clip(rotation[..., 2, 1], -1, 1)
    locked = np.abs(sine) > 1 - 1e-12
    z = np.where(
        locked,
        np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]),
        np.arctan2(-rotation[..., 0, 1], rotation[..., 1, 1]),
    )
    cosine = np.hypot(rotation[..., 0, 1], rotation[..., 1, 1])
    y = np.where(locked, 0.0, np.arctan2(-rotation[..., 2, 0], rotation[..., 2, 2]))
    return np.degrees(np.stack([z, np.arctan2(sine, cosine), y], axis=-1))


def openpose_name(keypoint: str) -> str:
    """``left_big_toe`` → ``LBigToe``, ``mid_hip`` → ``MidHip``."""
    words = keypoint.split("_")
    side = {"left": "L", "right": "R"}.get(words[0])
    return "".join([side or words[0].capitalize(), *(word.capitalize() for word in words[1:])])


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{v:.6f}" for v in values)
