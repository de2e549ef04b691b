# SPDX-License-Identifier: Apache-2.0
"""Replaces a person by another (paper: human replacement): the donor's appearance and build, this person's motion.

A shot's ``replace: {p0: p1}`` takes another person of the same capture, ``replace: {p0: FILE.ply}`` any person in the
rest pose: LHM's, or ``humans/<person>.ply`` of another result with skeleton and weights in the ``.npz`` of the same
name. ``{p0: FILE.png}`` takes the person that LHM makes from that photo, and ``{p0: nobody}`` leaves p0 out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar, read_avatar
from studiorecon.body.avatar.binding import bind
from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.provenance import INVENTED
from studiorecon.scene.replacement_photos import is_photo, stranger_name

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

NOBODY = "nobody"
"""In place of a person: the room without that person."""


@dataclass(frozen=True)
class Donor:
    """The person whose appearance is taken: canonical Gaussians of shape ``betas`` with joints and weights."""

    gaussians: Gaussians
    bones: Integer[np.ndarray, "N K"]
    weights: Float[np.ndarray, "N K"]
    betas: Float[np.ndarray, " B"]


def donor_from_avatar(person: Avatar) -> Donor:
    """A trained person as a donor; colours are averaged over the performance, whose times do not match another's."""
    own = person.gaussians
    there = np.flatnonzero(person.present)
    # Moments over which changes of the donor's colours are averaged.
    moments = np.interp(np.linspace(0, len(there) - 1, 8), np.arange(len(there)), there)
    looks = [person.appearance_at(frame) for frame in (moments if person.network else [0])]
    sh, logits = (np.stack(values).mean(axis=0, dtype=np.float64) for values in zip(*looks))
    settled = Gaussians(own.means_m, own.quaternions, own.log_scales, logits, sh)
    return Donor(settled, person.bones, person.weights, person.betas)


def read_donor(path: Path, model: BodyModel) -> Donor:
    """The person of a canonical ``.ply``; raises UserError unless it holds a person in the rest pose."""
    beside = path.with_suffix(".npz")
    if beside.is_file():
        return donor_from_avatar(read_avatar(path, beside, model, brought=True))
    binding = bind(read_ply(path, "export it again"), model, str(path))
    say(
        f"{path.name}: {binding.gaussians.count} Gaussians are bound to the body, 95 % of them within "
        f"{1000 * binding.misfit_m:.0f} mm"
    )
    return Donor(binding.gaussians, binding.bones, binding.weights, binding.betas)


def retarget(donor: Donor, performer: Avatar) -> Avatar:
    """The donor with the performer's motion, as ``performer.person``; all of it is invented.

    Joint rotations are the performer's, bones keep the donor's length. The pelvis follows the performer's, shifted in
    height so that the lowest point of the body keeps its height: shorter legs do not float.
    """
    model, poses = performer.model, performer.poses
    lowest = [
        model.vertices(poses, betas, performer.trans, model.proxy_vertices)[..., 2].min(axis=1)
        for betas in (performer.betas, donor.betas)
    ]
    trans = np.asarray(performer.trans, np.float64).copy()
    trans[:, 2] += lowest[0].astype(np.float64) - lowest[1]
    bones = donor.bones
    if len(model.parents) == 24:  # a donor's fingers follow the hand of a performer who has none
        bones = np.where(bones < 24, bones, 22 + (bones.astype(int) - 24) // 15).astype(np.uint8)
    provenance = np.full(donor.gaussians.count, INVENTED, np.uint8)
    return replace(
        performer,
        gaussians=donor.gaussians,
        bones=bones,
        weights=donor.weights,
        betas=donor.betas,
        trans=trans,
        provenance=provenance,
        network=None,
        decision="",
    )


def replace_people(
    people: Sequence[Avatar], wanted: Mapping[str, str], shot: str, stand_ins: Sequence[Path] = ()
) -> list[Avatar]:
    """The people of a shot, those in ``wanted`` (person → person, ``.ply``, photo or ``NOBODY``) replaced or left out.

    ``stand_ins`` holds the canonical ``.ply`` of every photo's stranger. Names mean the people as captured, so ``{p0:
    p1, p1: p0}`` swaps two. Raises UserError for unknown names and for files that hold no person in the rest pose.
    """
    cast = {person.person: person for person in people}
    for name in [*wanted, *(source for source in wanted.values() if re.fullmatch(r"p\d+", source))]:
        if name not in cast:
            raise UserError(
                f"render.shots.{shot}.replace names {name}, but the people of this "
                f"scene are {', '.join(cast) or 'none'}"
            )
    done = []
    for person in people:
        source = wanted.get(person.person)
        if source is None:
            done.append(person)
            continue
        if source == NOBODY:
            say(f"shot {shot}: {person.person} is left out")
            continue
        file = (
            next(p for p in stand_ins if p.name.startswith(f"{stranger_name(source)}."))
            if is_photo(source)
            else Path(source)
        )
        donor = donor_from_avatar(cast[source]) if source in cast else read_donor(file, person.model)
        done.append(retarget(donor, person))
        say(f"shot {shot}: {source} performs {person.person}")
    return done
