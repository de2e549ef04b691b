# SPDX-License-Identifier: Apache-2.0
"""One person as Gaussians in the body's rest pose, trained on every training camera's frames.

Writes ``humans/<person>.ply`` (canonical Gaussians) and ``humans/<person>.npz`` (skinning, refined motion, provenance; see
``body/avatar.py``).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from studiorecon import code
from studiorecon.body.avatar import Avatar, write_avatar
from studiorecon.body.model import BodyModel
from studiorecon.body.posing import MAX_SH_DEGREE, Posing
from studiorecon.body.temporal import TemporalNetwork
from studiorecon.body.weight_grid import build_weight_grid, strongest
from studiorecon.errors import Refusal
from studiorecon.humans.appearance import Appearance, OverTime
from studiorecon.humans.colouring import look, nearest_surface
from studiorecon.humans.drift import decide_appearance, drifting_share, followed
from studiorecon.humans.footage import Crop, Look, judged, looks_of, mask_inset_px
from studiorecon.humans.motion import Motion
from studiorecon.humans.surface import SurfaceSamples, fill_unseen, gaussians_on, mirrored, neighbours, sample_surface
from studiorecon.humans.training import Limits, Losses, Rates, Support, train_gaussians
from studiorecon.humans.unchanged import keep, mark_of, still_stands
from studiorecon.images.video import read_frames
from studiorecon.progress import say
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.colmap import read_model
from studiorecon.scene.decisions import Decision
from studiorecon.scene.factors import NONE, Factors, read_factors
from studiorecon.scene.gaussians import Gaussians, sh_from_rgb
from studiorecon.scene.people import Person, read_people, read_person
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.splatting.checkpoint import Checkpoint, fingerprint
from studiorecon.splatting.device import resolve
from studiorecon.splatting.harmonics import degree_supported
from studiorecon.splatting.perceptual import Perceptual

_BONES_KEPT = 4
_NEIGHBOURS = 8
# Pictures that colours start from: enough to see every side of a turning person, few enough to take a second.
_LOOKS = 160
# A Gaussian is measured when the weight of its looks passes that of one frontal look from 20 focal lengths per metre.
_SEEN_WEIGHT = 20.0
# Frame rate that the weight of the smoothness of poses refers to.
_POSE_FPS = 30.0


@dataclass(frozen=True)
class Settings:
    """How a person is started and trained; see config.yaml."""

    gaussians: int
    sh_degree: int
    sh_cap: bool
    skinning: Literal["surface", "grid"]
    grid_resolution: int
    grid_margin: float
    iterations: int
    pose_from: int
    margin_px: int
    edge_px: int
    occluder_px: int
    smallest_px: int
    near_m: float
    checkpoint_every_s: float
    seed: int
    temporal: OverTime
    losses: Losses
    rates: Rates
    limits: Limits


def skinning_weights(
    samples: SurfaceSamples, vertices_m: np.ndarray, weights: np.ndarray, settings: Settings
) -> tuple[np.ndarray, np.ndarray]:
    """Joints (N, 4) and weights (N, 4): the surface's own, or those of the paper's voxel grid.

    The grid mixes what is nearer than a voxel (3 cm at 64³), fingers and thighs among it (numerics L06); the surface does not.
    """
    if settings.skinning == "surface":
        return strongest(samples.weights, _BONES_KEPT)
    grid = build_weight_grid(vertices_m, weights, settings.grid_resolution, settings.grid_margin)
    return strongest(grid.query(samples.points_m), _BONES_KEPT)


def first_colours(samples: SurfaceSamples, posing: Posing, motion: Motion, crops: Sequence[Crop]) -> tuple[np.ndarray, np.ndarray]:
    """Colours (N, 3) float64 and ``seen`` (N,) bool from up to 160 crops spread over the clip; unseen rows are grey."""
    sums, weights = np.zeros_like(samples.points_m), np.zeros(len(samples.points_m))
    chosen = np.unique(np.linspace(0, len(crops) - 1, min(_LOOKS, len(crops))).astype(int))
    points = samples.points_m.astype(np.float32)
    nothing = np.zeros((len(points), 1, 3), np.float32)
    for crop in (crops[i] for i in chosen):
        means, _, _ = posing.out(points, np.tile(np.float32([1, 0, 0, 0]), (len(points), 1)), nothing, motion.transforms(crop.frame))
        normals = np.einsum("nab,nb->na", posing.turn, samples.normals)
        pixels, depth_m = crop.camera.project(means.astype(np.float64))
        # A disc covers about its spacing; the nearest surface has to close over the gaps between the points.
        reach = int(np.ceil(samples.spacing_m * np.mean(crop.camera.focal_px) / max(float(np.median(depth_m)), 0.1)))
        look(crop, means.astype(np.float64), normals, nearest_surface(pixels, depth_m, crop.camera.hw, reach), sums, weights)
    seen = weights > _SEEN_WEIGHT
    return np.where(seen[:, None], sums / np.maximum(weights, 1e-12)[:, None], 0.5), seen


def supported_degree(settings: Settings, motion: Motion, crops: Sequence[Crop]) -> int:
    """``sh_degree``, with ``sh_cap`` at most what the directions tell apart from which the turning body is seen (numerics G15)."""
    looks = [motion.local[c.frame, 0].T @ (c.camera.centre_m - motion.trans_m[c.frame]) for c in crops]
    return min(settings.sh_degree, degree_supported(np.array(looks))) if settings.sh_cap else settings.sh_degree


def recolour_unseen(trained: Gaussians, seen: np.ndarray, near: np.ndarray, twin: np.ndarray) -> Gaussians:
    """The trained Gaussians with every unseen one's colour taken from its surroundings on the body; training showed it silhouettes only."""
    sh = np.where(seen[:, None, None], trained.sh, 0)
    sh[:, 0] = fill_unseen(trained.sh[:, 0], seen, near, twin)
    return replace(trained, sh=sh)


def run(
    settings: Settings, person: str, model: Path, manifest: Path, people: Path, videos: list[Path], masks: list[Path], fit: Path,
    body: Path, threads: int, gaussians: Path, avatar: Path, previews: Path | None = None, device: str = "cpu",
    exposure: list[Path] | None = None,
) -> None:  # fmt: skip
    """Train one person and write the avatar; pictures are divided by the gains and the light that ``exposure`` names, if any.

    Where nothing near the person has changed since the files were written, they stay (``unchanged``). A killed run goes on from
    ``.checkpoint`` beside ``gaussians``; pictures of how it goes are put into ``previews``.
    """
    device = resolve(device)
    cameras = read_model(model.parent)
    footage = read_manifest(manifest)
    if not len(cameras) == len(videos) == len(masks):
        raise Refusal(f"{len(videos)} videos and {len(masks)} masks for {len(cameras)} training cameras; one of each is needed per camera")
    if settings.sh_degree > MAX_SH_DEGREE:
        raise Refusal(f"humans.sh_degree is {settings.sh_degree}; moving Gaussians rotate harmonics up to degree {MAX_SH_DEGREE} only")
    names = read_people(people)
    if person not in names:
        raise Refusal(f"{person} is not among the people of {people} ({', '.join(names) or 'none'})")
    fitted = read_person(fit)
    body_model = BodyModel.load(body)
    if fitted.body != body_model.identity:
        raise Refusal(f"{fit} was fitted with the body model {fitted.body}, but {body} is {body_model.identity}; fit {person} again")
    even = read_factors(exposure or [], footage.frames)
    crops = read_crops(settings, cameras, videos, masks, fitted, body_model, names.index(person) + 1, footage.frames, even)
    if not crops:
        raise Refusal(
            f"no training camera shows {settings.smallest_px} pixels of {person} in any frame with a fitted body; check the masks, or "
            "remove the person in people/identities.tsv"
        )
    # How often a checkpoint is made changes no byte of the result.
    trained_from = mark_of(
        replace(settings, checkpoint_every_s=0.0), crops, [fit, body], code.digest("humans.train"), threads, person, device
    )
    if still_stands(trained_from, gaussians, avatar):
        say(
            f"{person}: nothing has changed in the {len(crops)} crops around {person}, the fit and the settings; the result stands as it is"
        )
        return
    rng = np.random.default_rng(settings.seed)
    rest = body_model.rest_vertices(fitted.betas)
    outside = np.array([name != "inside" for name in body_model.region_names])
    samples = sample_surface(
        rest, body_model.faces[outside[body_model.region[body_model.faces[:, 0]]]], body_model.weights, settings.gaussians, rng
    )
    bones, weights = skinning_weights(samples, rest, body_model.weights, settings)
    posing = Posing(bones, weights)
    motion = Motion(fitted.poses, fitted.trans, body_model.rest_joints(fitted.betas), body_model.parents)
    colours, seen = first_colours(samples, posing, motion, crops)
    near, twin = neighbours(samples, _NEIGHBOURS), mirrored(samples, 2 * samples.spacing_m)
    degree = supported_degree(settings, motion, crops)
    if degree < settings.sh_degree:
        say(f"{person}: harmonics of degree {degree} instead of {settings.sh_degree}: the crops show too few sides of the body (sh_cap)")
    start = gaussians_on(samples, degree)
    start.sh[:, 0] = sh_from_rgb(fill_unseen(colours, seen, near, twin))
    say(f"{person}: {len(crops)} crops in {len(cameras)} cameras; {seen.mean():.0%} of {start.count} Gaussians are seen, the rest inferred")
    inputs = [model.parent / "cameras.txt", model, manifest, people, *videos, *masks, fit, body, *(exposure or [])]
    mark = fingerprint(settings, inputs, code.digest("humans.train"), threads, person, device)
    checkpoint = Checkpoint(gaussians.parent / ".checkpoint" / f"{person}.npz", mark, settings.checkpoint_every_s)
    appearance = _appearance(settings, fitted, rest, seen, crops, samples, posing, motion)
    # A joint's speed is what is held: between frames that are further apart in time it turns further.
    losses = replace(settings.losses, pose=settings.losses.pose * (fitted.fps / _POSE_FPS) ** 2)
    trained = train_gaussians(
        start, samples.spacing_m, posing, motion, crops, settings.iterations, settings.pose_from, losses, settings.rates,
        settings.limits, settings.near_m, threads, rng, Support(_network(settings, threads), appearance, checkpoint, previews), device,
    )  # fmt: skip
    trained = recolour_unseen(trained, seen, near, twin)
    moved_mm = 1000 * np.linalg.norm(trained.means_m - start.means_m, axis=1)
    far_mm = np.quantile(moved_mm, 0.99)
    say(f"{person}: Gaussians moved {np.median(moved_mm):.1f} mm from the body's surface in the median, 99 % less than {far_mm:.0f} mm")
    write_avatar(gaussians, avatar, Avatar(
        person=person, model=body_model, gaussians=trained, bones=bones, weights=weights,
        provenance=np.where(seen, MEASURED, INFERRED).astype(np.uint8), poses=motion.poses, trans=motion.trans_m, betas=fitted.betas,
        valid=fitted.valid, fps=fitted.fps, metric=fitted.metric, network=appearance.trained if appearance else None,
        decision=json.dumps(asdict(appearance.decision)) if appearance and appearance.decision else "",
    ), trained_from)  # fmt: skip
    keep(gaussians, avatar)
    checkpoint.remove()


def _appearance(
    settings: Settings, fitted: Person, rest_m: np.ndarray, seen: np.ndarray, crops: Sequence[Crop], samples: SurfaceSamples,
    posing: Posing, motion: Motion,
) -> Appearance | None:  # fmt: skip
    """The temporal network in its box around the body, and what decides whether it takes part; None when it is not wanted."""
    if settings.temporal.use == "never":
        return None
    reach = settings.grid_margin * np.ptp(rest_m, axis=0).max()
    shape = settings.temporal.width, settings.temporal.layers
    # Its own generator: with and without it, the crops are drawn in the same order.
    rng = np.random.default_rng([settings.seed, 1])
    network = TemporalNetwork.start(rest_m.min(axis=0) - reach, rest_m.max(axis=0) + reach, len(fitted.poses), rng, *shape)

    def judge(draw: Callable[[Crop], np.ndarray]) -> Decision:
        residual = followed(crops, draw, posing, motion, samples.points_m, samples.normals, samples.spacing_m)
        decision = decide_appearance(fitted.name, drifting_share(residual[seen]))
        say(f"temporal network: {decision.verdict}; {decision.reason}")
        return decision

    return Appearance(settings.temporal, network, seen, judge)


def _network(settings: Settings, threads: int) -> Perceptual | None:
    """The network of the perceptual term; None when its weight is 0."""
    lpips = settings.losses.lpips
    if lpips.weight == 0:
        say("LPIPS is off (humans.losses.lpips.weight is 0)")
        return None
    from studiorecon.models.lpips import read_lpips

    return read_lpips(Path(lpips.weights), threads)


def read_crops(
    settings: Settings,
    cameras: Sequence,
    videos: list[Path],
    masks: list[Path],
    fitted: Person,
    body_model: BodyModel,
    label: int,
    frames: int,
    exposure: Factors = NONE,
) -> list[Crop]:
    """Every camera's crops of the person that masks call ``label``, camera by camera, of one exposure and light."""
    vertices = body_model.vertices(fitted.poses, fitted.betas, fitted.trans)
    looks: list[Look] = []
    for view, (camera, video, mask) in enumerate(zip(cameras, videos, masks)):
        pictures = exposure.even_all(camera.name, read_frames(video, 0, frames))
        looks += looks_of(
            view, camera, pictures, read_frames(mask, 0, frames), vertices, fitted.valid, label,
            settings.margin_px, settings.smallest_px,
        )  # fmt: skip
    inset_px = mask_inset_px(looks, label)
    if inset_px:
        say(f"{fitted.name}: the masks end {inset_px} px inside the fitted body; what lies between is taken for the person")
    return judged(looks, label, settings.edge_px, settings.occluder_px, inset_px)
