# SPDX-License-Identifier: Apache-2.0
"""``posing`` and ``temporal`` on tensors that carry gradients, for training a person on a GPU.

No value returns to the host, so that no step waits for the device: loops have a fixed length, and cases are selected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from kornia.geometry.conversions import rotation_matrix_to_quaternion
from kornia.geometry.quaternion import Quaternion

from studiorecon.body.avatar.encoding import BANDS, encode_time
from studiorecon.body.avatar.temporal import SKIP, TemporalNetwork

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float, Integer

# Newton's iterations to a rotation: scaled, a blend of determinant 1e-6 converges in eight.
_POLAR_STEPS = 10
# Determinant below which a blend has no usable polar rotation, as in ``kernels``.
_MIN_DETERMINANT = 1e-6
# Real spherical harmonics of degree 2: constants of 3DGS, as in ``kernels``.
_XY, _ZZ, _XX_YY = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396


class JointTree:
    """Forward kinematics down a tree of joints, all joints of a level at once.

    ``parents`` are in order, the root's is -1.
    """

    def __init__(self, parents: Integer[np.ndarray, " J"], rest_joints_m: Float[torch.Tensor, "J 3"]) -> None:
        order, self._levels, self._rest_m = [0], [], rest_joints_m
        above, own = [0], [0]
        place = rest_joints_m.device
        named = [int(parent) for parent in parents]
        while own := [joint for joint in range(len(named)) if named[joint] in above]:
            within = torch.tensor([above.index(named[joint]) for joint in own], device=place)
            chosen = torch.tensor(own, device=place)
            bones = rest_joints_m[chosen] - rest_joints_m[torch.tensor([named[joint] for joint in own], device=place)]
            self._levels.append((chosen, within, bones))
            order, above = order + own, own
        self._order = torch.tensor([order.index(joint) for joint in range(len(named))], device=place)

    def world_from_rest(
        self, local: Float[torch.Tensor, "J 3 3"], root_m: Float[torch.Tensor, " 3"]
    ) -> Float[torch.Tensor, "J 3 4"]:
        """The joints' transforms of rest points to the world."""
        turns, joints_m = [local[:1]], [root_m[None]]
        for chosen, within, bones in self._levels:
            above = turns[-1][within]
            joints_m.append(joints_m[-1][within] + (above @ bones[..., None])[..., 0])
            turns.append(above @ local[chosen])
        turn, joint_m = torch.cat(turns)[self._order], torch.cat(joints_m)[self._order]
        return torch.cat([turn, (joint_m - (turn @ self._rest_m[..., None])[..., 0])[..., None]], dim=-1)


def pose_gaussians(
    weights: Float[torch.Tensor, "N J"],
    world_from_rest: Float[torch.Tensor, "J 3 4"],
    means_m: Float[torch.Tensor, "N 3"],
    quaternions: Float[torch.Tensor, "N 4"],
    sh: Float[torch.Tensor, "N C 3"],
) -> tuple[Float[torch.Tensor, "N 3"], Float[torch.Tensor, "N 4"], Float[torch.Tensor, "N C 3"]]:
    """Posed means, quaternions and SH; a pose's gradient comes from the means alone, as in ``Posing.wrenches``."""
    blend = (weights @ world_from_rest.flatten(1)).reshape(-1, 3, 4)
    linear = blend[..., :3]
    with torch.no_grad():
        strongest = world_from_rest[weights.argmax(dim=1), :, :3]
        collapsed = ~(_cofactors(linear)[1][:, 0, 0] > _MIN_DETERMINANT)
        turn = polar(torch.where(collapsed[:, None, None], strongest, linear))
        turned = Quaternion(rotation_matrix_to_quaternion(turn))
    posed_m = (linear @ means_m[..., None])[..., 0] + blend[..., 3]
    return posed_m, (turned * Quaternion(quaternions)).data, _turn_sh(turn, sh)


def polar(matrices: Float[torch.Tensor, "... 3 3"], steps: int = _POLAR_STEPS) -> Float[torch.Tensor, "... 3 3"]:
    """The nearest rotations of matrices with a positive determinant, by Newton's iteration (Higham 1986, scaled)."""
    for _ in range(steps):
        cofactors, determinant = _cofactors(matrices)
        scale = determinant.abs().pow(-1 / 3)
        matrices = (scale * matrices + cofactors / (scale * determinant)) / 2
    return matrices


def _cofactors(matrices: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Cofactors (..., 3, 3) and determinants (..., 1, 1)."""
    cofactors = torch.linalg.cross(matrices.roll(-1, -2), matrices.roll(-2, -2), dim=-1)
    return cofactors, (matrices[..., :1, :] * cofactors[..., :1, :]).sum(-1, keepdim=True)


def residuals(
    network: TemporalNetwork,
    flat: Float[torch.Tensor, " P"],
    points_m: Float[torch.Tensor, "M 3"],
    frame: float,
) -> Float[torch.Tensor, "M 4"]:
    """``network`` with the parameters ``flat`` at points, as ``TemporalNetwork.residuals`` without control points."""
    low, high = (points_m.new_tensor(corner, dtype=torch.float64) for corner in (network.low_m, network.high_m))
    half = torch.where(high > low, (high - low) / 2, 0.5)
    at = (points_m.detach().double() - (low + high) / 2) / half
    # Bands first, then sine and cosine, then coordinates, as ``encoding`` has them; float64 keeps rounding out.
    angles = at[:, None] * 2.0 ** torch.arange(BANDS, device=at.device, dtype=torch.float64)[:, None]
    waves = torch.stack([angles.sin(), angles.cos()], dim=2).flatten(1)
    when = encode_time(min(max(frame, 0), network.frames - 1), network.frames, use_all_bands=network.use_all_bands)
    time = torch.as_tensor(when, device=at.device).expand(len(at), -1)
    code = torch.cat([at.float(), waves.float(), time], dim=1)
    code = torch.where(torch.isfinite(code).all(dim=1, keepdim=True), code, 0.0)
    # Views of a tensor as of an array.
    layers: Any = network.matrices(flat)  # type: ignore[arg-type]
    hidden, (*inner, (last, bias)) = code, layers
    for k, (matrix, offset) in enumerate(inner):
        hidden = torch.cat([code, hidden], dim=1) if k == SKIP + 1 else hidden
        hidden = torch.relu(torch.addmm(offset, hidden, matrix))
    return torch.addmm(bias, hidden, last)


def _turn_sh(turn: torch.Tensor, sh: torch.Tensor) -> torch.Tensor:
    """SH up to degree 2, turned: the value along r·d is the given one's along d."""
    parts = [sh[:, :1]]
    if sh.shape[1] > 1:  # degree 1 is a vector
        x, y, z = (turn @ torch.stack([-sh[:, 3], -sh[:, 1], sh[:, 2]], dim=1)).unbind(1)
        parts.append(torch.stack([-y, z, -x], dim=1))
    if sh.shape[1] > 4:  # degree 2 is a symmetric matrix without trace
        xy, yz, xz = _XY * sh[:, 4] / 2, -_XY * sh[:, 5] / 2, -_XY * sh[:, 7] / 2
        zz, apart = 2 * _ZZ * sh[:, 6], _XX_YY * sh[:, 8]
        rows = [[apart - zz / 2, xy, xz], [xy, -apart - zz / 2, yz], [xz, yz, zz]]
        # (N, 3 colours, 3, 3)
        whole = torch.stack([torch.stack(row, -1) for row in rows], -2)
        whole = turn[:, None] @ whole @ turn[:, None].mT
        xx, yy = whole[..., 0, 0], whole[..., 1, 1]
        xy, yz, xz, zz = whole[..., 0, 1], whole[..., 1, 2], whole[..., 0, 2], whole[..., 2, 2]
        back = [2 * xy / _XY, -2 * yz / _XY, zz / (2 * _ZZ), -2 * xz / _XY, (xx - yy) / (2 * _XX_YY)]
        parts.append(torch.stack(back, dim=1))
    return torch.cat(parts, dim=1)
