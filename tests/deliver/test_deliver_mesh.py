# SPDX-License-Identifier: Apache-2.0
"""The room as a mesh: a box of a room with a crate in it, read back by trimesh."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from studiorecon.camera_files.colmap import write_model
from studiorecon.deliver import mesh
from studiorecon.deliver.fusion import FusedSurface, FusedView, decimate, fuse, open3d, remove_vertices
from studiorecon.deliver.room_planes import build_planes, distance_m, mesh_faces
from studiorecon.errors import UserError
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.scene.path import PathStep, write_path
from studiorecon.scene.provenance import INVENTED, MEASURED
from studiorecon.scene.room import RoomBox, write_room

from tests.made.cameras import look_at

ROOM = RoomBox(
    0.3,
    np.array([-2.0, -1.5, 0.0]),
    np.array([2.0, 1.5, 2.5]),
    np.array([True, True, True, False, True, False]),
    np.array([0.9, 0.9, 0.9, np.nan, 0.9, np.nan]),
)
# The crate is on the floor, its sides parallel to the room's.
CRATE = RoomBox(0.3, np.array([-0.4, -0.3, 0.0]), np.array([0.4, 0.3, 0.7]), np.ones(6, bool), np.ones(6))
WH = (240, 180)
RED, GREY = np.array([0.8, 0.2, 0.1]), np.array([0.5, 0.5, 0.5])


def looking(name: str, eye_m: tuple[float, float, float], at_m: tuple[float, float, float] = (0, 0, 0.4)) -> Camera:
    return look_at(name, np.array(eye_m), np.array(at_m), WH, 150.0)


CAMERAS = [
    looking(f"c{i}", (1.3 * np.cos(a), 1.2 * np.sin(a), 1.6)) for i, a in enumerate(np.arange(8) * np.pi / 4 + 0.1)
]


def entered(box: RoomBox, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Length along rays to a box from outside, inf where they miss it."""
    start, towards = origin @ box.axes.T, directions @ box.axes.T
    a, b = (box.low_m - start) / towards, (box.high_m - start) / towards
    enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


def view(camera: Camera) -> FusedView:
    origin, directions = camera.rays()
    wall_m, face = ROOM.intersect(origin, directions)
    crate_m = entered(CRATE, origin, directions)
    rgb = np.where((crate_m < wall_m)[..., None], RED, np.where((face == 4)[..., None], GREY, GREY + 0.2))
    return FusedView(camera, rgb.astype(np.float32), np.minimum(wall_m, crate_m).astype(np.float32))


@pytest.fixture(scope="module")
def views() -> list[FusedView]:
    return [view(camera) for camera in CAMERAS]


@pytest.fixture
def fusing() -> None:
    try:
        open3d()
    except UserError as refusal:
        pytest.skip(str(refusal))


def read_back(path: Path) -> dict[str, trimesh.Trimesh]:
    return trimesh.load(path, process=False).geometry


def test_planes_are_exact_face_inwards_and_say_what_was_seen(tmp_path: Path, views: list[FusedView]) -> None:
    flat = build_planes(ROOM, views, 0.05, 40_000)
    nothing = FusedSurface(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3)))
    mesh.write_room(tmp_path / "room.glb", flat, nothing, ["v_high", "ceiling"])
    read = read_back(tmp_path / "room.glb")
    assert list(read) == ["u_low", "u_high", "v_low", "floor"], "walls that the photos do not tell are left out"
    assert np.abs(read["floor"].vertices[:, 1]).max() == 0, "y is up, and the floor lies at 0"
    assert read["u_low"].bounds[1][1] == pytest.approx(2.5)
    for name, part in read.items():
        inside = np.array([0, 1.2, 0]) - part.triangles_center
        assert (np.sum(part.face_normals * inside, axis=1) > 0).all(), f"{name} is seen from inside"
    floor = next(plane for plane in flat if plane.name == "floor")
    inside = np.abs(floor.vertices_m @ ROOM.axes.T)[:, :2]
    beneath = (inside < np.array([0.28, 0.18])).all(axis=1)
    assert (floor.provenance[beneath] == INVENTED).all(), "nobody sees the floor beneath the crate"
    beside = ((inside > 0.7) & (inside < 1.1)).all(axis=1)
    assert (floor.provenance[beside] == MEASURED).mean() > 0.9
    assert np.abs(floor.rgb[beside] - GREY).max() < 0.02
    redness = np.abs(floor.rgb[beneath] - GREY).mean() / np.abs(RED - GREY).mean()
    assert redness < 0.5, "unseen floor takes its colour from the floor beside it"
    stored = read["floor"].visual.vertex_attributes["color"][:, :3] / 65535
    assert stored == pytest.approx(((floor.rgb + 0.055) / 1.055) ** 2.4, abs=1e-4), "glTF's vertex colours are linear"
    assert read["floor"].vertex_attributes["_PROVENANCE"][:, 0] == pytest.approx(floor.provenance)


@pytest.mark.usefixtures("fusing")
def test_what_stands_in_the_room_is_fused_where_it_is(views: list[FusedView]) -> None:
    surface = fuse(views, 0.02)
    standing = remove_vertices(surface, distance_m(ROOM, surface.vertices_m) < 0.06)
    # The wall that is not a plane of the mesh is fused like everything else.
    crate = standing.vertices_m[np.abs(standing.vertices_m @ ROOM.axes.T)[:, 1] < 1.0]
    off = np.abs(crate @ ROOM.axes.T - [0, 0, 0.35]) - [0.4, 0.3, 0.35]
    outside = np.linalg.norm(np.maximum(off, 0), axis=1) + np.minimum(off.max(axis=1), 0)
    assert len(crate) > 1000
    assert np.median(np.abs(outside)) < 0.005
    assert np.percentile(np.abs(outside), 95) < 0.02
    for axis in range(2):
        reach = (crate @ ROOM.axes.T)[:, axis]
        assert [reach.min(), reach.max()] == pytest.approx([CRATE.low_m[axis], CRATE.high_m[axis]], abs=0.05)
    few = decimate(standing, 2000)
    assert 1000 < len(few.triangles) <= 2000
    near = np.linalg.norm(standing.rgb - RED, axis=1) < 0.1
    assert near[np.abs(standing.vertices_m[:, :2]).max(axis=1) < 0.3].mean() > 0.9


@pytest.mark.usefixtures("fusing")
def test_the_step_writes_the_same_bytes_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, views: list[FusedView]
) -> None:
    seen_from: list[str] = []

    def seen(gaussians: Gaussians, marks: np.ndarray, cameras: list[Camera]) -> list[FusedView]:
        seen_from[:] = [camera.name for camera in cameras]
        return views

    monkeypatch.setattr(mesh, "render_views", seen)
    monkeypatch.setattr(mesh, "VOXEL_M", 0.04)
    write_model(tmp_path, CAMERAS[:4])
    write_path(tmp_path / "path.json", [PathStep(camera, 0.0, "00") for camera in CAMERAS[4:]], 30.0)
    write_room(tmp_path / "room.json", ROOM)
    one = Gaussians(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3)), np.zeros(1), np.zeros((1, 1, 3)))
    write_ply(tmp_path / "scene.ply", one)
    np.savez(tmp_path / "provenance.npz", provenance=np.zeros(1, np.uint8))
    files = [tmp_path / name for name in ("images.txt", "scene.ply", "provenance.npz", "room.json", "path.json")]
    for name in ("a.glb", "b.glb"):
        mesh.run(*files, tmp_path / name)
    assert seen_from == [camera.name for camera in CAMERAS]
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    read = read_back(tmp_path / "a.glb")
    assert list(read) == ["u_low", "u_high", "v_low", "floor", "standing"]
    np.savez(tmp_path / "provenance.npz", provenance=np.zeros(2, np.uint8))
    with pytest.raises(UserError, match="provenance has shape"):
        mesh.run(*files, tmp_path / "a.glb")


def test_without_open3d_it_says_which_extra_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(UserError, match=r"room\.glb is made by open3d.*extra mesh.*the other files do not need it"):
        open3d()


def test_default_walls_are_no_planes_of_the_mesh() -> None:
    assert mesh_faces(ROOM) == [0, 1, 2, 4]
    assert distance_m(ROOM, np.array([[0.0, 0.0, 2.5], [0.0, 0.0, -0.3]])) == pytest.approx([1.5, 0.0])
