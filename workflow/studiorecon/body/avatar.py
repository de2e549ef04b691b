# SPDX-License-Identifier: Apache-2.0
"""A person as Gaussians in the body's rest pose, with everything that moves them: ``humans/<person>.{ply,npz}``."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.body.posing import Posing
from studiorecon.body.temporal import TemporalNetwork, with_residuals
from studiorecon.errors import Refusal
from studiorecon.geometry import rotations
from studiorecon.progress import say
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.provenance import MEASURED

_ARRAYS = ("bones", "weights", "provenance", "poses", "trans", "betas", "valid")


@dataclass(frozen=True)
class Avatar:
    """One person's Gaussians and motion.

    Attributes:
        person: ``p0``, ``p1``, …
        model: the body model whose skeleton carries the Gaussians.
        gaussians: N canonical Gaussians in the shaped rest pose, metres, SH degree at most 2.
        bones: (N, K) uint8 joints that carry each Gaussian.
        weights: (N, K) float32 skinning weights, rows sum to 1.
        provenance: (N,) uint8, see ``scene/provenance.py``: measured, or inferred from its surroundings on the body.
        poses: (T, 72) refined axis-angle poses, radians.
        trans: (T, 3) world position of the pelvis joint, metres.
        betas: (10,) shape.
        valid: (T,) bool: frames in which the body was measured.
        fps: frames per second.
        metric: True when lengths are metres.
        network: what colour and opacity of the measured Gaussians add over time; None when nothing.
        decision: the decision on that network as in ``survey/decisions.json``, JSON; "" when nobody asked.
    """

    person: str
    model: BodyModel
    gaussians: Gaussians
    bones: np.ndarray
    weights: np.ndarray
    provenance: np.ndarray
    poses: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    valid: np.ndarray
    fps: float
    metric: bool
    network: TemporalNetwork | None = None
    decision: str = ""

    @property
    def frames(self) -> int:
        return len(self.poses)

    @property
    def seen_share(self) -> float:
        """Share of the Gaussians that a training camera saw."""
        return float((self.provenance == MEASURED).mean()) if len(self.provenance) else 0.0

    def pose_at(self, frame: float) -> tuple[np.ndarray, np.ndarray]:
        """Axis-angle pose (72,) and pelvis position (3,) at a 0-based frame, between frames on the sphere of rotations.

        Frames outside the clip show its first or last pose: a film may hold the end.
        """
        at = float(np.clip(frame, 0, self.frames - 1))
        low = min(int(at), max(self.frames - 2, 0))
        share = at - low
        if share == 0.0 or self.frames == 1:
            return self.poses[low], self.trans[low]
        if share == 1.0:
            return self.poses[low + 1], self.trans[low + 1]
        first, second = (rotations.exp(self.poses[t].reshape(-1, 3)) for t in (low, low + 1))
        return rotations.log(rotations.slerp(first, second, share)).reshape(-1), (1 - share) * self.trans[low] + share * self.trans[low + 1]

    def joints_m(self, frame: float) -> np.ndarray:
        """(24, 3) world joints at a 0-based, possibly fractional frame, metres."""
        pose, trans = self.pose_at(frame)
        return self.model.joints(pose[None], self.betas, trans[None])[0]

    def facing(self) -> np.ndarray:
        """(T, 2) horizontal unit vectors in which the pelvis faces; x where it faces straight up or down."""
        forward = rotations.exp(np.asarray(self.poses[:, :3], np.float64))[:, :2, 2]
        length = np.linalg.norm(forward, axis=1, keepdims=True)
        return np.where(length > 1e-6, forward / np.maximum(length, 1e-6), [1.0, 0.0])

    def posed(self, frame: float) -> Gaussians:
        """The person's Gaussians in the world at a 0-based, possibly fractional frame."""
        pose, trans = self.pose_at(frame)
        transforms = self.model.joint_transforms(pose[None], self.betas, trans[None])[0]
        own = self.gaussians
        measured = self.provenance == MEASURED
        colour, logits = with_residuals(self.network, measured, own.means_m, own.sh[:, :1], own.logit_opacities, frame)
        sh = np.concatenate([colour, own.sh[:, 1:]], axis=1)
        means, quaternions, sh = Posing(self.bones, self.weights).out(own.means_m, own.quaternions, sh, transforms)
        return Gaussians(means, quaternions, own.log_scales, logits, sh)


def write_avatar(ply: Path, npz: Path, avatar: Avatar, mark: str = "") -> None:
    """Write the canonical Gaussians and, beside them, what moves them (AMASS-style names) and ``mark``, what they were trained from."""
    write_ply(ply, avatar.gaussians)
    arrays = {name: getattr(avatar, name) for name in _ARRAYS}
    arrays |= {"person": avatar.person, "body": avatar.model.identity, "mocap_framerate": avatar.fps, "metric": avatar.metric}
    arrays |= {f"network.{name}": value for name, value in avatar.network.to_arrays().items()} if avatar.network else {}
    arrays["decision"] = avatar.decision
    write_npz(npz, arrays | {"seen_share": avatar.seen_share, "mark": mark, "gaussians_sha256": _sha256(ply)})


def written_from(ply: Path, npz: Path) -> str:
    """The mark that ``write_avatar`` was given; "" when a file is missing, cannot be read, or the two were not written together."""
    if not (ply.is_file() and npz.is_file()):
        return ""
    try:
        with open(npz, "rb") as file, np.load(file, allow_pickle=False) as data:
            return str(data["mark"]) if str(data["gaussians_sha256"]) == _sha256(ply) else ""
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        say(f"{npz} cannot be read ({error}); it is made again")
        return ""


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_avatar(ply: Path, npz: Path, model: BodyModel) -> Avatar:
    """Read what ``write_avatar`` wrote; raises Refusal when a file is missing, the two disagree or the body model is another one."""
    if not npz.is_file():
        raise Refusal(f"{npz} is missing")
    gaussians = read_ply(ply)
    with np.load(npz, allow_pickle=False) as data:
        if str(data["body"]) != model.identity:
            raise Refusal(f"{npz} was trained on the body model {data['body']}, but {model.identity} was given; use the same body file")
        arrays = {name: data[name] for name in _ARRAYS}
        person, fps, metric = str(data["person"]), float(data["mocap_framerate"]), bool(data["metric"])
        held = {name.removeprefix("network."): data[name] for name in data.files if name.startswith("network.")}
        network, decision = TemporalNetwork.from_arrays(held) if held else None, str(data["decision"])
    if len(arrays["bones"]) != gaussians.count:
        raise Refusal(f"{ply} holds {gaussians.count} Gaussians and {npz} weights for {len(arrays['bones'])}; make both again")
    return Avatar(
        person=person, model=model, gaussians=gaussians, fps=fps, metric=metric, network=network, decision=decision, **arrays
    )  # fmt: skip
