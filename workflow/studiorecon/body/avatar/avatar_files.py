# SPDX-License-Identifier: Apache-2.0
"""A person as Gaussians in the body's rest pose, with everything that moves them: ``humans/<person>.{ply,npz}``."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.body.avatar.drift import Drift
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.temporal import NETWORK, TemporalNetwork
from studiorecon.body.hands import scale_hands
from studiorecon.body.model import BodyModel
from studiorecon.geometry import rotations
from studiorecon.progress import say
from studiorecon.scene.decisions import Decision, from_entry
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.provenance import MEASURED, provenance_schema
from studiorecon.scene.schema import OptionalField, Schema, flag, frame_rate, metres, radians, real, text, whole
from studiorecon.scene.step_files import expect, expect_named, read

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

# Number of poses in the cache: films ask for the same ones for every picture and every camera.
_MOMENTS_KEPT = 4096
_NETWORK = "network."
_AVATAR: dict[str, Schema] = {
    "person": text(),
    "body": text(),
    "bones": whole("N K", low=0, high=53),
    "weights": real("N K", low=0, high=1),
    "provenance": provenance_schema("N"),
    "poses": radians("T 72"),
    "trans": metres("T 3"),
    "betas": real("B"),
    "valid": flag("T"),
    "present": flag("T"),
    "mocap_framerate": frame_rate(),
    "metric": flag(),
    "hand_poses": OptionalField(radians("T 90")),
    "hand_scale": OptionalField(real("2", low=0.1, high=10)),
    "decision": text(),
    "seen_share": real(low=0, high=1),
    "mark": text(),
    "gaussians_sha256": text(),
    **{f"{_NETWORK}{name}": OptionalField(field) for name, field in NETWORK.items()},
}
_ARRAYS = ("bones", "weights", "provenance", "poses", "trans", "betas", "valid", "present")


@dataclass(frozen=True)
class Avatar:
    """One person's Gaussians and motion.

    Attributes:
        person: ``p0``, ``p1``, …
        model: the body model whose skeleton carries the Gaussians.
        gaussians: N canonical Gaussians in the shaped rest pose, metres, SH degree at most 2.
        bones, weights: uint8 joints that carry each Gaussian; float32 skinning weights, rows sum to 1.
        provenance: uint8, see ``scene/provenance.py``: measured, or inferred from its surroundings on the body.
        poses: refined axis-angle poses of all joints, radians: 24, or 54 with fingers.
        trans: world position of the pelvis joint, metres.
        betas: shape, and size where there is one more than the shape space has (``body.model.of_size``).
        valid: frames in which the body was measured.
        metric: True when lengths are metres.
        network: adds residuals over time to colour and opacity of the Gaussians that it acts on; None for none.
        decision: the decision on that network as in ``survey/decisions.json``, JSON; "" when the survey made none.
        hand_scale: of ``Person``, where the model has fingers.
        present: frames in which the person is present; in others nothing is drawn. All True by default.
    """

    person: str
    model: BodyModel
    gaussians: Gaussians
    bones: Integer[np.ndarray, "N K"]
    weights: Float[np.ndarray, "N K"]
    provenance: Integer[np.ndarray, " N"]
    poses: Num[np.ndarray, "T 3*J"]
    trans: Num[np.ndarray, "T 3"]
    betas: Num[np.ndarray, " B"]
    valid: Bool[np.ndarray, " T"]
    fps: float
    metric: bool
    network: TemporalNetwork | None = None
    decision: str = ""
    hand_scale: Num[np.ndarray, " 2"] | None = None
    present: Bool[np.ndarray, " T"] = field(default_factory=lambda: np.zeros(0, bool))

    def __post_init__(self) -> None:
        if not len(self.present):
            object.__setattr__(self, "present", np.ones(len(self.poses), bool))

    @property
    def frames(self) -> int:
        return len(self.poses)

    @property
    def seen_share(self) -> float:
        """Share of the Gaussians that a training camera saw."""
        return float((self.provenance == MEASURED).mean()) if len(self.provenance) else 0.0

    def pose_at(self, frame: float) -> tuple[Num[np.ndarray, " 3*J"], Num[np.ndarray, " 3"]]:
        """Axis-angle pose and pelvis position, metres, at a 0-based frame, interpolated on the sphere between frames.

        Frames outside the clip return its first or last pose. While the person is away, the pose moves towards where
        they come back, because a camera may follow them.
        """
        at = float(np.clip(frame, 0, self.frames - 1))
        low = min(int(at), max(self.frames - 2, 0))
        share = at - low
        if share == 0.0 or self.frames == 1:
            return self.poses[low], self.trans[low]
        if share == 1.0:
            return self.poses[low + 1], self.trans[low + 1]
        first, second = (rotations.exp(self.poses[t].reshape(-1, 3)) for t in (low, low + 1))
        return rotations.log(rotations.slerp(first, second, share)).reshape(-1), (1 - share) * self.trans[
            low
        ] + share * self.trans[low + 1]

    def is_present(self, frame: float) -> bool:
        """Whether the person is present at a 0-based, possibly fractional frame; the nearest frame decides."""
        at = float(np.clip(frame, 0, self.frames - 1))
        return bool(self.present[int(at) + (at - int(at) > 0.5)])

    def joints_m(self, frame: float) -> Num[np.ndarray, "J 3"]:
        """World joints at a possibly fractional frame, metres; infinitely far away while the person is away."""
        return self._moved(frame)[1] if self.is_present(frame) else np.full((len(self.model.parents), 3), np.inf)

    def world_from_rest(self, frame: float) -> Num[np.ndarray, "J 4 4"]:
        """Transforms of the joints at a 0-based, possibly fractional frame; read-only."""
        return self._moved(frame)[0]

    @cached_property
    def _moved(self) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
        def moved(frame: float) -> tuple[Num[np.ndarray, "J 4 4"], Num[np.ndarray, "J 3"]]:
            pose, trans = self.pose_at(frame)
            transforms = self.model.joint_transforms(pose[None], self.betas, trans[None])[0]
            joints = self.model.joints(pose[None], self.betas, trans[None])[0]
            for array in (transforms, joints):
                array.setflags(write=False)
            return transforms, joints

        return lru_cache(_MOMENTS_KEPT)(moved)

    @cached_property
    def _posing(self) -> Posing:
        return Posing(self.bones, self.weights)

    @property
    def drift_mask(self) -> Bool[np.ndarray, " N"]:
        """Which Gaussians ``network`` acts on: the measured ones, or all."""
        move_unseen = self.network is not None and self.network.move_unseen
        return np.ones(len(self.provenance), bool) if move_unseen else self.provenance == MEASURED

    @cached_property
    def _drift(self) -> Drift | None:
        return Drift(self.network, self.gaussians.means_m[self.drift_mask]) if self.network else None

    def appearance_at(self, frame: float) -> tuple[Float[np.ndarray, "N K 3"], Float[np.ndarray, " N"]]:
        """Harmonics and logit opacities of the canonical Gaussians at a frame, with the network's residuals."""
        own, seen = self.gaussians, self.drift_mask
        if self._drift is None or not seen.any():
            return own.sh, own.logit_opacities
        colour, logit = self._drift.residuals(frame)
        sh, logits = own.sh.copy(), own.logit_opacities.copy()
        sh[seen, 0] += colour
        logits[seen] += logit
        return sh, logits

    def facing(self) -> Num[np.ndarray, "T 2"]:
        """Horizontal unit vectors in which the pelvis faces; x where it faces straight up or down."""
        forward = rotations.exp(np.asarray(self.poses[:, :3], np.float64))[:, :2, 2]
        length = np.linalg.norm(forward, axis=1, keepdims=True)
        return np.where(length > 1e-6, forward / np.maximum(length, 1e-6), [1.0, 0.0])

    def posed(self, frame: float) -> Gaussians:
        """The person's Gaussians in the world at a frame; as many, but invisible, while the person is away."""
        own = self.gaussians
        if not self.is_present(frame):
            return own.undrawn()
        sh, logits = self.appearance_at(frame)
        means, quaternions, sh = self._posing.out(own.means_m, own.quaternions, sh, self.world_from_rest(frame))
        return Gaussians(means, quaternions, own.log_scales, logits, sh)


def write_avatar(ply: Path, npz: Path, avatar: Avatar, mark: str = "") -> None:
    """Write canonical Gaussians, their motion (AMASS-style names) and ``mark``, which identifies the training data."""
    write_ply(ply, avatar.gaussians)
    arrays = {name: getattr(avatar, name) for name in _ARRAYS}
    arrays |= {
        "person": avatar.person,
        "body": avatar.model.identity,
        "mocap_framerate": avatar.fps,
        "metric": avatar.metric,
    }
    arrays |= (
        {f"{_NETWORK}{name}": value for name, value in avatar.network.to_arrays().items()} if avatar.network else {}
    )
    arrays["decision"] = avatar.decision
    if avatar.hand_scale is not None:
        arrays |= {"poses": avatar.poses[:, :72], "hand_poses": avatar.poses[:, 72:], "hand_scale": avatar.hand_scale}
    write_npz(npz, arrays | {"seen_share": avatar.seen_share, "mark": mark, "gaussians_sha256": _sha256(ply)})


def read_cache_key(ply: Path, npz: Path) -> str:
    """The mark given to ``write_avatar``; "" when a file is missing, unreadable or not of the same writing."""
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


def read_avatar(ply: Path, npz: Path, model: BodyModel, *, brought: bool = False) -> Avatar:
    """Read the files of ``write_avatar``.

    Raises UserError as ``step_files.read`` does, also when the two were not written together or belong to another body
    model. The Gaussians of ``brought`` may have been renamed or repainted by a user.
    """
    gaussians = read_ply(ply)

    def made(data: dict[str, Any]) -> Avatar:
        if not brought:
            expect_named(npz, str(data["person"]))
            expect(
                str(data["gaussians_sha256"]) == _sha256(ply),
                f"it was not written together with {ply.name}: delete both",
            )
        model.require_same(str(data["body"]), str(npz))
        held = {name.removeprefix(_NETWORK): data[name] for name in data if name.startswith(_NETWORK)}
        scale = data.get("hand_scale")
        if scale is not None:
            data["poses"] = np.concatenate([data["poses"], data["hand_poses"]], axis=1)
        return Avatar(
            person=str(data["person"]),
            model=model if scale is None else scale_hands(model, scale),
            gaussians=gaussians,
            fps=float(data["mocap_framerate"]),
            metric=bool(data["metric"]),
            network=TemporalNetwork.from_arrays(held) if held else None,
            decision=str(data["decision"]),
            hand_scale=scale,
            **{name: data[name] for name in _ARRAYS},
        )

    return read(npz, _AVATAR, made, sizes={"N": gaussians.count})


def read_decision(npz: Path) -> Decision | None:
    """The survey's decision on the network in an avatar's file, or None; raises UserError as ``step_files.read``."""

    def made(data: dict[str, Any]) -> Decision | None:
        entry = str(data["decision"])
        return from_entry(json.loads(entry)) if entry else None

    return read(npz, {"decision": text()}, made, names=("decision",))
