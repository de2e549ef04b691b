# SPDX-License-Identifier: Apache-2.0
"""Opens the scene beside this file in Blender (4.2 or later): bodies in motion, the room, and every camera with what it
filmed behind what it sees. The room is Gaussians in Blender 5.3 and later, and points before.

    blender --python blender.py

From there Blender writes FBX and Alembic, and renders from the cameras (numeric pad 0 looks through the active one).
"""

import json
from pathlib import Path

import bpy

# Of Blender's cameras, millimetres: only the focal length's ratio to it shows.
SENSOR_MM = 36.0


def open_scene(folder):
    """Makes the scene of a ``deliver`` folder anew in the open file; returns its cameras by name."""
    told = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    for old in list(bpy.data.objects):
        bpy.data.objects.remove(old)
    scene = bpy.context.scene
    # Before the import: glTF counts seconds, Blender frames.
    scene.render.fps = max(round(told["fps"]), 1)
    scene.render.fps_base = scene.render.fps / told["fps"]
    scene.frame_start, scene.frame_end = 0, told["frames"] - 1
    scene.unit_settings.system = "METRIC"
    bpy.ops.import_scene.gltf(filepath=str(folder / "scene.glb"))
    show_splats(folder / "background.ply")
    cameras = {}
    for entry in told["cameras"]:
        thing = next(o for o in bpy.data.objects if o.type == "CAMERA" and o.name == entry["name"])
        cameras[entry["name"]] = thing
        set_lens(thing.data, entry)
        film = folder / entry["film"]
        if film.is_file():
            show_behind(thing.data, film)
        else:
            print(f"{film} is not there: camera {entry['name']} has no film behind it")
    if cameras:
        scene.camera = next(iter(cameras.values()))
        look_through(scene, told["cameras"][0])
    scene.frame_set(0)
    return cameras


def show_splats(file):
    """Puts the Gaussians of a PLY file in the place of the room's points, where Blender reads them as Gaussians."""
    if bpy.app.version < (5, 3, 0) or not file.is_file():
        return
    before = set(bpy.data.objects)
    bpy.ops.wm.ply_import(filepath=str(file), forward_axis="Y", up_axis="Z")
    read = [o for o in bpy.data.objects if o not in before]
    are_splats = bool(read) and all(o.type == "POINTCLOUD" for o in read)
    for old in [o for o in before if o.name == "room"] if are_splats else read:
        bpy.data.objects.remove(old)
    if are_splats:
        read[0].name = "room"
    else:
        print(f"this Blender does not read {file.name} as Gaussians: the room stays points")


def set_lens(lens, entry):
    """Focal length and principal point of a camera that was measured in pixels."""
    (width, height), (focal, _), (across, down) = entry["wh"], entry["focal_px"], entry["principal_px"]
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", SENSOR_MM
    lens.lens = focal / width * SENSOR_MM
    lens.shift_x, lens.shift_y = 0.5 - across / width, (down - height / 2) / width


def look_through(scene, entry):
    """Renders get the size and the pixels of a camera."""
    scene.render.resolution_x, scene.render.resolution_y = entry["wh"]
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_y = max(entry["focal_px"][0] / entry["focal_px"][1], 1.0)
    scene.render.pixel_aspect_x = max(entry["focal_px"][1] / entry["focal_px"][0], 1.0)


def show_behind(lens, film):
    """What a camera filmed, behind what is seen through it, its first picture at frame 0."""
    clip = bpy.data.movieclips.load(str(film))
    clip.frame_start = 0
    behind = lens.background_images.new()
    behind.source, behind.clip, behind.display_depth = "MOVIE_CLIP", clip, "BACK"
    lens.show_background_images = True


if __name__ == "__main__":
    open_scene(Path(__file__).resolve().parent)
