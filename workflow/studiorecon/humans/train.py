# SPDX-License-Identifier: Apache-2.0
"""One person as Gaussians in the body's rest pose, trained on every training camera's frames.

Writes ``humans/<person>.ply`` (canonical Gaussians) and ``humans/<person>.npz`` (skinning, refined motion, provenance;
see ``body/avatar/avatar_files.py``).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon import code
from studiorecon.arrays import evenly_spread
from studiorecon.body.avatar.avatar_files import Avatar, write_avatar
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.posing import MAX_SH_DEGREE, Posing
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.avatar.weight_grid import WeightGrid, build_weight_grid, every_bone, strongest
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.humans.appearance import Appearance
from studiorecon.humans.colours import look, nearest_surface
from studiorecon.humans.crops import Crop
from studiorecon.humans.drift import decide_appearance, drifting_share, followed
from studiorecon.humans.filmed import read_crops
from studiorecon.humans.refined_motion import HELD, RefinedMotion
from studiorecon.humans.result_cache import STANDS, keep, mark_of, still_stands
from studiorecon.humans.surface_samples import (
    SurfaceSamples,
    fill_unseen,
    gaussians_on,
    mirrored,
    neighbours,
    started,
)
from studiorecon.humans.train_settings import Settings
from studiorecon.humans.training import PersonInTraining
from studiorecon.progress import say, warn
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.decisions import Decision
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import one_each
from studiorecon.scene.gaussians import Gaussians, sh_from_rgb
from studiorecon.scene.people import Person, read_people
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.signature import Place, Written
from studiorecon.splatting.cpu.harmonics import degree_supported
from studiorecon.splatting.device import resolve
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint
from studiorecon.splatting.train.perceptual import Perceptual
from studiorecon.splatting.train.terms import terms_of
from studiorecon.splatting.train.trainer import train

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

_BONES_KEPT = 4
_NEIGHBOURS = 8
# Pictures that colours start from: enough to see every side of a turning person, few enough to take a second.
_LOOKS = 160
# A Gaussian is measured when the weight of its looks passes that of one frontal look from 20 focal lengths per metre.
_SEEN_WEIGHT = 20.0
# Frame rate that the weight of the smoothness of poses refers to.
_POSE_FPS = 30.0


def skinning_weights(
    samples: SurfaceSamples,
    vertices_m: Float[np.ndarray, "V 3"],
    weights: Float[np.ndarray, "V 24"],
    settings: Settings,
) -> tuple[Integer[np.ndarray, "N K"], Float[np.ndarray, "N K"], WeightGrid | None]:
    """Joints (N, K) and weights (N, K): the surface's own four strongest, or all of the paper's voxel grid, and the
    grid.

    The grid mixes what is nearer than a voxel (3 cm at 64³), fingers and thighs among it (L06); the surface
    does not.
    """
    if settings.skinning == "surface":
        return *strongest(samples.weights, _BONES_KEPT), None
    grid = build_weight_grid(vertices_m, weights, settings.grid_resolution, settings.grid_margin)
    return *every_bone(grid, samples.points_m), grid


def first_colours(
    samples: SurfaceSamples, posing: Posing, motion: RefinedMotion, crops: Sequence[Crop]
) -> tuple[Float[np.ndarray, "N 3"], Bool[np.ndarray, " N"]]:
    """Colours (N, 3) float64 and ``seen`` (N,) bool from up to 160 crops spread over the clip; unseen rows are grey."""
    sums, weights = np.zeros_like(samples.points_m), np.zeros(len(samples.points_m))
    chosen = evenly_spread(len(crops), _LOOKS, below=True)
    points = samples.points_m.astype(np.float32)
    nothing = np.zeros((len(points), 1, 3), np.float32)
    unturned = np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1))
    for crop in (crops[i] for i in chosen):
        means, _, _ = posing.out(points, unturned, nothing, motion.transforms(crop.frame))
        normals = np.einsum("nab,nb->na", posing.turn, samples.normals)
        pixels, depth_m = crop.camera.project(means.astype(np.float64))
        # A disc covers about its spacing; the nearest surface has to close over the gaps between the points.
        reach = int(np.ceil(samples.spacing_m * np.mean(crop.camera.focal_px) / max(float(np.median(depth_m)), 0.1)))
        look(
            crop,
            means.astype(np.float64),
            normals,
            nearest_surface(pixels, depth_m, crop.camera.hw, reach),
            sums,
            weights,
        )
    seen = weights > _SEEN_WEIGHT
    return np.where(seen[:, None], sums / np.maximum(weights, 1e-12)[:, None], 0.5), seen


def supported_degree(settings: Settings, motion: RefinedMotion, crops: Sequence[Crop]) -> int:
    """``sh_degree``, with ``sh_cap`` at most what the directions tell apart from which the turning body is seen
    (G15)."""
    looks = [motion.local[c.frame, 0].T @ (c.camera.centre_m - motion.trans_m[c.frame]) for c in crops]
    return min(settings.sh_degree, degree_supported(np.array(looks))) if settings.sh_cap else settings.sh_degree


def recolour_unseen(
    trained: Gaussians, seen: Bool[np.ndarray, " N"], near: Integer[np.ndarray, "N K"], twin: Integer[np.ndarray, " N"]
) -> Gaussians:
    """The trained Gaussians with every unseen one's colour taken from its surroundings on the body; training showed it
    silhouettes only."""
    sh = np.where(seen[:, None, None], trained.sh, 0)
    sh[:, 0] = fill_unseen(trained.sh[:, 0], seen, near, twin)
    return replace(trained, sh=sh)


def run(
    settings: Settings,
    person: str,
    model: Path,
    manifest: Path,
    people: Path,
    videos: list[Path],
    masks: list[Path],
    fit: Path,
    body: Path,
    threads: int,
    gaussians: Written,
    avatar: Written,
    working: Place,
    device: str = "cpu",
    exposure: list[Path] | None = None,
    lpips: Place = Path("resources/weights/lpips"),
) -> None:
    """Train one person and write the avatar; pictures are divided by the gains and the light that ``exposure`` names,
    if any.

    Where nothing near the person has changed since the files were written, they stay (``unchanged``). A killed run goes
    on from its checkpoint. ``working`` is a folder of its own: the checkpoint, pictures of how it goes, and what was
    last trained; ``lpips`` holds the weights of the perceptual term.
    """
    device = resolve(device)
    cameras = read_model(model.parent)
    footage = read_manifest(manifest)
    one_each(cameras, videos=videos, masks=masks)
    if settings.sh_degree > MAX_SH_DEGREE:
        raise UserError(
            f"humans.sh_degree is {settings.sh_degree}; moving Gaussians rotate "
            f"harmonics up to degree {MAX_SH_DEGREE} only"
        )
    names = read_people(people)
    if person not in names:
        raise UserError(f"{person} is not among the people of {people} ({', '.join(names) or 'none'})")
    if settings.densify.use != "none" and settings.temporal.use != "never" and settings.temporal.points:
        raise UserError(
            "humans.densify.use is gradient, and humans.temporal.points asks the temporal network at points among a "
            "number of Gaussians that stays: set points to 0, or temporal.use to never"
        )
    fitted = read_person(fit)
    body_model = BodyModel.load(body)
    if fitted.body != body_model.identity:
        raise UserError(
            f"{fit} was fitted with the body model {fitted.body}, but {body} is "
            f"{body_model.identity}; fit {person} again"
        )
    even = read_factors(exposure or [], footage.frames)
    crops = read_crops(
        settings, cameras, videos, masks, fitted, body_model, names.index(person) + 1, footage.frames, working, even
    )
    if not crops:
        raise UserError(
            f"no training camera shows {settings.smallest_px} pixels of {person} in any frame "
            "with a fitted body; check the masks, or "
            "remove the person in people/identities.tsv"
        )
    # How often a checkpoint is made changes no byte of the result.
    trained_from = mark_of(
        replace(settings, checkpoint_every_s=0.0),
        crops,
        [fit, body],
        code.digest("humans.train"),
        threads,
        person,
        device,
    )
    if still_stands(trained_from, gaussians, avatar, working):
        say(
            f"{person}: nothing has changed in the {len(crops)} crops around {person}, the fit "
            f"and the settings; {STANDS}"
        )
        return
    rng = np.random.default_rng(settings.seed)
    rest = body_model.rest_vertices(fitted.betas)
    outside = np.array([name != "inside" for name in body_model.region_names])
    faces = body_model.faces[outside[body_model.region[body_model.faces[:, 0]]]]
    samples = started(rest, faces, body_model.weights, settings, rng)
    bones, weights, grid = skinning_weights(samples, rest, body_model.weights, settings)
    posing = Posing(bones, weights)
    held = () if settings.additions.pose_joints == "all" else HELD
    motion = RefinedMotion(fitted.poses, fitted.trans, body_model.rest_joints(fitted.betas), body_model.parents, held)
    colours, seen = first_colours(samples, posing, motion, crops)
    near, twin = neighbours(samples, _NEIGHBOURS), mirrored(samples, 2 * samples.spacing_m)
    degree = supported_degree(settings, motion, crops)
    if degree < settings.sh_degree:
        say(
            f"{person}: harmonics of degree {degree} instead of {settings.sh_degree}: the "
            "crops show too few sides of the body (sh_cap)"
        )
    start = gaussians_on(samples, degree)
    start.sh[:, 0] = sh_from_rgb(fill_unseen(colours, seen, near, twin))
    say(
        f"{person}: {len(crops)} crops in {len(cameras)} cameras; {seen.mean():.0%} of "
        f"{start.count} Gaussians are seen, the rest inferred"
    )
    inputs = [model.parent / "cameras.txt", model, manifest, people, *videos, *masks, fit, body, *(exposure or [])]
    mark = fingerprint(settings, inputs, code.digest("humans.train"), threads, person, device)
    checkpoint = Checkpoint(working / "checkpoint.npz", mark, settings.checkpoint_every_s)
    appearance = _appearance(settings, fitted, rest, seen, crops, samples, posing, motion)
    # A joint's speed is what is held: between frames that are further apart in time it turns further.
    losses = replace(settings.losses, pose=settings.losses.pose * (fitted.fps / _POSE_FPS) ** 2)
    subject = PersonInTraining(
        start,
        samples.spacing_m,
        posing,
        motion,
        crops,
        settings.iterations,
        settings.pose_from,
        losses,
        settings.rates,
        settings.limits,
        settings.near_m,
        threads,
        rng,
        appearance,
        device,
        settings.densify,
        settings.additions,
        grid,
    )
    terms = terms_of(losses, _network(settings, lpips, threads, device))
    span = 0, settings.iterations
    train(subject, terms, span, rng, label=person, checkpoint=checkpoint, previews=working)
    if subject.adam.refused:
        warn(f"{person}: {subject.adam.refused} gradient entries were not finite and were skipped")
    trained = subject.gaussians()
    source = subject.source
    if trained.count != start.count:
        say(f"{person}: {start.count} Gaussians became {trained.count}")
    if not np.array_equal(source, np.arange(start.count)):
        grown = SurfaceSamples(
            trained.means_m.astype(np.float64), samples.normals[source], samples.weights[source], samples.spacing_m
        )
        near, twin = neighbours(grown, _NEIGHBOURS), mirrored(grown, 2 * samples.spacing_m)
    seen, bones, weights = seen[source], subject.bones, subject.weights
    if settings.additions.unseen == "filled":
        trained = recolour_unseen(trained, seen, near, twin)
    moved_mm = 1000 * np.linalg.norm(trained.means_m - start.means_m[source], axis=1)
    far_mm = np.quantile(moved_mm, 0.99)
    say(
        f"{person}: Gaussians moved {np.median(moved_mm):.1f} mm from the body's surface in "
        f"the median, 99 % less than {far_mm:.0f} mm"
    )
    write_avatar(
        gaussians,
        avatar,
        Avatar(
            person=person,
            model=body_model,
            gaussians=trained,
            bones=bones,
            weights=weights,
            provenance=np.where(seen, MEASURED, INFERRED).astype(np.uint8),
            poses=motion.poses,
            trans=motion.trans_m,
            betas=fitted.betas,
            valid=fitted.valid,
            present=fitted.present,
            fps=fitted.fps,
            metric=fitted.metric,
            network=appearance.trained if appearance else None,
            decision=json.dumps(asdict(appearance.decision)) if appearance and appearance.decision else "",
        ),
        trained_from,
    )
    keep(gaussians, avatar, working)
    checkpoint.remove()


def _appearance(
    settings: Settings,
    fitted: Person,
    rest_m: np.ndarray,
    seen: np.ndarray,
    crops: Sequence[Crop],
    samples: SurfaceSamples,
    posing: Posing,
    motion: RefinedMotion,
) -> Appearance | None:
    """The temporal network in its box around the body, and what decides whether it takes part; None when it is not
    wanted."""
    if settings.temporal.use == "never":
        return None
    reach = settings.grid_margin * np.ptp(rest_m, axis=0).max()
    shape = settings.temporal.width, settings.temporal.layers
    # Its own generator: with and without it, the crops are drawn in the same order.
    rng = np.random.default_rng([settings.seed, 1])
    points = settings.temporal.points
    everywhere = settings.additions.unseen == "trained"
    acts_on = np.ones_like(seen) if everywhere else seen
    control = ControlPoints.on(samples.points_m[acts_on], points) if points and acts_on.any() else None
    network = TemporalNetwork.start(
        rest_m.min(axis=0) - reach,
        rest_m.max(axis=0) + reach,
        len(fitted.poses),
        rng,
        *shape,
        control,
        every_band=settings.temporal.bands == "all",
        everywhere=everywhere,
    )

    def judge(draw: Callable[[Crop], np.ndarray]) -> Decision:
        residual = followed(crops, draw, posing, motion, samples.points_m, samples.normals, samples.spacing_m)
        decision = decide_appearance(fitted.name, drifting_share(residual[seen]), settings.drift)
        say(f"temporal network: {decision.verdict}; {decision.reason}")
        return decision

    return Appearance(settings.temporal, network, acts_on, judge)


def _network(settings: Settings, lpips: Path, threads: int, device: str) -> Perceptual | None:
    """The network of the perceptual term where Gaussians are drawn; None when its weight is 0."""
    if settings.losses.lpips.weight == 0:
        say("LPIPS is off (humans.losses.lpips.weight is 0)")
        return None
    from studiorecon.models.adapters.lpips import read_lpips

    return read_lpips(lpips, threads, without="set humans.losses.lpips.weight to 0", device=device)
