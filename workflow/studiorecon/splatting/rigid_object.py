# SPDX-License-Identifier: Apache-2.0
"""Moving rigid objects as sets of Gaussians, and their file ``objects/objects.npz``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.body.avatar.posing import Posing
from studiorecon.geometry import rotations
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.provenance import provenance_schema
from studiorecon.scene.schema import ROTATION, ListOf, Schema, flag, metres, real, text, whole
from studiorecon.scene.step_files import expect, read

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_GAUSSIANS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")
_MOTION = ("provenance", "centres_m", "world_from_object", "valid", "present")
MEASURED_TURNS, NO_TURNS = "measured", "undetermined"
# A rotating object's outline is drawn with this many sigmas around every Gaussian with a larger coverage.
_DEVIATIONS, _COVERS = 1.0, 0.3
# Its capsule needs so many such Gaussians, and spans these quantiles of them, so that outliers throw no shadow.
_MIN_COVERING, _ENDS = 8, (0.01, 0.99)
# OpenCV draws circles to this fraction of a pixel.
_FINE_BITS, _FINE = 4, 16


@dataclass(frozen=True)
class RigidObject:
    """One object of constant shape that moves, and rotates where the rotation was measured.

    Attributes:
        person: its name, ``o0``, ``o1``, …, as in composites and mattes.
        gaussians: around its own middle, metres; axes as in the world where its rotation is undetermined.
        provenance: uint8, see ``scene/provenance.py``.
        centres_m: world position of the middle; NaN where it is unknown.
        valid: frames in which cameras measured position and rotation; in others both are interpolated.
        present: frames in which the position is known; in others the object is not drawn.
        radius_m: radius of the sphere with the outlines' size.
        world_from_object: all the identity where undetermined.
        turns: "measured", or "undetermined": an object that does not rotate explains the pictures as well.
    """

    person: str
    gaussians: Gaussians
    provenance: Integer[np.ndarray, " N"]
    centres_m: Float[np.ndarray, "T 3"]
    valid: Bool[np.ndarray, " T"]
    present: Bool[np.ndarray, " T"]
    radius_m: float
    world_from_object: Float[np.ndarray, "T 3 3"] = field(default_factory=lambda: np.zeros((0, 3, 3)))
    turns: str = NO_TURNS

    def __post_init__(self) -> None:
        if self.turns not in (MEASURED_TURNS, NO_TURNS):
            raise ValueError(f"turns is {self.turns!r}, not {MEASURED_TURNS} or {NO_TURNS}")
        if self.turns == NO_TURNS:
            object.__setattr__(self, "world_from_object", np.tile(np.eye(3), (len(self.centres_m), 1, 1)))

    def centre_at(self, frame: float) -> Float[np.ndarray, " 3"] | None:
        """Position at a 0-based, possibly fractional frame, metres; None, or the known neighbour's, next to an unknown
        one.
        """
        low, high, share = self._between(frame)
        if self.present[low] and self.present[high]:
            return (1 - share) * self.centres_m[low] + share * self.centres_m[high]
        near = high if share > 0.5 else low
        return self.centres_m[near] if self.present[near] else None

    def turn_at(self, frame: float) -> Float[np.ndarray, "3 3"]:
        """Rotation world_from_object at a possibly fractional frame; next to an unknown frame, the known one's."""
        low, high, share = self._between(frame)
        if not (self.present[low] and self.present[high]):
            return self.world_from_object[low if self.present[low] else high]
        return rotations.slerp(self.world_from_object[low], self.world_from_object[high], share)

    def pose_at(self, frame: float) -> Float[np.ndarray, "4 4"]:
        """World_from_object at a frame; the translation is NaN where unknown."""
        pose, centre = np.eye(4), self.centre_at(frame)
        pose[:3, :3] = self.turn_at(frame)
        pose[:3, 3] = np.nan if centre is None else centre
        return pose

    def posed(self, frame: float) -> Gaussians:
        """The Gaussians in the world at a possibly fractional frame; as many, but invisible, where unknown."""
        centre, own = self.centre_at(frame), self.gaussians
        if centre is None:
            return own.undrawn()
        if self.turns == NO_TURNS:
            return replace(own, means_m=(own.means_m + centre).astype(np.float32))
        # One bone carries all Gaussians.
        bones = np.tile(np.eye(4), (24, 1, 1))
        bones[0, :3, :3], bones[0, :3, 3] = self.turn_at(frame), centre
        posing = Posing(np.zeros((own.count, 1), np.uint8), np.ones((own.count, 1), np.float32))
        means, quaternions, sh = posing.out(own.means_m, own.quaternions, own.sh, bones)
        return Gaussians(means, quaternions, own.log_scales, own.logit_opacities, sh)

    def joints_m(self, frame: float) -> Float[np.ndarray, "1 3"]:
        """The middle as the only joint, infinitely far away where it is unknown."""
        centre = self.centre_at(frame)
        return np.full((1, 3), np.inf) if centre is None else centre[None]

    def capsule(self, frame: float) -> Float[np.ndarray, "C 7"]:
        """A capsule that blocks light like the object, two ends and a radius, metres; none where the position is
        unknown.

        It is as long as the object, and as thick as the disc with the area of its cross-section.
        """
        centre, own = self.centre_at(frame), self.gaussians
        covers = own.logit_opacities > np.log(_COVERS / (1 - _COVERS))
        if centre is None or covers.sum() < _MIN_COVERING:
            return np.zeros((0, 7))
        means = own.means_m[covers].astype(np.float64)
        axes = np.linalg.eigh(np.cov(means.T))[1]
        low, high = np.quantile(means @ axes, _ENDS, axis=0)
        half = (high - low) / 2
        radius = float(np.sqrt(half[0] * half[1]))
        reach = max(float(half[2]) - radius, 0.0) * axes[:, 2]
        middle = axes @ ((low + high) / 2)
        ends = np.stack([middle - reach, middle + reach]) @ self.turn_at(frame).T + centre
        return np.concatenate([ends.ravel(), [radius]])[None]

    def outline(self, camera: Camera, frame: int, grown: float = 1.0) -> Float[np.ndarray, "H W"]:
        """Float32 z-depth of the middle inside the object's outline, 0 outside and when absent.

        That is the sphere of ``grown`` times the radius, or, with measured rotations, its own outline scaled by
        ``grown``.
        """
        drawn = np.zeros(camera.hw, np.float32)
        centre = self.centre_at(frame)
        if centre is None:
            return drawn
        pixel, depth_m = camera.project(centre)
        if depth_m <= self.radius_m:
            return drawn
        if self.turns == MEASURED_TURNS:
            return self._drawn(camera, frame, grown, float(depth_m), drawn)
        radius_px = grown * self.radius_m * np.array(camera.focal_px) / depth_m
        low = np.clip(np.floor(pixel - radius_px).astype(int), 0, camera.wh)
        high = np.clip(np.ceil(pixel + radius_px).astype(int), 0, camera.wh)
        columns, rows = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        inside = ((columns - pixel[0]) / radius_px[0]) ** 2 + ((rows - pixel[1]) / radius_px[1]) ** 2 <= 1
        drawn[low[1] : high[1], low[0] : high[0]][inside] = depth_m
        return drawn

    def _drawn(self, camera: Camera, frame: int, grown: float, depth_m: float, drawn: np.ndarray) -> np.ndarray:
        """The outline of an object with known rotations: a disc at every Gaussian with enough coverage."""
        own, centre = self.gaussians, self.centre_at(frame)
        covers = own.logit_opacities > np.log(_COVERS / (1 - _COVERS))
        means = centre + grown * own.means_m[covers] @ self.turn_at(frame).T
        reach_m = grown * _DEVIATIONS * np.exp(own.log_scales[covers]).max(axis=1)
        pixels, depths_m = camera.project(means)
        # No part of it is behind the camera, or its middle would be nearer than its radius.
        ahead = depths_m > self.radius_m / 4
        for (x, y), radius_px in zip(pixels[ahead], (reach_m * camera.focal_px[0] / depths_m)[ahead]):
            at = round(float(x - 0.5) * _FINE), round(float(y - 0.5) * _FINE)
            cv2.circle(drawn, at, round(float(radius_px) * _FINE), depth_m, cv2.FILLED, cv2.LINE_8, _FINE_BITS)
        return drawn

    def _between(self, frame: float) -> tuple[int, int, float]:
        """The frames around a fractional one, and the fraction between them."""
        at = float(np.clip(frame, 0, len(self.centres_m) - 1))
        low = min(int(at), max(len(self.centres_m) - 2, 0))
        return low, min(low + 1, len(self.centres_m) - 1), at - low


def write_objects(path: Path, objects: Sequence[RigidObject], frames: int) -> None:
    """Write all objects of a scene of ``frames`` frames; there may be none."""
    arrays: dict[str, np.ndarray | int | float | str] = {
        "names": np.array([o.person for o in objects], dtype=np.str_),
        "frames": frames,
    }
    for thing in objects:
        arrays |= {f"{thing.person}.{name}": getattr(thing.gaussians, name) for name in _GAUSSIANS}
        arrays |= {f"{thing.person}.{name}": getattr(thing, name) for name in (*_MOTION, "radius_m", "turns")}
    write_npz(path, arrays)


def read_objects(path: Path) -> list[RigidObject]:
    """The objects of a scene; raises UserError as ``step_files.read`` does."""
    named: dict[str, Any] = read(path, {"names": ListOf(text())}, names=("names",))
    names = [str(name) for name in named["names"]]
    schema: dict[str, Schema] = {"names": ListOf(text()), "frames": whole(low=1)}
    for name in names:
        schema |= {f"{name}.{field}": kind for field, kind in _object_schema(name).items()}

    def made(data: dict[str, Any]) -> list[RigidObject]:
        expect(len(set(names)) == len(names), "two objects share a name")
        return [
            _object(name, {f: data[f"{name}.{f}"] for f in _object_schema(name)}, int(data["frames"])) for name in names
        ]

    return read(path, schema, made)


def _object_schema(name: str) -> dict[str, Schema]:
    """The schema of one object, whose number of Gaussians is its own."""
    n = f"N_{name}"
    return {
        "means_m": metres(f"{n} 3"),
        "quaternions": real(f"{n} 4"),
        "log_scales": real(f"{n} 3"),
        "logit_opacities": real(n),
        "sh": real(f"{n} B_{name} 3"),
        "provenance": provenance_schema(n),
        "centres_m": metres("T 3", gaps=True),
        "world_from_object": real("T 3 3", such=ROTATION),
        "valid": flag("T"),
        "present": flag("T"),
        "radius_m": metres(above=0),
        "turns": text(MEASURED_TURNS, NO_TURNS),
    }


def _object(name: str, held: dict[str, Any], frames: int) -> RigidObject:
    expect(len(held["present"]) == frames, f"{name} has {len(held['present'])} frames of {frames}")
    expect(np.isfinite(held["centres_m"][held["present"]]).all(), f"{name} is nowhere in a frame that has it")
    return RigidObject(
        name,
        Gaussians(*(held[field] for field in _GAUSSIANS)),
        held["provenance"],
        held["centres_m"],
        held["valid"],
        held["present"],
        float(held["radius_m"]),
        held["world_from_object"],
        str(held["turns"]),
    )
