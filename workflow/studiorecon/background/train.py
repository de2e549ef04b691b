# SPDX-License-Identifier: Apache-2.0
"""Static Gaussians of the room, trained on clean plates and synthesized views.

Writes ``background/scene.ply`` and ``background/provenance.npz`` (``provenance``: per Gaussian, in PLY order, measured
/ inferred / invented as in ``scene/provenance.py``).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from studiorecon import code
from studiorecon.background import hole_filling
from studiorecon.background.refinement import refined_targets, refinement_cameras
from studiorecon.background.seeding import random_volume, seeds_from_depth
from studiorecon.background.targets import angle_between_axes, cutoff_angle, draw_shares, support_weight, view_weight
from studiorecon.background.train_settings import Settings
from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.footage.exr import read_depth
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frame, read_stack, to_float
from studiorecon.images.metrics import psnr
from studiorecon.images.regions import dilated
from studiorecon.progress import say
from studiorecon.scene.camera import Camera
from studiorecon.scene.factors import Factors, read_factors
from studiorecon.scene.files import one_each, write_npz
from studiorecon.scene.gaussians import Gaussians, concatenate
from studiorecon.scene.gaussians_ply import write_ply
from studiorecon.scene.path import PathStep, read_path
from studiorecon.scene.provenance import INFERRED, INVENTED, MEASURED
from studiorecon.scene.room import RoomBox, read_room
from studiorecon.signature import Place, Written
from studiorecon.splatting.cpu.harmonics import degree_supported
from studiorecon.splatting.device import rasteriser, resolve
from studiorecon.splatting.discs import discs
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint
from studiorecon.splatting.train.perceptual import Perceptual
from studiorecon.splatting.train.still import TrainedGaussians, train_still
from studiorecon.splatting.train.targets import Target, scene_extent

_FLATNESS = 0.15  # of a wall's discs
_WIDTH_SHARE = 0.75  # of the grid step: neighbours overlap enough to be opaque together
_FILL_OPACITY = 0.9
_SAME_PLACE_M, _SAME_ANGLE_RAD = 0.01, 0.01


@dataclass(frozen=True)
class Photo:
    """A training camera's clean plate: ``rgb`` (H, W, 3) float32, ``known`` (H, W) bool, ``depth_m`` and ``confidence``
    (H, W)."""

    camera: Camera
    rgb: np.ndarray
    known: np.ndarray
    depth_m: np.ndarray
    confidence: np.ndarray


def seeds(photos: Sequence[Photo], shell: RoomBox, settings: Settings) -> tuple[Gaussians, np.ndarray]:
    """First Gaussians and their provenance (N,) uint8: discs on measured depth, and on the shell where nobody sees
    it."""
    degree = settings.training.sh_degree
    sets, marks = [], []
    for photo in photos:
        made, at = seeds_from_depth(
            photo.camera,
            photo.rgb,
            photo.known,
            photo.depth_m,
            settings.stride,
            settings.seed_size,
            settings.seed_opacity,
            degree,
        )
        sure = photo.confidence[at[:, 0], at[:, 1]] > settings.measured_confidence
        sets.append(made)
        marks.append(np.where(sure, MEASURED, INFERRED))
    if settings.fill:
        faces = hole_filling.faces_of(shell)
        step_m = hole_filling.node_step(faces, settings.fill_step_m, settings.fill_limit)
        cameras, plates, known, depths = zip(*((p.camera, p.rgb, p.known, p.depth_m) for p in photos))
        for painted in hole_filling.paint(faces, cameras, plates, known, depths, step_m):
            unseen = ~painted.seen
            normals = np.tile(painted.face.normal, (int(unseen.sum()), 1))
            width_m = step_m * _WIDTH_SHARE
            sets.append(
                discs(painted.points_m[unseen], normals, painted.rgb[unseen], width_m, _FLATNESS, _FILL_OPACITY, degree)
            )
            marks.append(np.full(len(normals), INVENTED))
    return concatenate(sets), np.concatenate(marks).astype(np.uint8)


def supported(settings: Settings, start: Gaussians, cameras: Sequence[Camera], varied: bool = True) -> Settings:
    """The settings, with ``sh_cap`` with no more harmonics than the real cameras tell apart at the middle of the room.

    None at all unless colours are ``varied`` with the direction of view. Synthesized views are made of the photos and
    have no highlights of their own to add (G15).
    """
    middle_m = np.median(start.means_m, axis=0)
    degree = degree_supported(np.array([camera.centre_m - middle_m for camera in cameras])) if varied else 0
    if not settings.sh_cap or degree >= settings.training.sh_degree:
        return settings
    why = (
        f"{len(cameras)} cameras cannot tell more apart"
        if varied
        else "the survey finds no colour that changes with the view"
    )
    say(f"harmonics of degree {degree} instead of {settings.training.sh_degree}: {why} (sh_cap)")
    return replace(settings, training=replace(settings.training, sh_degree=degree))


def plate_targets(photos: Sequence[Photo], boost: float) -> list[Target]:
    """Every plate as a target, with its depth; a photo stands at distance 0 of itself, so its pixels weigh 1 +
    ``boost`` (U15, U16)."""
    weight = view_weight(0.0, cutoff_angle([p.camera for p in photos]), boost)
    return [Target(p.camera, p.rgb, p.known * np.float32(weight), depth_m=p.depth_m) for p in photos]


def view_targets(
    steps: Sequence[PathStep],
    pictures: Iterable[np.ndarray],
    supports: Iterable[np.ndarray],
    cameras: Sequence[Camera],
    settings: Settings,
) -> list[Target]:
    """Every synthesized view as a target; its weight falls with the angle to the nearest real camera (paper, appendix
    C).

    Views that stand where a photo does are left out: the photo is there already (U16).
    """
    cutoff = cutoff_angle(cameras)
    targets = []
    for step, rgb, support in zip(steps, pictures, supports, strict=True):
        nearest = min(angle_between_axes(step.camera, c) for c in cameras)
        beside = min(np.linalg.norm(step.camera.centre_m - c.centre_m) for c in cameras)
        if beside < _SAME_PLACE_M and nearest < _SAME_ANGLE_RAD:
            continue
        weight = view_weight(nearest, cutoff, settings.plate_boost)
        targets.append(
            Target(step.camera, to_float(rgb), support_weight(support, settings.hole_weight) * np.float32(weight))
        )
    return targets


def without_people(
    photos: Sequence[Photo], videos: Sequence[Path], masks: Sequence[Path], dilation_px: int, exposure: Factors
) -> list[Photo]:
    """The first pictures in the plates' place (paper, Eq. 5): unknown where a mask has anybody, or somebody is within
    the square of ``dilation_px``; without ``masks`` nobody is there."""
    one_each([p.camera for p in photos], videos=list(videos))
    if masks:
        one_each([p.camera for p in photos], masks=list(masks))
    seen = []
    for view, (photo, video) in enumerate(zip(photos, videos)):
        picture = to_float(exposure.even(photo.camera.name, read_frame(video, 0)))
        people = read_frame(masks[view], 0) > 0 if masks else np.zeros(photo.camera.hw, bool)
        for path, hw in ((video, picture.shape[:2]), (masks[view] if masks else video, people.shape)):
            if hw != photo.camera.hw:
                raise UserError(
                    f"{path} is {hw[1]}×{hw[0]} pixels, but camera {photo.camera.name} works at "
                    f"{photo.camera.wh[0]}×{photo.camera.wh[1]}"
                )
        known = ~dilated(people, dilation_px)
        if not known.any():
            raise UserError(
                f"camera {photo.camera.name} shows nothing but people at the first frame, {dilation_px} px about them "
                "included: set background.photos to plates"
            )
        say(
            f"{photo.camera.name}: {np.mean(~known):.1%} of the first picture is people and {dilation_px} px about them"
        )
        seen.append(replace(photo, rgb=picture, known=known))
    return seen


def _read_photos(cameras: Sequence[Camera], plates: list[Path], depth: list[Path], exposure: Factors) -> list[Photo]:
    one_each(cameras, plates=plates, depth_maps=depth)
    photos = []
    for camera, plate_path, depth_path in zip(cameras, plates, depth):
        rgb, known = read_plate(plate_path)
        depth_m, confidence = read_depth(depth_path)
        for name, hw in ((plate_path, rgb.shape[:2]), (depth_path, depth_m.shape)):
            if hw != camera.hw:
                raise UserError(
                    f"{name} is {hw[1]}×{hw[0]} pixels, but camera {camera.name} works at {camera.wh[0]}×{camera.wh[1]}"
                )
        if not known.any():
            raise UserError(
                f"{plate_path} has no measured pixel; give a clean plate of camera {camera.name} in plates/"
            )
        photos.append(Photo(camera, exposure.even(camera.name, rgb), known, depth_m, confidence))
    return photos


def _read_views(
    path: Path, views: list[Path], supports: list[Path], cameras: Sequence[Camera], settings: Settings
) -> list[Target]:
    """All synthesized views; none when their share of the draws is 0, or there are none."""
    if settings.views_share == 0 or not views:
        return []
    steps, _ = read_path(path)
    segments = list(dict.fromkeys(step.segment for step in steps))
    if not len(segments) == len(views) == len(supports):
        raise UserError(
            f"{path} has {len(segments)} segments, but there are {len(views)} view videos and "
            f"{len(supports)} masks; make views again"
        )
    targets = []
    for segment, video, mask in zip(segments, views, supports):
        own = [step for step in steps if step.segment == segment]
        targets += view_targets(own, read_stack(video, 0, len(own)), read_stack(mask, 0, len(own)), cameras, settings)
    return targets


def _plate_scores(
    gaussians: Gaussians, photos: Sequence[Photo], settings: Settings, threads: int, device: str
) -> list[float]:
    """PSNR of every plate on its measured pixels, dB."""
    drawing = rasteriser(device, near_m=settings.training.near_m, threads=threads)
    return [psnr(drawing.forward(gaussians, p.camera).rgb, p.rgb, p.known) or 0.0 for p in photos]


def _refined(
    room_now: Gaussians,
    photos: Sequence[Photo],
    cameras: Sequence[Camera],
    settings: Settings,
    threads: int,
    device: str,
) -> list[Target]:
    """Enhanced views of the half-trained room."""
    looks = refinement_cameras(cameras, settings.refinement)
    known = [(p.camera, p.rgb, p.known) for p in photos]
    drawing = rasteriser(device, near_m=settings.training.near_m, threads=threads)
    targets, counted = refined_targets(
        looks, known, settings.refinement, lambda camera: drawing.forward(room_now, camera)
    )
    say(f"refinement: {len(targets)} views of the room as it is now; the photos correct {counted:.0%} of their pixels")
    return targets


def _fitted(
    settings: Settings,
    rng: np.random.Generator,
    cameras: Sequence[Camera],
    threads: int,
    device: str,
    previews: Path | None,
    lpips: Path,
    start: Gaussians,
    real: list[Target],
    synthesized: list[Target],
    checkpoint: Checkpoint,
    span: tuple[int, int],
) -> TrainedGaussians:
    """The iterations of ``span`` on plates and views, drawn as ``views_share`` says."""
    shares = draw_shares(len(real), len(synthesized), settings.views_share)
    targets = [replace(target, share=float(share)) for target, share in zip(real + synthesized, shares)]
    return train_still(
        start,
        targets,
        settings.training,
        rng,
        extent_m=scene_extent(cameras),
        span=span,
        threads=threads,
        label="background",
        network=_network(settings, lpips, threads),
        checkpoint=checkpoint,
        previews=previews,
        device=device,
    )


def _network(settings: Settings, lpips: Path, threads: int) -> Perceptual | None:
    """The network of the perceptual term; None when its weight is 0."""
    if settings.training.lpips.weight == 0:
        say("LPIPS is off (background.training.lpips.weight is 0)")
        return None
    from studiorecon.models.adapters.lpips import read_lpips

    return read_lpips(lpips, threads, without="set background.training.lpips.weight to 0")


def run(
    settings: Settings,
    model: Path,
    plates: list[Path],
    depth: list[Path],
    shell: Path,
    path: Path,
    views: list[Path],
    supports: list[Path],
    threads: int,
    background: Written,
    provenance: Written,
    working: Place,
    device: str = "cpu",
    exposure: list[Path] | None = None,
    gloss: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
    videos: list[Path] | None = None,
    masks: list[Path] | None = None,
) -> None:
    """Train the background and write it with its provenance; plates are divided by the gains that ``exposure`` names,
    if any.

    With ``photos`` "first_frames" the first pictures of ``videos`` are trained on, without those whom ``masks`` show.
    Without a file in ``gloss`` the survey does not call for colours that change with the view; None: it was not asked.

    ``working`` is a folder of its own: pictures of how it goes, and what a killed run goes on from; ``lpips`` holds the
    weights of the perceptual term.
    """
    device = resolve(device)
    cameras = read_model(model.parent)
    box = read_room(shell)
    factors = read_factors(exposure or [])
    photos = _read_photos(cameras, plates, depth, factors)
    if settings.photos == "first_frames":
        photos = without_people(photos, videos or [], masks or [], settings.dilation_px, factors)
    rng = np.random.default_rng(settings.seed)
    if settings.start == "depth":
        start, marks = seeds(photos, box, settings)
        shares = [int((marks == kind).sum()) for kind in (MEASURED, INFERRED, INVENTED)]
        say(
            f"{start.count} Gaussians to start from: {shares[0]} measured, {shares[1]} on "
            f"default walls, {shares[2]} where nobody sees"
        )
    else:
        start = random_volume(cameras, settings.random_count, settings.random_size_m, settings.training.sh_degree, rng)
        marks = np.full(start.count, MEASURED, np.uint8)
        say(f"{start.count} Gaussians to start from, anywhere: the baseline that knows nothing but the photos")
    settings = supported(settings, start, cameras, gloss is None or len(gloss) > 0)
    real, synthesized = (
        plate_targets(photos, settings.plate_boost),
        _read_views(path, views, supports, cameras, settings),
    )
    drawn = settings.views_share if synthesized else 0.0
    say(f"{len(real)} plates and {len(synthesized)} synthesized views, the latter in {drawn:.0%} of the steps")
    inputs = [model.parent / "cameras.txt", model, *plates, *depth, shell, path, *views, *supports, *(exposure or [])]
    inputs += [*(videos or []), *(masks or [])]
    mark = fingerprint(settings, inputs, code.digest("background.train"), threads, device)
    half, whole = (
        Checkpoint(working / name, mark, settings.training.checkpoint_every_s)
        for name in ("half.checkpoint.npz", "checkpoint.npz")
    )
    fit = partial(_fitted, settings, rng, cameras, threads, device, working, lpips)
    split = round(settings.refinement.at * settings.training.iterations) if settings.refinement.views else 0
    if split:
        first = fit(start, real, synthesized, half, (0, split))
        start, marks = first.gaussians, marks[first.source]
        synthesized += _refined(start, photos, cameras, settings, threads, device)
    trained = fit(start, real, synthesized, whole, (split, settings.training.iterations))
    marks = marks[trained.source]
    scores = _plate_scores(trained.gaussians, photos, settings, threads, device)
    say(
        f"{trained.gaussians.count} Gaussians after training; plates at {np.mean(scores):.2f} "
        f"dB on average, {min(scores):.2f} at worst"
    )
    write_ply(background, trained.gaussians)
    write_npz(provenance, {"provenance": marks})
    half.remove()
    whole.remove()
