# SPDX-License-Identifier: Apache-2.0
"""``report.score``: how good the result is, where that can be measured: ``metrics.json``.

Pictures are compared with the held-out cameras' photos, bodies with exact truth where there is any. Every number comes with its raw
values per frame; what could not be measured is null with the reason.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from studiorecon.errors import Refusal
from studiorecon.images.flow import one_thread
from studiorecon.images.seeking import read_frames_from
from studiorecon.images.video import read_frames
from studiorecon.progress import progress, say
from studiorecon.report.bodies import compare_bodies
from studiorecon.report.measures import NAMES, REGIONS, TEMPORAL, Flicker, measure_picture, summary, unmeasured
from studiorecon.report.pictures import truth_shares
from studiorecon.report.truth import read_views, regions, true_joints
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.files import write_json
from studiorecon.scene.path import read_path
from studiorecon.scene.people import read_person

_FLOW = "medium"
_NO_HELD_OUT = "no camera is held out: name some under held_out in capture.yaml"
_NO_TRUTH = "there is no exact truth (only a made studio has it)"
_PHOTO = "photo"


@dataclass(frozen=True)
class Settings:
    seen_tolerance: float


def measure_camera(
    photos: Path, versions: Mapping[str, tuple[Path, int]], frames: int, regions_of_frames: Iterable[Mapping[str, np.ndarray]]
) -> dict[str, list[dict]]:
    """Measures per frame of each version (video, first frame) of one held-out camera, and the flicker of the photos themselves."""
    streams = {name: read_frames_from(path, first, first + frames) for name, (path, first) in versions.items()}
    flicker, found = Flicker(_FLOW), {name: [] for name in (*versions, _PHOTO)}
    with ThreadPoolExecutor(max_workers=len(versions)) as pool:
        for photo, masks in zip(read_frames(photos, 0, frames), regions_of_frames):
            # Films of cameras of different sizes share one size; a camera's own picture is the top left part.
            pictures = {name: next(stream)[: photo.shape[0], : photo.shape[1]] for name, stream in streams.items()}
            still = pool.map(lambda picture: measure_picture(picture, photo, masks), pictures.values())  # noqa: B023
            moving = flicker.measure(photo, {**pictures, _PHOTO: photo})
            for name, values in zip(pictures, still):
                found[name].append({**values, **moving[name]})
            found[_PHOTO].append(moving[_PHOTO])
    return found


def collect_measures(
    per_camera: Mapping[str, Sequence[Mapping[str, float | None]]], names: Sequence[str], reasons: Mapping[str, str]
) -> dict:
    """The summary of each named measure over cameras; ``reasons`` says why one may be missing."""
    return {
        name: summary({camera: [frame.get(name) for frame in frames] for camera, frames in per_camera.items()}, reasons.get(name, ""))
        for name in names
    }


def missing_reasons(have_truth: bool) -> dict[str, str]:
    """Why a measure of a region or of time may be null."""
    region = _NO_TRUTH if not have_truth else "no frame shows at least 256 pixels of it"
    reasons = {f"{measure}_{name}": region for name in REGIONS for measure in ("psnr", "ssim")}
    return (
        reasons
        | dict.fromkeys(TEMPORAL, "needs at least two frames")
        | dict.fromkeys(("ssim", "ssim_3dgs"), "pictures are under 11 pixels")
    )


def score_pictures(
    frames: int,
    cameras: Sequence[Camera],
    videos: Mapping[str, Path],
    versions: Mapping[str, tuple[Path, dict[str, int]]],
    regions_of: Callable[[Camera], Iterable[Mapping[str, np.ndarray]]] | None,
) -> dict[str, Any]:
    """Measures of every version against the held-out photos; a version is a video and the first frame of each camera in it."""
    if not cameras or not versions:
        return {name: {measure: unmeasured(_NO_HELD_OUT) for measure in NAMES} for name in ("raw", "enhanced")}
    measured: dict[str, dict[str, list]] = {}
    for camera in progress(cameras, "held-out cameras"):
        of_camera = {name: (path, starts[camera.name]) for name, (path, starts) in versions.items()}
        masks = regions_of(camera) if regions_of is not None else repeat({})
        for name, values in measure_camera(videos[camera.name], of_camera, frames, masks).items():
            measured.setdefault(name, {})[camera.name] = values
    reasons = missing_reasons(regions_of is not None)
    result = {name: collect_measures(measured[name], NAMES, reasons) for name in versions}
    result[_PHOTO] = collect_measures(measured[_PHOTO], TEMPORAL, reasons)
    return result


def score_bodies(fits: Sequence[Path], truth: Path | None, first_frame: int) -> dict[str, Any]:
    """Joint errors of the fits against the true bodies, or the reason there are none."""
    nothing = {f"mpjpe_{kind}_mm": None for kind in ("world", "pelvis", "similarity")}
    if truth is None:
        return {**nothing, "people": {}, "missed": [], "invented": [], "reason": _NO_TRUTH}
    fitted = {person.name: (person.joints, person.valid) for person in map(read_person, fits)}
    true = {name: joints[first_frame:] for name, joints in true_joints(truth).items()}
    if not true:
        return {**nothing, "people": {}, "missed": [], "invented": sorted(fitted), "reason": "nobody is in the scene"}
    return compare_bodies(fitted, true)


def coverage(truth_maps: Sequence[Path]) -> dict[str, Any]:
    """Share of each shot's pixels that is measured, inferred, invented: mean over pictures."""
    result = {}
    for path in truth_maps:
        shares = [truth_shares(frame) for frame in read_frames(path)]
        result[path.name.split(".")[0]] = {name: float(np.mean([s[name] for s in shares])) for name in ("measured", "inferred", "invented")}
    return result


def run(
    settings: Settings,
    scene: str,
    manifest: Path,
    model: Path,
    heldout_model: Path,
    videos: list[Path],
    render: list[Path],
    render_path: list[Path],
    enhanced: list[Path],
    truth_maps: list[Path],
    fits: list[Path],
    metrics: Path,
    truth: Path | None = None,
) -> None:
    """Measure; ``videos`` is the held-out cameras' footage, ``render`` and ``enhanced`` are the shot heldout, if there is one."""
    capture = read_manifest(manifest)
    held_out = read_model(heldout_model.parent)
    if truth is not None and not truth.is_dir():
        raise Refusal(f"{truth} is not a folder of exact truth; make the studio again, or leave --truth out")
    versions = {}
    for name, files in (("raw", render), ("enhanced", enhanced)):
        if files and render_path:
            versions[name] = (files[0], _first_frames(render_path[0]))
    first_frame = capture.footage[0].first_source_frame
    regions_of = None
    if truth is not None:
        views, training = read_views(truth), [camera.name for camera in read_model(model.parent)]

        def regions_of(camera: Camera) -> Iterator[dict[str, np.ndarray]]:
            return regions(views, camera, training, first_frame, capture.frames, settings.seen_tolerance)

    with one_thread():
        pictures = score_pictures(capture.frames, held_out, {v.stem: v for v in videos}, versions, regions_of)
    bodies = score_bodies(fits, truth, first_frame)
    write_json(
        metrics,
        {
            "scene": scene,
            "pictures": pictures,
            "bodies": bodies,
            "coverage": coverage(truth_maps),
            "lpips": unmeasured("the weights of the LPIPS network are not part of this project"),
            "libraries": {"python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__},
            "protocol": "held-out cameras; 8-bit pictures; mean over frames, then over cameras; never pooled",
        },
    )
    _tell(pictures, bodies)


def _first_frames(path: Path) -> dict[str, int]:
    starts: dict[str, int] = {}
    for index, step in enumerate(read_path(path)[0]):
        starts.setdefault(step.segment, index)
    return starts


def _tell(pictures: dict[str, Any], bodies: dict[str, Any]) -> None:
    for name in ("raw", "enhanced"):
        values = pictures.get(name, {}).get("psnr", unmeasured(_NO_HELD_OUT))
        if values["value"] is None:
            say(f"{name} pictures are not measured: {values['reason']}")
        else:
            say(f"{name} pictures at held-out cameras: PSNR {values['value']:.2f} dB, SSIM {pictures[name]['ssim']['value']:.4f}")
    if bodies["mpjpe_world_mm"] is None:
        say(f"joint errors are not measured: {bodies['reason']}")
    else:
        say(f"joints are off by {bodies['mpjpe_world_mm']:.1f} mm in the mean, over {len(bodies['people'])} people")
