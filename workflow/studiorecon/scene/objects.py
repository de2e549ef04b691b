# SPDX-License-Identifier: Apache-2.0
"""Loose things as rigid sets of Gaussians that move: ``humans/objects.npz``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from studiorecon.errors import Refusal
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.scene.gaussians import Gaussians

# A logit that no rasteriser draws: opacity 1e-13.
_ABSENT = -30.0
_GAUSSIANS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")
_MOTION = ("provenance", "centres_m", "valid", "present")


@dataclass(frozen=True)
class RigidObject:
    """One thing that keeps its shape and moves without turning: how it turns is not determined.

    Attributes:
        person: its name, ``o0``, ``o1``, …; what composites and mattes call it.
        gaussians: N Gaussians around the thing's own middle, metres, axes as in the world.
        provenance: (N,) uint8, see ``scene/provenance.py``.
        centres_m: (T, 3) world position of the middle; NaN where it is unknown.
        valid: (T,) bool: frames in which cameras measured the position; in others it lies on a line between measured ones.
        present: (T,) bool: frames in which the position is known; in others the thing is left out.
        radius_m: radius of the sphere with the outlines' size.
    """

    person: str
    gaussians: Gaussians
    provenance: np.ndarray
    centres_m: np.ndarray
    valid: np.ndarray
    present: np.ndarray
    radius_m: float

    def centre_at(self, frame: float) -> np.ndarray | None:
        """(3,) position at a 0-based, possibly fractional frame, metres; None where it is unknown.

        Beside a frame in which it is unknown, it stays where it was at the nearer of the two, if that one is known.
        """
        at = float(np.clip(frame, 0, len(self.centres_m) - 1))
        low = min(int(at), max(len(self.centres_m) - 2, 0))
        high = min(low + 1, len(self.centres_m) - 1)
        share = at - low
        if self.present[low] and self.present[high]:
            return (1 - share) * self.centres_m[low] + share * self.centres_m[high]
        near = high if share > 0.5 else low
        return self.centres_m[near] if self.present[near] else None

    def posed(self, frame: float) -> Gaussians:
        """The Gaussians in the world at a 0-based, possibly fractional frame; as many, but not drawn, where the position is unknown."""
        centre = self.centre_at(frame)
        if centre is None:
            return replace(self.gaussians, logit_opacities=np.full(self.gaussians.count, _ABSENT, np.float32))
        return replace(self.gaussians, means_m=(self.gaussians.means_m + centre).astype(np.float32))

    def joints_m(self, frame: float) -> np.ndarray:
        """(1, 3) the middle as the only joint, infinitely far away where it is unknown."""
        centre = self.centre_at(frame)
        return np.full((1, 3), np.inf) if centre is None else centre[None]

    def outline(self, camera: Camera, frame: int, grown: float = 1.0) -> np.ndarray:
        """(H, W) float32 z-depth of the middle where the sphere of ``grown`` times the radius is seen, 0 elsewhere and when absent."""
        drawn = np.zeros(camera.hw, np.float32)
        centre = self.centre_at(frame)
        if centre is None:
            return drawn
        pixel, depth_m = camera.project(centre)
        if depth_m <= self.radius_m:
            return drawn
        radius_px = grown * self.radius_m * np.array(camera.focal_px) / depth_m
        low = np.clip(np.floor(pixel - radius_px).astype(int), 0, camera.wh)
        high = np.clip(np.ceil(pixel + radius_px).astype(int), 0, camera.wh)
        columns, rows = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        inside = ((columns - pixel[0]) / radius_px[0]) ** 2 + ((rows - pixel[1]) / radius_px[1]) ** 2 <= 1
        drawn[low[1] : high[1], low[0] : high[0]][inside] = depth_m
        return drawn


def write_objects(path: Path, objects: Sequence[RigidObject], frames: int) -> None:
    """Write all objects of a scene of so many frames, maybe none."""
    arrays: dict[str, np.ndarray | int] = {"names": np.array([o.person for o in objects], dtype=np.str_), "frames": frames}
    for thing in objects:
        arrays |= {f"{thing.person}.{name}": getattr(thing.gaussians, name) for name in _GAUSSIANS}
        arrays |= {f"{thing.person}.{name}": getattr(thing, name) for name in (*_MOTION, "radius_m")}
    write_npz(path, arrays)


def read_objects(path: Path) -> list[RigidObject]:
    """The objects of a scene; raises Refusal when the file is missing or its arrays do not fit together."""
    if not path.is_file():
        raise Refusal(f"{path} is missing")
    found = []
    with np.load(path, allow_pickle=False) as data:
        frames = int(data["frames"])
        for name in map(str, data["names"]):
            gaussians = Gaussians(*(data[f"{name}.{field}"] for field in _GAUSSIANS))
            provenance, centres_m, valid, present = (data[f"{name}.{field}"] for field in _MOTION)
            if len(provenance) != gaussians.count or {len(centres_m), len(valid), len(present)} != {frames}:
                raise Refusal(f"{path} holds arrays of {name} that do not fit together; run humans.objects again")
            found.append(RigidObject(name, gaussians, provenance, centres_m, valid, present, float(data[f"{name}.radius_m"])))
    return found
