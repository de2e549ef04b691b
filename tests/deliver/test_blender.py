# SPDX-License-Identifier: Apache-2.0
"""The scene in Blender's own Python: cameras project points to the same pixels, bodies have their poses, films are
behind the scene.

``uv run --isolated --python 3.13 --with bpy --group test pytest -m slow tests/deliver/test_blender.py``: Blender as a
package, 0.8 GB.
"""

from __future__ import annotations

import json
import runpy
import shutil
import subprocess
import sys
import types
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import read_model
from studiorecon.deliver import export, scene_glb
from studiorecon.deliver.finished import read_finished
from studiorecon.footage.video import write_lossless

from tests.made.delivered import options
from tests.made.scene import FPS, FRAMES, render_options, write_scene
from tests.made.steps import call

SCRIPT = Path(__file__).resolve().parents[2] / "resources/blender.py"
LOOK = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import blender, bpy, mathutils
from bpy_extras.object_utils import world_to_camera_view
cameras, scene = blender.open_scene(Path(sys.argv[1])), bpy.context.scene
told = {"fps": scene.render.fps / scene.render.fps_base, "last": scene.frame_end, "pixels": {}, "films": {}}
scene.frame_set(int(sys.argv[2]))
entries = json.loads(Path(sys.argv[1], "manifest.json").read_text())["cameras"]
for (name, camera), entry in zip(cameras.items(), entries):
    blender.look_through(scene, entry)
    x, y, _ = world_to_camera_view(scene, camera, mathutils.Vector(json.loads(sys.argv[3])))
    told["pixels"][name] = [x * entry["wh"][0], (1 - y) * entry["wh"][1]]
    told["films"][name] = [behind.clip.frame_duration for behind in camera.data.background_images]
told["heads"] = [list(o.matrix_world @ b.head) for o in bpy.data.objects if o.type == "ARMATURE" for b in o.pose.bones]
told["splats"] = "radiance:base" in bpy.data.objects["room"].data.attributes
told["version"] = bpy.app.version[:2]
print("TOLD" + json.dumps(told))
"""


class Thing:
    def __init__(self, name: str, kind: str) -> None:
        self.name, self.type = name, kind


@pytest.mark.parametrize(
    ("version", "kind", "expected"),
    [
        ((5, 2, 3), "MESH", [("room", "MESH"), ("p0", "MESH")]),
        ((5, 3, 0), "POINTCLOUD", [("p0", "MESH"), ("room", "POINTCLOUD")]),
        ((5, 4, 0), "MESH", [("room", "MESH"), ("p0", "MESH")]),
    ],
)
def test_the_room_is_gaussians_where_blender_reads_them(
    version: tuple, kind: str, expected: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the source of Blender 5.3 has it: a PLY with all of a Gaussian's properties becomes a point cloud."""
    objects, bpy = [Thing("room", "MESH"), Thing("p0", "MESH")], types.ModuleType("bpy")
    bpy.app, bpy.data = types.SimpleNamespace(version=version), types.SimpleNamespace(objects=objects)
    asked: list[dict] = []
    reader = types.SimpleNamespace(
        ply_import=lambda **options: (asked.append(options), objects.append(Thing("background", kind)))
    )
    bpy.ops = types.SimpleNamespace(wm=reader)
    monkeypatch.setitem(sys.modules, "bpy", bpy)
    script = runpy.run_path(str(SCRIPT))
    script["show_splats"](tmp_path / "background.ply")
    assert not asked, "without the file nothing changes"
    (tmp_path / "background.ply").touch()
    script["show_splats"](tmp_path / "background.ply")
    assert [(o.name, o.type) for o in objects] == expected
    assert [options["up_axis"] for options in asked] == (["Z"] if version >= (5, 3) else [])


@pytest.mark.slow
@pytest.mark.skipif(find_spec("bpy") is None, reason="Blender as a package is not here (uv run --with bpy)")
def test_blender_opens_the_scene_as_it_is(tmp_path: Path, root: Path) -> None:
    write_scene(tmp_path, root, people=2, filmed=False)
    chosen = options(tmp_path, 2)
    call(export.run, **chosen)
    folder = chosen["contents"].parent
    names = ("manifest", "model", "background", "provenance", "gaussians", "avatars", "body")
    render = render_options(tmp_path, "orbit", 2)
    given = {name: render[name] for name in names}
    call(scene_glb.run, **given, objects=[], glb=folder / "scene.glb")
    cameras = read_model(chosen["model"].parent)
    for camera in cameras:
        frames = [np.zeros((camera.hw[0], camera.hw[1], 3), np.uint8)] * FRAMES
        write_lossless(tmp_path / "capture" / f"{camera.name}.mkv", frames, FPS)
    assert (folder / "blender.py").read_bytes() == SCRIPT.read_bytes()
    shutil.rmtree(folder / "__pycache__", ignore_errors=True)
    point_m, frame = [0.2, -0.1, 1.1], FRAMES - 1
    done = subprocess.run(
        [sys.executable, "-c", LOOK, str(folder), str(frame), json.dumps(point_m)],
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    reported = json.loads(done.stdout.partition("TOLD")[2].splitlines()[0])
    assert reported["fps"] == pytest.approx(FPS)
    assert reported["last"] == FRAMES - 1
    assert reported["splats"] == (reported["version"] >= [5, 3]), "Gaussians where Blender draws them"
    for camera in cameras:
        assert reported["pixels"][camera.name] == pytest.approx(camera.project(np.array([point_m]))[0][0], abs=0.05)
        assert reported["films"][camera.name] == [FRAMES]
    scene = call(read_finished, **given)
    heads = np.array(reported["heads"])
    for person in scene.people:
        assert np.linalg.norm(heads - person.trans[frame], axis=-1).min() < 1e-3
