# SPDX-License-Identifier: Apache-2.0
"""The paper's fit taken literally: L = Σ‖J − Jʷ‖² + Σ‖V − Vʷ‖² + λ_β‖β‖², in metres, per frame, 30 iterations.

"30 iterations" is read as alternation of closed-form parts and linear betas (U38): no first-order method converges in
30 (M03). One iteration turns every joint, root to leaves, by the best rotation of all points below it (Wahba's problem)
and then solves betas and position by ridge regression; both steps lower L exactly. There is no pose prior, no Huber
bound, no correction of the detector's points and one shape per frame (U39). So, unlike ``fitting``, twist and the split
of the spine stay as they started, one outlier bends a frame, and λ_β = 10 in metres pins the shape to the mean (S07).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body.fitting import fit as fitting
from studiorecon.body.fitting.fit import Fit, FitSettings, SurfacePoints
from studiorecon.body.fitting.point_model import FitState, PointModel
from studiorecon.body.fitting.start import initial_pose
from studiorecon.body.model import BodyModel
from studiorecon.body.skinning import forward_kinematics
from studiorecon.geometry import rotations

if TYPE_CHECKING:
    from jaxtyping import Num

# Frames are fitted together as long as the joints' parts of their points fit here (numbers; 320 MB each array).
_AT_ONCE = 40_000_000


@dataclass(frozen=True)
class _Pose:
    local: Num[np.ndarray, "F 24 3 3"]
    trans: Num[np.ndarray, "F 3"]
    betas: Num[np.ndarray, "F B"]


def fit(
    body: BodyModel,
    names: list[str],
    points_m: Num[np.ndarray, "T K 3"],
    sigma_m: Num[np.ndarray, "T K"],
    settings: FitSettings,
    surface: SurfacePoints | None = None,
) -> Fit:
    """The body as from ``fitting.fit``, by ``iterations``, ``tolerance`` and ``beta_weight`` (λ_β) only.

    Of ``sigma_m`` only finite or not is used. Where measured, ``joint_sigma_m`` is the frame's root mean square
    distance to its points per axis; ``turn_sigma_rad`` stays infinite. About 20 ms a frame. Raises ValueError as
    ``fitting.fit`` does.
    """
    fitting.check(names, points_m, sigma_m, settings, surface)
    frames = len(points_m)
    of_frame = 24 * 3 * (points_m.shape[1] + (0 if surface is None else len(surface.vertices)))
    at_once = max(1, _AT_ONCE // of_frame)
    parts = []
    for first in range(0, frames, at_once):
        own = np.arange(frames) // at_once == first // at_once
        parts.append(
            _fit_block(body, names, points_m[own], sigma_m[own], settings, fitting.surface_in_frames(surface, own))
        )
    if len(parts) == 1:
        return parts[0]
    whole: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in fitting.PER_FRAME
    }
    valid = whole["valid"]
    return replace(
        parts[0],
        **whole,
        betas=np.median(whole["frame_betas"][valid], axis=0) if valid.any() else parts[0].betas,
        iterations=max(part.iterations for part in parts),
        converged=all(part.converged for part in parts if part.valid.any()),
    )


def _fit_block(
    body: BodyModel,
    names: list[str],
    points_m: np.ndarray,
    sigma_m: np.ndarray,
    settings: FitSettings,
    surface: SurfacePoints | None,
) -> Fit:
    """The fit of frames that fit into memory at once."""
    frames, count = points_m.shape[:2]
    seen = np.isfinite(points_m).all(-1) & np.isfinite(sigma_m)
    first = initial_pose(body, names, np.where(seen[..., None], points_m, 0.0), seen)
    valid = first.determined
    out = fitting.empty_fit(frames, count, body.shapes, valid)
    if not valid.any():
        return out
    evidence = fitting.merge_points(
        body, names, points_m[valid], sigma_m[valid], settings, fitting.surface_in_frames(surface, valid)
    )
    seen_rows, model = (evidence.precision > 0).astype(np.float64), evidence.model
    pose = _Pose(first.local[valid], first.trans_m[valid], np.zeros((int(valid.sum()), body.shapes)))
    loss, steps, converged = np.inf, 0, False
    while steps < settings.iterations and not converged:
        steps += 1
        pose = _turn_joints(model, pose, evidence.targets_m, seen_rows)
        pose = _fit_shape(model, pose, evidence.targets_m, seen_rows, settings.beta_weight)
        residual = (
            np.linalg.norm(_points(model, pose, _shaped_offsets(model, pose.betas))[0] - evidence.targets_m, axis=-1)
            * seen_rows
        )
        before, loss = loss, float((residual**2).sum() + settings.beta_weight * (pose.betas**2).sum())
        converged = bool(np.isfinite(before) and before - loss < settings.tolerance * before)
    out.rotations[valid], out.trans_m[valid], out.frame_betas[valid] = pose.local, pose.trans, pose.betas
    rest = body.joint_template_m + np.einsum("jxb,fb->fjx", body.joint_directions, pose.betas)
    out.joints_m[valid] = forward_kinematics(pose.local, rest, body.parents)[1] + pose.trans[:, None]
    out.joint_sigma_m[valid] = np.sqrt((residual**2).sum(1) / np.maximum(3 * seen_rows.sum(1), 1))[:, None]
    out.residual_m[valid] = np.where(seen[valid], residual[:, :count], np.nan)
    return replace(out, betas=np.median(pose.betas, axis=0), iterations=steps, converged=converged)


def _shaped_offsets(model: PointModel, betas: np.ndarray) -> np.ndarray:
    """(F, 24, K, 3) the vectors that each joint's rotation turns, for a shape per frame."""
    return model.offsets[..., 0] + np.einsum("jkxb,fb->fjkx", model.offsets[..., 1:], betas, optimize=True)


def _points(model: PointModel, pose: _Pose, offsets: np.ndarray) -> tuple[np.ndarray, ...]:
    """World points (F, K, 3), parts per joint (F, 24, K, 3) and joints (F, 24, 3) about the pelvis, and G."""
    body = model.body
    rest = body.joint_template_m + np.einsum("jxb,fb->fjx", body.joint_directions, pose.betas)
    world, joints = forward_kinematics(pose.local, rest, body.parents)
    parts = offsets @ np.swapaxes(world, -1, -2) + model.share.T[..., None] * joints[:, :, None]
    return parts.sum(1) + pose.trans[:, None], parts, joints, world


def _turn_joints(model: PointModel, pose: _Pose, targets: np.ndarray, seen: np.ndarray) -> _Pose:
    """The pose with every joint turned by the rotation that brings the points below it closest to their targets."""
    local, offsets = pose.local.copy(), _shaped_offsets(model, pose.betas)
    for joint in range(24):
        if not model.subtree_share[:, joint].any():
            continue
        points, parts, joints, world = _points(model, _Pose(local, pose.trans, pose.betas), offsets)
        below = (
            np.tensordot(parts, model.ancestors[joint], ((1,), (0,)))
            - model.subtree_share[:, joint, None] * joints[:, None, joint]
        )
        wanted = targets - (points - below)
        # Weighted by the joint's share in moving a point: 0 for all points above it.
        moment = np.swapaxes(wanted * seen[..., None], 1, 2) @ below
        # Weight of no turn, as a share of the lever arms' sum of squares; it decides only turns that the points do not
        # determine.
        moment += 1e-9 * np.einsum("fk,fkx,fkx->f", seen, below, below)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
        turned = rotations.project_to_so3(moment) @ world[:, joint]
        parent = model.body.parents[joint]
        # Projected again: rounding would double with every joint down the tree and break a long descent (R18).
        local[:, joint] = rotations.project_to_so3(
            np.swapaxes(world[:, parent], -1, -2) @ turned if parent >= 0 else turned
        )
    return replace(pose, local=local)


def _fit_shape(model: PointModel, pose: _Pose, targets: np.ndarray, seen: np.ndarray, beta_weight: float) -> _Pose:
    """The pose with betas and position of every frame from ridge regression, rotations fixed."""
    shapes, corrections = model.body.shapes, np.zeros((model.corrected, 3))
    at_mean = model.linearise(FitState(pose.local, np.zeros_like(pose.trans), np.zeros(shapes), 0.0, corrections))
    frames, count = at_mean.points.shape[:2]
    rows = (
        np.concatenate([at_mean.by_shape[..., :-1], np.broadcast_to(np.eye(3), (frames, count, 3, 3))], axis=-1)
        * seen[..., None, None]
    )
    rows = rows.reshape(frames, 3 * count, -1)
    wanted = ((targets - at_mean.points) * seen[..., None]).reshape(frames, -1, 1)
    ridge = np.append(np.full(shapes, beta_weight), np.zeros(3))
    solved = np.linalg.solve(np.swapaxes(rows, 1, 2) @ rows + np.diag(ridge), np.swapaxes(rows, 1, 2) @ wanted)[..., 0]
    return _Pose(pose.local, solved[:, shapes:], solved[:, :shapes])
