# SPDX-License-Identifier: Apache-2.0
"""Reads the files of a trained scene: its room, people and objects as Gaussians."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar, read_avatar
from studiorecon.body.model import BodyModel
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.gaussians_ply import read_ply
from studiorecon.scene.provenance import read_provenance
from studiorecon.splatting.rigid_object import RigidObject, read_objects

if TYPE_CHECKING:
    from jaxtyping import Integer


@dataclass(frozen=True)
class SceneFiles:
    """The files of a step that draws a scene.

    Attributes:
        background, provenance: the room, and the provenance of its Gaussians.
        gaussians, avatars: of every person; their motion is of the body model ``body``.
        objects: rigid objects, if any.
    """

    background: Path
    provenance: Path
    gaussians: list[Path] = field(default_factory=list)
    avatars: list[Path] = field(default_factory=list)
    body: Path | None = None
    objects: list[Path] = field(default_factory=list)

    def room(self) -> tuple[Gaussians, Integer[np.ndarray, " N"]]:
        """N static Gaussians and their provenance; raises UserError where it is another room's."""
        gaussians = read_ply(self.background)
        return gaussians, read_provenance(self.provenance, gaussians.count)

    def people(self) -> list[Avatar]:
        """All people; raises UserError where there is no body model for them."""
        if not self.avatars:
            return []
        model = BodyModel.load(self.body)
        return [read_avatar(ply, npz, model) for ply, npz in zip(self.gaussians, self.avatars, strict=True)]

    def things(self) -> list[RigidObject]:
        """All rigid objects."""
        return [thing for path in self.objects for thing in read_objects(path)]
