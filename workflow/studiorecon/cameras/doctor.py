# SPDX-License-Identifier: Apache-2.0
"""``cameras.doctor``: before anything expensive, does the calibration fit the people, and what does the capture lack?"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from studiorecon.cameras import health
from studiorecon.cameras.correspondences import observe, spread_frames
from studiorecon.cameras.hypotheses import verdicts
from studiorecon.cameras.refine import error_medians
from studiorecon.cameras.sheet import contact_sheet
from studiorecon.errors import Refusal
from studiorecon.geometry.lens import calibration_from_video_pixels, working_from_video
from studiorecon.geometry.triangulation import Limits
from studiorecon.progress import say
from studiorecon.scene.camera import Camera, Lens
from studiorecon.scene.dataset import PICTURE_SUFFIXES
from studiorecon.scene.files import read_json, write_json, write_text
from studiorecon.scene.people import Detections, read_detections

_FRAMES = 24
_LAG_FRAMES = 6
_CLEAR_MARGIN = 1.5


@dataclass(frozen=True)
class Settings:
    """The section ``cameras`` as far as the doctor reads it; as in ``refine``."""

    refine_gate_m: float
    max_error_share: float
    limits: Limits


def examined(
    cameras: Sequence[Camera], detections: Sequence[Detections], about: Sequence[dict[str, Any]], settings: Settings
) -> tuple[dict[str, Any], np.ndarray]:
    """The report (what goes into doctor.json, with ``advice`` as sentences) and the triangulated points (N, 3)."""
    frames = min(int(a["frames"]) for a in about)
    chosen = spread_frames(frames, _FRAMES)
    table, margins = verdicts(cameras, detections, chosen[:: max(1, len(chosen) // 6)], settings.refine_gate_m)
    seen, _ = observe(detections, cameras, chosen, settings.refine_gate_m)
    median, each, points = (
        error_medians(cameras, seen, settings.limits) if len(seen.frame) else (None, [None] * len(cameras), np.zeros((0, 3)))
    )
    middle = np.median(points[:, :2], axis=0) if len(points) else np.mean([c.centre_m[:2] for c in cameras], axis=0)
    reach = float(np.quantile(np.linalg.norm(points[:, :2] - middle, axis=-1), 0.95)) + 0.5 if len(points) else 2.0
    found_lags = health.lags(detections, cameras, _LAG_FRAMES, settings.refine_gate_m)
    report: dict[str, Any] = {
        "cameras": [c.name for c in cameras],
        "hypotheses": table,
        "margin": dict(zip([c.name for c in cameras], margins)),
        "median_px": median,
        "px_per_camera": dict(zip([c.name for c in cameras], each)),
        "lags_frames": {lag.camera: {"frames": lag.frames, "low": lag.low, "high": lag.high, "valid": lag.valid} for lag in found_lags},
        "footage": {a["camera"]: a for a in about},
        "coverage": dict(zip(("1", "2", "3", "4"), health.coverage(cameras, middle, reach))),
        "blind_sectors_deg": health.blind_sectors(cameras, middle),
    }
    return {**report, "advice": advice(report, max(max(c.wh) for c in cameras), settings)}, points


def advice(report: dict[str, Any], longest_px: int, settings: Settings) -> list[str]:
    """What to check, in sentences; empty when nothing is wrong."""
    found = []
    best = max(report["hypotheses"], key=lambda row: row["score"])
    if best["hypothesis"] != "as read":
        found.append(f"people fit better if {best['hypothesis']}: {best['remedy']}")
    for camera, margin in report["margin"].items():
        if margin is not None and margin < _CLEAR_MARGIN:
            found.append(
                f"camera {camera}: its convention is not clear (margin {margin:.2f}); check its pose, or bring more frames of people"
            )
    if report["median_px"] is None:
        found.append(
            "no person of any two cameras fits: the calibration could not be checked; is it for these cameras, in metres, synchronised?"
        )
    elif report["median_px"] > settings.max_error_share * longest_px:
        found.append(f"people are {report['median_px']:.0f} px off in the median: the calibration is of other cameras or another zoom")
    for camera, lag in report["lags_frames"].items():
        if lag["valid"] and not lag["low"] <= 0 <= lag["high"]:
            found.append(f"camera {camera} is {lag['frames']:+.1f} frames late ({lag['low']:+.1f} to {lag['high']:+.1f}); cut its video")
    footage = report["footage"].values()
    for key, what in (("fps", "frame rates"), ("video_frames", "lengths"), ("rotation_deg", "rotation tags")):
        values = {a["camera"]: a.get(key) for a in footage}
        if len(set(values.values())) > 1:
            found.append(f"the {what} differ: " + ", ".join(f"{c} {v}" for c, v in values.items()))
    light = {a["camera"]: a["brightness"] for a in footage}
    if max(light.values()) > 1.5 * max(min(light.values()), 1e-3):
        found.append("exposures differ: mean grey " + ", ".join(f"{c} {v:.2f}" for c, v in light.items()))
    if report["coverage"]["2"] < 0.5:
        found.append(f"only {report['coverage']['2']:.0%} of the volume is seen by two cameras: people there cannot be measured")
    return found


def page(scene: str, report: dict[str, Any], sheet_png: bytes) -> str:
    """One self-contained HTML page."""
    rows = "".join(
        f"<tr><td>{html.escape(c)}</td><td>{_number(report['px_per_camera'][c], '.1f')}</td><td>{_number(report['margin'][c], '.2f')}</td>"
        f"<td>{_lag(report['lags_frames'][c])}</td><td>{a['wh'][0]}×{a['wh'][1]}</td><td>{a['fps']:g}</td><td>{a['video_frames']}</td>"
        f"<td>{a['rotation_deg']}°</td><td>{a['brightness']:.2f}</td></tr>"
        for c, a in report["footage"].items()
    )
    readings = "".join(f"<tr><td>{html.escape(h['hypothesis'])}</td><td>{h['score']:.3f}</td></tr>" for h in report["hypotheses"])
    items = "".join(f"<li>{html.escape(a)}</li>" for a in report["advice"]) or "<li>Nothing to check.</li>"
    covered = ", ".join(f"≥ {n}: {v:.0%}" for n, v in report["coverage"].items())
    blind = ", ".join(f"{a:.0f}° to {b % 360:.0f}°" for a, b in report["blind_sectors_deg"]) or "none"
    picture = base64.b64encode(sheet_png).decode("ascii")
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Doctor: {html.escape(scene)}</title><style>'
        "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1200px;padding:0 1rem;color:#222}img{max-width:100%}"
        "table{border-collapse:collapse}td,th{padding:.2rem .8rem;border-bottom:1px solid #ddd;text-align:left}</style>"
        f"<h1>Cameras of {html.escape(scene)}</h1><h2>What to check</h2><ul>{items}</ul>"
        f'<p><img alt="cameras with reprojected people, and from above" src="data:image/png;base64,{picture}"></p>'
        "<h2>Cameras</h2><table><tr><th>camera</th><th>px off</th><th>margin</th><th>lag, frames</th><th>size</th><th>fps</th>"
        f"<th>frames</th><th>rotation tag</th><th>mean grey</th></tr>{rows}</table>"
        f"<h2>How the poses could be read</h2><table><tr><th>reading</th><th>agreement of people's rays</th></tr>{readings}</table>"
        f"<p>Share of the volume around the people seen by cameras: {covered}. Blind sectors wider than 90°: {blind}.</p></html>\n"
    )


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _lag(lag: dict[str, Any]) -> str:
    return f"{lag['frames']:+.1f} ({lag['low']:+.1f} to {lag['high']:+.1f})" if lag["valid"] else "undetermined"


def first_picture(source: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """First frame (H, W, 3) uint8 RGB, upright, and what the header says: fps, frames, rotation tag."""
    if source.is_dir():
        files = sorted(p for p in source.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and not p.name.startswith("."))
        picture = cv2.imread(str(files[0])) if files else None
        if picture is None:
            raise Refusal(f"{source} holds no readable picture")
        return picture[..., ::-1], {"fps": 0.0, "video_frames": len(files), "rotation_deg": 0}
    with av.open(str(source)) as container:
        stream = container.streams.video[0]
        frame = next(container.decode(stream))
        turn = round(frame.rotation / 90) * 90 % 360
        picture = np.rot90(frame.to_ndarray(format="rgb24"), turn // 90)
        return np.ascontiguousarray(picture), {"fps": float(stream.average_rate or 0), "video_frames": stream.frames, "rotation_deg": turn}


def undistorted(seen: Detections, lens: Lens, wh: tuple[int, int]) -> tuple[Camera, Detections]:
    """The pinhole camera of the video's size, and the sightings in its pixels; points that the lens cannot have seen are dropped."""
    affine = calibration_from_video_pixels(lens, wh)
    intrinsics = np.diag([lens.intrinsics[0, 0] / affine[0, 0], lens.intrinsics[1, 1] / affine[1, 1], 1.0])
    intrinsics[:2, 2] = (lens.intrinsics[:2, 2] - affine[:, 2]) / np.diag(affine)
    present = seen.keypoints[..., 2] > 0
    pixels, valid = working_from_video(np.where(present[..., None], seen.keypoints[..., :2], 1.0), lens, wh, intrinsics)
    points = np.concatenate(
        [np.where((present & valid)[..., None], pixels, np.nan), np.where(present & valid, seen.keypoints[..., 2], 0.0)[..., None]], -1
    )
    return Camera(seen.camera, wh, intrinsics, lens.camera_from_world), Detections(seen.camera, seen.layout, seen.frame, seen.track, points)


def run(
    settings: Settings,
    scene: str,
    calibration: Path,
    sightings: list[Path],
    sizes: list[Path],
    sources: list[Path],
    report: Path,
    doctor: Path,
) -> None:
    """Write ``report`` (JSON) and ``doctor`` (HTML) for the cameras of ``sightings``; ``sources`` are their videos, in the same order."""
    lenses = {v["name"]: Lens.from_json(v) for v in read_json(calibration)["lenses"]}
    cameras, detections, pictures, about = [], [], [], []
    for npz, size, source in zip(sightings, sizes, sources, strict=True):
        seen, facts = read_detections(npz), read_json(size)
        picture, header = first_picture(source)
        wh = (picture.shape[1], picture.shape[0])
        camera, found = undistorted(seen, lenses[seen.camera], wh)
        cameras.append(camera)
        detections.append(found)
        pictures.append(picture)
        about.append(
            {"camera": seen.camera, "wh": list(wh), "frames": facts["frames"], "brightness": float(picture.mean() / 255), **header}
        )
    result, points = examined(cameras, detections, about, settings)
    shown = {"after_px_per_camera": [result["px_per_camera"][c.name] for c in cameras]}
    sheet = contact_sheet(cameras, [], pictures, points, shown)
    png = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes()
    write_json(report, result)
    write_text(doctor, page(scene, result, png))
    for sentence in result["advice"] or ["nothing to check"]:
        say(sentence)
    say(f"the page is {doctor}")
