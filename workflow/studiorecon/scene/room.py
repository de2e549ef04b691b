# SPDX-License-Identifier: Apache-2.0
"""The room as a box: floor, ceiling and four upright walls, each fitted to the photos or a default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import MappingOf, OptionalField, flag, metres, radians, real
from studiorecon.scene.step_files import expect, read

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

FACES = ("u_low", "u_high", "v_low", "v_high", "floor", "ceiling")
_FACE = {"fitted": flag(), "score": real(gaps=True, low=-1, high=1)}
_GAIN = real("3", above=0)
_ROOM = {
    "yaw_rad": radians(),
    "low_m": metres("3"),
    "high_m": metres("3"),
    "gains": MappingOf(_GAIN),
    "faces": dict.fromkeys(FACES, _FACE),
    "platform": OptionalField({"low_m": metres("2"), "high_m": metres("2"), "top_m": metres()}),
}


@dataclass(frozen=True)
class Face:
    """One rectangle of the room, ``name``: one of ``FACES``; ``along_u`` and ``along_v`` are the edges from the
    corner."""

    name: str
    corner_m: Num[np.ndarray, " 3"]
    along_u: Num[np.ndarray, " 3"]
    along_v: Num[np.ndarray, " 3"]

    @property
    def normal(self) -> Num[np.ndarray, " 3"]:
        n = np.cross(self.along_u, self.along_v)
        return n / np.linalg.norm(n)

    def nodes(self, step_m: float) -> Num[np.ndarray, "R C 3"]:
        """Centres of cells of about ``step_m``, rows along v."""
        columns = max(1, round(float(np.linalg.norm(self.along_u)) / step_m))
        rows = max(1, round(float(np.linalg.norm(self.along_v)) / step_m))
        u, v = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        return self.corner_m + u[None, :, None] * self.along_u + v[:, None, None] * self.along_v

    def cells(self, points_m: Num[np.ndarray, "*N 3"], shape: tuple[int, int]) -> Num[np.ndarray, "*N 2"]:
        """Row and column of points among ``shape`` cells; 0 is the first cell's centre."""
        rows, columns = shape
        there = points_m - self.corner_m
        shares = [there @ edge / (edge @ edge) for edge in (self.along_v, self.along_u)]
        return np.stack([shares[0] * rows - 0.5, shares[1] * columns - 0.5], axis=-1)


@dataclass(frozen=True)
class Platform:
    """The surface on which people stand where the room's floor is lower, measured from its own pixels.

    The first of ``depth/primitives.json`` is the same surface, extended to explain the photos.

    Attributes:
        low_m, high_m: its sides' smallest and largest coordinates along the room box's u and v.
        top_m: its height, on which people stand.
    """

    low_m: Num[np.ndarray, " 2"]
    high_m: Num[np.ndarray, " 2"]
    top_m: float


@dataclass(frozen=True)
class RoomBox:
    """A box with vertical walls that encloses every camera.

    The walls are perpendicular to the horizontal directions u = (cos yaw, sin yaw, 0) and v = (-sin yaw, cos yaw, 0).

    Attributes:
        yaw_rad: direction of u, in [0, pi/2).
        low_m, high_m: smallest and largest coordinates along u, v and z.
        fitted: fitted to the photos, in the order of ``FACES``; defaults must not be called measured.
        score: mean correlation over the pixels each face was fitted to; NaN for defaults.
        gains: camera name → factors of its exposure: divide its photo by them to make the cameras agree.
        platform: the surface on which people stand, None where that is the floor.
    """

    yaw_rad: float
    low_m: Num[np.ndarray, " 3"]
    high_m: Num[np.ndarray, " 3"]
    fitted: Bool[np.ndarray, " 6"]
    score: Num[np.ndarray, " 6"]
    gains: Mapping[str, Num[np.ndarray, " 3"]] = field(default_factory=dict)
    platform: Platform | None = None

    @property
    def standing_m(self) -> float:
        """Height of the surface on which people stand."""
        return float(self.low_m[2]) if self.platform is None else self.platform.top_m

    @property
    def axes(self) -> Num[np.ndarray, "3 3"]:
        """Rows u, v and z: coordinates in the box are ``points @ axes.T``."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def with_faces(self, offsets_m: Mapping[int, float]) -> RoomBox:
        """The box with these faces (indices in ``FACES``) at other offsets."""
        low_m, high_m = self.low_m.copy(), self.high_m.copy()
        for face, offset_m in offsets_m.items():
            (low_m, high_m)[face % 2][face // 2] = offset_m
        return replace(self, low_m=low_m, high_m=high_m)

    @property
    def faces(self) -> Num[np.ndarray, "6 4"]:
        """Planes n·p = o of the faces in the order of ``FACES``."""
        offsets = np.stack([self.low_m, self.high_m], axis=1).reshape(6)
        return np.concatenate([np.repeat(self.axes, 2, axis=0), offsets[:, None]], axis=1)

    @property
    def rectangles(self) -> list[Face]:
        """The six faces in the order of ``FACES``."""
        edges = self.axes * (self.high_m - self.low_m)[:, None]
        found = []
        for index, name in enumerate(FACES):
            axis, far = divmod(index, 2)
            corner = self.low_m.copy()
            corner[axis] = self.high_m[axis] if far else self.low_m[axis]
            u, v = [edges[k] for k in range(3) if k != axis]
            found.append(Face(name, corner @ self.axes, u, v))
        return found

    def contains(self, points_m: Num[np.ndarray, "... 3"], margin_m: float = 0.0) -> Bool[np.ndarray, " ..."]:
        """Which points are inside the box grown by ``margin_m``."""
        inside = points_m @ self.axes.T
        return ((inside >= self.low_m - margin_m) & (inside <= self.high_m + margin_m)).all(axis=-1)

    def intersect(
        self, origins_m: Num[np.ndarray, "... 3"], directions: Num[np.ndarray, "... 3"]
    ) -> tuple[Num[np.ndarray, " ..."], Integer[np.ndarray, " ..."]]:
        """Length along the directions to the wall that a ray from inside meets, and the face's index in ``FACES``.

        With ``Camera.rays`` the length is z-depth in metres. A ray that never meets the box, or leads away from it,
        gets length 0 and face -1. From outside towards the box, the far wall counts.
        """
        origin = np.broadcast_to(
            origins_m @ self.axes.T, np.broadcast_shapes(np.shape(origins_m), np.shape(directions))
        )
        direction = directions @ self.axes.T
        still = np.abs(direction) < 1e-12
        step = np.where(still, 1.0, direction)
        to_low, to_high = (self.low_m - origin) / step, (self.high_m - origin) / step
        between = (origin >= self.low_m) & (origin <= self.high_m)
        # A ray parallel to a pair of faces never crosses them: it is always between them, or never.
        leave = np.where(still, np.where(between, np.inf, -np.inf), np.maximum(to_low, to_high))
        enter = np.where(still, -np.inf, np.minimum(to_low, to_high))
        axis = leave.argmin(axis=-1)
        length = leave.min(axis=-1)
        hit = (length > 0) & (length >= enter.max(axis=-1)) & np.isfinite(length)
        outward = np.take_along_axis(step, axis[..., None], axis=-1)[..., 0] > 0
        return np.where(hit, length, 0.0), np.where(hit, 2 * axis + outward, -1)


def write_room(path: Path, room_box: RoomBox) -> None:
    """Write ``depth/room.json``."""
    value = {name: getattr(room_box, name) for name in ("yaw_rad", "low_m", "high_m", "gains")}
    faces = {
        name: {"fitted": bool(room_box.fitted[i]), "score": float(room_box.score[i])} for i, name in enumerate(FACES)
    }
    platform = None if room_box.platform is None else asdict(room_box.platform)
    write_json(path, value | {"faces": faces, "platform": platform})


def read_room(path: Path, cameras: Sequence[str] = ()) -> RoomBox:
    """Read ``depth/room.json``, which has gains of ``cameras``; raises UserError as ``step_files.read`` does."""
    return read(path, _ROOM | {"gains": dict.fromkeys(cameras, _GAIN)} if cameras else _ROOM, _room)


def _room(value: Mapping[str, Any]) -> RoomBox:
    faces = [value["faces"][name] for name in FACES]
    made = RoomBox(
        yaw_rad=float(value["yaw_rad"]),
        low_m=np.asarray(value["low_m"], np.float64),
        high_m=np.asarray(value["high_m"], np.float64),
        fitted=np.array([f["fitted"] for f in faces], bool),
        score=np.array([np.nan if f["score"] is None else f["score"] for f in faces], np.float64),
        gains={name: np.asarray(gain, np.float64) for name, gain in value["gains"].items()},
        platform=None if value["platform"] is None else _platform(value["platform"]),
    )
    expect((made.low_m < made.high_m).all(), "low_m is not below high_m")
    expect((np.isnan(made.score) == ~made.fitted).all(), "score is not there for the faces that are fitted")
    return made


def _platform(value: Mapping[str, Any]) -> Platform:
    low_m, high_m = (np.asarray(value[name], np.float64).reshape(2) for name in ("low_m", "high_m"))
    expect((low_m < high_m).all(), "low_m of the platform is not below its high_m")
    return Platform(low_m, high_m, float(value["top_m"]))
