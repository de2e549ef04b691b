# SPDX-License-Identifier: Apache-2.0
"""``deliver.player``: writes the moving 4D scene as one page for browsers with WebGL2, without a network."""

from __future__ import annotations

import base64
import html
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.deliver.finished import FinishedScene, read_finished
from studiorecon.deliver.packing import Bytes
from studiorecon.deliver.player_data import describe_scene, read_shade
from studiorecon.footage.video import Codec, read_frame, read_frames, to_bytes, write_film
from studiorecon.images.encoded import jpeg
from studiorecon.progress import say
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import atomic_path, write_text
from studiorecon.scene.gaussians import concatenate
from studiorecon.signature import Written
from studiorecon.splatting.device import DRAWN_FROM_M, rasteriser
from studiorecon.splatting.scene_files import SceneFiles

if TYPE_CHECKING:
    from jaxtyping import Integer

# In the order of loading: each uses only those before it.
SCRIPTS = ("scene", "sort", "shaders", "draw", "camera", "play", "link", "panel", "embed", "xr", "hands")
# Largest width of camera films shown over the scene, most frames and bytes; a longer film is replaced by this many
# photos.
FILM_WIDTH, FILM_FRAMES, FILM_BYTES, PHOTOS = 640, 600, 2_500_000, 8
# A key frame every twelve, so that the slider seeks quickly.
_FILM = Codec(
    "libx264",
    "rgb24",
    "yuv420p",
    {"crf": "30", "preset": "medium", "g": "12", "x264-params": "mbtree=0"},
    "mp4",
    {"movflags": "+faststart"},
)
_POSTER_WIDTH = 960
QUALITY = 82
"""JPEG quality of the pictures in the page."""
_ALWAYS = ("colours are those before enhancement; only the films show what enhancement adds",)


def add_footage(
    held: Bytes, cameras: Sequence[dict[str, Any]], videos: Sequence[Path], frames: int, fps: float
) -> list[str]:
    """Adds to each camera its film if all of them fit, else some photos; returns sentences that say which."""
    if not videos:
        return []
    if frames <= FILM_FRAMES:
        with tempfile.TemporaryDirectory() as folder:
            made = [_film(video, Path(folder) / f"{k}.mp4", frames, fps) for k, video in enumerate(videos)]
        if sum(map(len, made)) <= FILM_BYTES:
            for camera, film in zip(cameras, made, strict=True):
                camera["film"] = held.file(film)
            return []
    for camera, video in zip(cameras, videos, strict=True):
        camera["photos"] = [
            {"frame": int(frame), "file": held.file(jpeg(downscale_to_width(read_frame(video, int(frame))), QUALITY))}
            for frame in spread_indices(frames, PHOTOS)
        ]
    return [f"{min(PHOTOS, frames)} of {frames} photos per camera are included; the nearest in time is shown"]


def _film(video: Path, path: Path, frames: int, fps: float) -> bytes:
    write_film(path, (downscale_to_width(frame) for frame in read_frames(video, 0, frames)), fps, _FILM)
    return path.read_bytes()


def downscale_to_width(picture: Integer[np.ndarray, "H W 3"], width: int = FILM_WIDTH) -> Integer[np.ndarray, "h w 3"]:
    """A picture, at most ``width`` wide, with even sides, as H.264 requires."""
    wide = min(picture.shape[1], width)
    size = max(wide // 2 * 2, 2), max(round(picture.shape[0] * wide / picture.shape[1] / 2) * 2, 2)
    if size == (picture.shape[1], picture.shape[0]):
        return picture
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def render_poster(scene: FinishedScene) -> Integer[np.ndarray, "H W 3"]:
    """View of the scene in the middle of the capture, from the middle of its first film, or its first camera."""
    steps = next((steps for steps in scene.paths.values() if steps), None)
    camera = steps[len(steps) // 2].camera if steps else scene.cameras[0]
    frame = steps[len(steps) // 2].frame if steps else (scene.capture.frames - 1) / 2
    size = _POSTER_WIDTH, round(_POSTER_WIDTH * camera.wh[1] / camera.wh[0])
    people, things = ([one.posed(frame) for one in several] for several in (scene.people, scene.things))
    drawn = rasteriser("cpu", near_m=DRAWN_FROM_M).forward(
        concatenate([scene.room, *people, *things]), camera.resized(size)
    )
    return to_bytes(drawn.rgb)


def build_page(title: str, data: dict[str, Any], held: Bytes, poster: bytes, parts: Sequence[Path]) -> str:
    """The complete page from its ``parts`` (page.html and the scripts); names from the capture are escaped."""
    source = {path.stem: path.read_text(encoding="utf-8") for path in parts}
    page, scripts = source["page"], "\n".join(source[name] for name in SCRIPTS)
    filled = {
        "title": html.escape(title),
        "scene": json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "bytes": held.text(),
        "poster": "data:image/jpeg;base64," + base64.b64encode(poster).decode("ascii"),
        "scripts": f'(() => {{\n"use strict";\n{scripts}\n}})();',
    }
    for name, part in filled.items():
        before, after = page.split(f"<!--{name}-->")
        page = before + part + after
    return page


def run(
    manifest: Path,
    model: Path,
    files: SceneFiles,
    paths: list[Path],
    videos: list[Path],
    exposure: list[Path],
    shade: list[Path],
    parts: list[Path],
    page: Written,
    poster: Written,
) -> None:
    """Write the ``page`` and its ``poster``, a JPEG that other pages show.

    ``videos`` are the training cameras' footage, ``exposure`` the factors that divide their pictures, ``shade`` the
    shadows on the floor over time.
    """
    finished = read_finished(manifest, model, files, paths)
    held, factors = Bytes(), read_factors(exposure, finished.capture.frames)
    shaded = None
    for path in shade:
        shaded = read_shade(path, finished.room.count)
    data, sentences = describe_scene(finished, held, factors, shaded)
    if shaded is None and finished.people:
        sentences.append(
            "people cast no shadows here: the survey measured no moving shadows, or no light that explains them"
        )
    sentences += add_footage(held, data["cameras"], videos, finished.capture.frames, finished.capture.fps)
    picture = jpeg(render_poster(finished), QUALITY)
    with atomic_path(poster) as partial:
        partial.write_bytes(picture)
    write_text(
        page, build_page(f"{finished.name}: 4D scene", data | {"notes": [*sentences, *_ALWAYS]}, held, picture, parts)
    )
    for sentence in sentences:
        say(f"player: {sentence}")
    count = sum(entry["count"] for entry in data["sets"])
    say(
        f"the player holds {count} Gaussians, {len(finished.people)} people and {len(finished.things)} things over "
        f"{finished.capture.frames} frames in {page.stat().st_size / 1e6:.1f} MB: {page}"
    )
