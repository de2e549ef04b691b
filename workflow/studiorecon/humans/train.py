# SPDX-License-Identifier: Apache-2.0
"""One person as Gaussians in the body's rest pose, trained on every training camera's frames.

Writes ``humans/<person>.ply`` (canonical Gaussians) and ``humans/<person>.npz`` (skinning, refined motion, provenance;
see ``body/avatar/avatar_files.py``).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon import code
from studiorecon.body.avatar.avatar_files import Avatar, write_avatar
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.temporal import TemporalNetwork
from studiorecon.body.hands import posed_skeleton
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.errors import UserError
from studiorecon.humans.appearance import Appearance
from studiorecon.humans.crop_reader import read_crops
from studiorecon.humans.crops import Crop
from studiorecon.humans.drift import decide_appearance, drifting_share, track_brightness
from studiorecon.humans.rest_pose import NEIGHBOURS, RestPose, build_rest_pose
from studiorecon.humans.result_cache import UP_TO_DATE, cache_key, is_up_to_date, store_result
from studiorecon.humans.surface_samples import (
    fill_unseen,
    mirror_indices,
    surface_neighbours,
)
from studiorecon.humans.train_settings import Losses, Settings
from studiorecon.humans.training import PersonInTraining
from studiorecon.progress import say, warn
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.decisions import Decision
from studiorecon.scene.factors import read_factors
from studiorecon.scene.files import require_one_each
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.people import Person, read_people
from studiorecon.scene.provenance import INFERRED, MEASURED
from studiorecon.signature import Place, Written
from studiorecon.splatting.device import resolve
from studiorecon.splatting.train.checkpoint import Checkpoint, fingerprint
from studiorecon.splatting.train.perceptual import Perceptual
from studiorecon.splatting.train.terms import active_terms
from studiorecon.splatting.train.trainer import train

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer


def recolour_unseen(
    trained: Gaussians, seen: Bool[np.ndarray, " N"], near: Integer[np.ndarray, "N K"], twin: Integer[np.ndarray, " N"]
) -> Gaussians:
    """The trained Gaussians, with colours from their surroundings for those trained on silhouettes only."""
    sh = np.where(seen[:, None, None], trained.sh, 0)
    sh[:, 0] = fill_unseen(trained.sh[:, 0], seen, near, twin)
    return replace(trained, sh=sh)


@dataclass(frozen=True)
class Sources:
    """Input files of a person's training: films, masks, the fit and its body model, gains and light (``exposure``)."""

    model: Path
    manifest: Path
    people: Path
    videos: list[Path]
    masks: list[Path]
    fit: Path
    body: Path
    exposure: list[Path] = field(default_factory=list)

    def files(self) -> list[Path]:
        """All of them, in an order that does not change."""
        cameras = [self.model.parent / "cameras.txt", self.model]
        return [*cameras, self.manifest, self.people, *self.videos, *self.masks, self.fit, self.body, *self.exposure]


def run(
    settings: Settings,
    person: str,
    sources: Sources,
    threads: int,
    gaussians: Written,
    avatar: Written,
    working: Place,
    device: str = "cpu",
    lpips: Place = Path("resources/weights/lpips"),
) -> None:
    """Train one person and write the avatar.

    Files stay if nothing near the person has changed since (``result_cache``). A killed run resumes at its checkpoint.
    ``working`` is a folder of its own: the checkpoint, preview pictures, and the last result; ``lpips`` holds the
    weights of the perceptual term.
    """
    device = resolve(device)
    fitted, body_model = _read_fit(sources.fit, sources.body)
    crops = _crops(settings, person, sources, fitted, body_model, working)
    about = code.digest("humans.train"), threads, person, device
    # The interval of checkpoints changes no byte of the result.
    trained_from = cache_key(replace(settings, checkpoint_every_s=0.0), crops, [sources.fit, sources.body], *about)
    if is_up_to_date(trained_from, gaussians, avatar, working):
        say(f"{person}: its {len(crops)} crops, fit and settings have not changed; {UP_TO_DATE}")
        return
    rng = np.random.default_rng(settings.seed)
    rest = build_rest_pose(settings, person, fitted, body_model, crops, rng)
    mark = fingerprint(settings, sources.files(), *about)
    checkpoint = Checkpoint(working / "checkpoint.npz", mark, settings.checkpoint_every_s)
    appearance = _appearance(settings, rest, fitted, crops)
    # Smoothness limits a joint's speed: between frames further apart in time the joint turns further.
    # Frame rate to which the weight of the poses' smoothness refers.
    losses = replace(settings.losses, pose=settings.losses.pose * (fitted.fps / 30.0) ** 2)
    subject = _training_subject(settings, rest, losses, crops, threads, rng, appearance, device)
    terms = active_terms(losses, _network(settings, lpips, threads, device))
    train(subject, terms, (0, settings.iterations), rng, label=person, checkpoint=checkpoint, previews=working)
    subject.finish()
    if subject.refused:
        warn(f"{person}: {subject.refused} gradient entries were not finite and were skipped")
    write_avatar(gaussians, avatar, _avatar(settings, fitted, body_model, rest, subject, appearance), trained_from)
    store_result(gaussians, avatar, working)
    checkpoint.remove()


def _crops(
    settings: Settings, person: str, sources: Sources, fitted: Person, body_model: BodyModel, working: Path
) -> list[Crop]:
    """Crops around the person, as the training cameras saw them; UserError where there are none."""
    cameras, frames = read_model(sources.model.parent), read_manifest(sources.manifest).frames
    require_one_each(cameras, videos=sources.videos, masks=sources.masks)
    label = _person_index(settings, person, sources.people) + 1
    even = read_factors(sources.exposure, frames)
    about = fitted, body_model, label, frames, working, even
    crops = read_crops(settings, cameras, sources.videos, sources.masks, *about)
    if not crops:
        raise UserError(
            f"no training camera shows {settings.smallest_px} pixels of {person} in any frame "
            "with a fitted body; check the masks, or "
            "remove the person in people/identities.tsv"
        )
    return crops


def _person_index(settings: Settings, person: str, people: Path) -> int:
    """Index of the person in ``people``; UserError for contradictory settings or an unknown name."""
    if settings.densify.use != "none" and settings.temporal.use != "never" and settings.temporal.points:
        raise UserError(
            "humans.densify.use is gradient, and humans.temporal.points evaluates the temporal network at points, "
            "which needs a constant number of Gaussians: set points to 0, or temporal.use to never"
        )
    names = read_people(people)
    if person not in names:
        raise UserError(f"{person} is not among the people of {people} ({', '.join(names) or 'none'})")
    return names.index(person)


def _read_fit(fit: Path, body: Path) -> tuple[Person, BodyModel]:
    """The fitted person and the body model; UserError where the person was fitted with another one."""
    body_model = BodyModel.load(body)
    return read_person(fit, model=body_model), body_model


def _training_subject(
    settings: Settings,
    rest: RestPose,
    losses: Losses,
    crops: Sequence[Crop],
    threads: int,
    rng: np.random.Generator,
    appearance: Appearance | None,
    device: str,
) -> PersonInTraining:
    """The person as the subject of ``train``."""
    kind = PersonInTraining
    if device == "cuda":
        from studiorecon.humans.tensor_person import TensorPerson

        kind = TensorPerson
    return kind(
        rest.start,
        rest.samples.spacing_m,
        rest.posing,
        rest.motion,
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
        settings.densify,
        settings.additions,
        rest.grid,
    )


def _avatar(
    settings: Settings,
    fitted: Person,
    body_model: BodyModel,
    rest: RestPose,
    subject: PersonInTraining,
    appearance: Appearance | None,
) -> Avatar:
    """The trained person; colours of Gaussians that no camera saw come from their surroundings, if so configured."""
    trained, source, person, samples = subject.gaussians(), subject.source, fitted.name, rest.samples
    if trained.count != rest.start.count:
        say(f"{person}: {rest.start.count} Gaussians became {trained.count}")
    grown = replace(
        samples,
        points_m=trained.means_m.astype(np.float64),
        normals=samples.normals[source],
        weights=samples.weights[source],
    )
    same = np.array_equal(source, np.arange(rest.start.count))
    seen, surface = rest.seen[source], samples if same else grown
    if settings.additions.unseen_colours == "filled":
        near, twin = surface_neighbours(surface, NEIGHBOURS), mirror_indices(surface, 2 * samples.spacing_m)
        trained = recolour_unseen(trained, seen, near, twin)
    moved_mm = 1000 * np.linalg.norm(trained.means_m - rest.start.means_m[source], axis=1)
    say(
        f"{person}: Gaussians moved {np.median(moved_mm):.1f} mm from the body's surface in "
        f"the median, 99 % less than {np.quantile(moved_mm, 0.99):.0f} mm"
    )
    return Avatar(
        person=person,
        model=posed_skeleton(fitted, body_model)[0],
        gaussians=trained,
        bones=subject.bones,
        weights=subject.weights,
        provenance=np.where(seen, MEASURED, INFERRED).astype(np.uint8),
        poses=rest.motion.poses,
        trans=rest.motion.trans_m,
        betas=fitted.betas,
        valid=fitted.valid,
        present=fitted.present,
        fps=fitted.fps,
        metric=fitted.metric,
        hand_scale=fitted.hand_scale,
        network=appearance.active_network if appearance else None,
        decision=json.dumps(asdict(appearance.decision)) if appearance and appearance.decision else "",
    )


def _appearance(settings: Settings, rest: RestPose, fitted: Person, crops: Sequence[Crop]) -> Appearance | None:
    """The temporal network in its box around the body, and the measure that decides its use; None when switched off."""
    if settings.temporal.use == "never":
        return None
    reach = settings.grid_margin * np.ptp(rest.vertices_m, axis=0).max()
    shape = settings.temporal.width, settings.temporal.layers
    # A separate generator: with and without the network, the crops are drawn in the same order.
    rng = np.random.default_rng([settings.seed, 1])
    points = settings.temporal.points
    move_unseen = settings.additions.unseen_colours == "trained"
    acts_on = np.ones_like(rest.seen) if move_unseen else rest.seen
    control = ControlPoints.on(rest.samples.points_m[acts_on], points) if points and acts_on.any() else None
    network = TemporalNetwork.start(
        rest.vertices_m.min(axis=0) - reach,
        rest.vertices_m.max(axis=0) + reach,
        len(fitted.poses),
        rng,
        *shape,
        control,
        use_all_bands=settings.temporal.bands == "all",
        move_unseen=move_unseen,
    )

    def decide(draw: Callable[[Crop], np.ndarray]) -> Decision:
        samples = rest.samples
        residual = track_brightness(
            crops, draw, rest.posing, rest.motion, samples.points_m, samples.normals, samples.spacing_m
        )
        decision = decide_appearance(fitted.name, drifting_share(residual[rest.seen]), settings.drift)
        say(f"temporal network: {decision.verdict}; {decision.reason}")
        return decision

    return Appearance(settings.temporal, network, acts_on, decide)


def _network(settings: Settings, lpips: Path, threads: int, device: str) -> Perceptual | None:
    """The network of the perceptual term on the drawing device; None when its weight is 0."""
    if settings.losses.lpips.weight == 0:
        say("LPIPS is off (humans.losses.lpips.weight is 0)")
        return None
    from studiorecon.models.adapters.lpips import read_lpips

    return read_lpips(lpips, threads, without="set humans.losses.lpips.weight to 0", device=device)
