# SPDX-License-Identifier: Apache-2.0
"""The votes of all cameras' sweeps: per pixel a plane of the common catalogue, and whether it is confident."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.depth.stereo.plates import Picture
from studiorecon.scene.room import RoomBox
from studiorecon.scene.schema import UNIT_NORMALS, flag, metres, radians, real, whole
from studiorecon.scene.step_files import expect, read, require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

_OUTSIDE_MARGIN_M = 0.05


@dataclass(frozen=True)
class Votes:
    """The sweeps' votes: planes (L, 4), and per picture the chosen plane (H, W), confident pixels (H, W) bool."""

    planes: Num[np.ndarray, "L 4"]
    chosen: Sequence[Integer[np.ndarray, "H W"]]
    confident: Sequence[Bool[np.ndarray, "H W"]]

    def count(self) -> Integer[np.ndarray, " L"]:
        """Confident pixels per plane, over all pictures."""
        each = (np.bincount(c[m], minlength=len(self.planes)) for c, m in zip(self.chosen, self.confident))
        return sum(each, np.zeros(len(self.planes), np.int64))

    def voters(self, normal: Num[np.ndarray, " 3"], offset: float, reach_m: float) -> list[Bool[np.ndarray, "H W"]]:
        """Confident pixels of each picture whose plane is parallel to ``normal`` and within ``reach_m`` of
        ``offset``."""
        near = (self.planes[:, :3] @ normal > 0.999) & (np.abs(self.planes[:, 3] - offset) < reach_m)
        return [m & near[c] for c, m in zip(self.chosen, self.confident)]

    def inside_room(self, pictures: Sequence[Picture], room_box: RoomBox) -> Votes:
        """The votes with points inside the room box, because no camera sees through a wall."""
        kept = []
        for picture, chosen, confident in zip(pictures, self.chosen, self.confident):
            depth_m = picture.plane_depths_of_pixels(self.planes[chosen])
            points = picture.camera.unproject(picture.camera.pixel_centres(), depth_m)
            kept.append(confident & (depth_m > 0) & room_box.contains(points, _OUTSIDE_MARGIN_M))
        return replace(self, confident=kept)

    def depths_m(self, pictures: Sequence[Picture], room_box: RoomBox) -> list[Float[np.ndarray, "H W"]]:
        """Float32 depth of every picture: its pixel's plane where that is confident, else the room box."""
        return [
            np.where(sure, p.plane_depths_of_pixels(self.planes[at]), room_box.intersect(*p.camera.rays())[0]).astype(
                np.float32
            )
            for p, at, sure in zip(pictures, self.chosen, self.confident)
        ]


@dataclass(frozen=True)
class PlaneSweep:
    """All sweeps of a scene: ``votes`` of all cameras, and exposure ``gains`` that make them agree on the floor.

    ``floor_m`` and ``yaw_rad`` are the height of the floor and the direction of the walls of the catalogue.
    """

    votes: Votes
    gains: Num[np.ndarray, "V 3"]
    floor_m: float
    yaw_rad: float


_SWEEP = {
    "planes": metres("P 4", such=UNIT_NORMALS),
    "chosen": whole("H W", low=0),
    "cost": real("H W"),
    "confident": flag("H W"),
    "floor_m": metres(),
    "yaw_rad": radians(),
    "gains": real("V 3", above=0),
}


def _check_votes(arrays: dict[str, Any]) -> dict[str, Any]:
    most = int(arrays["chosen"].max(initial=0))
    expect(most < len(arrays["planes"]), f"chosen names plane {most} of {len(arrays['planes'])}")
    return arrays


def read_sweeps(sweeps: Sequence[Path], cameras: int) -> PlaneSweep:
    """The sweeps of ``cameras``; raises UserError unless there is one of each, all of one catalogue."""
    swept = [read(path, _SWEEP, _check_votes, sizes={"V": cameras}) for path in sweeps]
    for path, one in zip(sweeps, swept, strict=True):
        require(path, np.array_equal(one["planes"], swept[0]["planes"]), f"its planes are not those of {sweeps[0]}")
    first = swept[0]
    votes = Votes(first["planes"], [s["chosen"].astype(int) for s in swept], [s["confident"] for s in swept])
    return PlaneSweep(votes, first["gains"], float(first["floor_m"]), float(first["yaw_rad"]))
