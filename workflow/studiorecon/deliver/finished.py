# SPDX-License-Identifier: Apache-2.0
"""The finished 4D scene in memory: room, people and objects as Gaussians, with their motion and the cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.camera_files.colmap import read_model
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Manifest, read_manifest
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.path import PathStep, read_path
from studiorecon.scene.step_files import require
from studiorecon.splatting.rigid_object import RigidObject
from studiorecon.splatting.scene_files import SceneFiles

if TYPE_CHECKING:
    from jaxtyping import Integer


@dataclass(frozen=True)
class FinishedScene:
    """The result of a run on one capture.

    Attributes:
        name: the scene's.
        capture: its frames, frame rate and footage.
        cameras: training cameras.
        room: static Gaussians in the world, with the plates' colours.
        provenance: uint8 of the room's, see ``scene/provenance.py``; people and objects have their own.
        people: all persons, canonical, with their motion.
        things: objects with their motion.
        paths: film → its steps, in the order of its pictures.
    """

    name: str
    capture: Manifest
    cameras: Sequence[Camera]
    room: Gaussians
    provenance: Integer[np.ndarray, " N"]
    people: Sequence[Avatar] = ()
    things: Sequence[RigidObject] = ()
    paths: Mapping[str, Sequence[PathStep]] = field(default_factory=dict)

    @property
    def contents(self) -> str:
        """A summary of the scene for people."""
        return (
            f"the room as {self.room.count} Gaussians, {len(self.people)} people, {len(self.things)} things and "
            f"{len(self.cameras)} cameras over {self.capture.frames} frames"
        )


def read_finished(manifest: Path, model: Path, files: SceneFiles, paths: Sequence[Path] = ()) -> FinishedScene:
    """The scene from its files: ``model`` is the training cameras' images.txt, ``paths`` the films' paths.

    Raises UserError when files are missing or belong to different scenes, and for a Gaussian with a non-finite value,
    which other programs do not skip.
    """
    capture, (room, marks) = read_manifest(manifest), files.room()
    people, things = files.people(), files.things()
    require_finite(room, files.background)
    for person, ply in zip(people, files.gaussians):
        require_finite(person.gaussians, ply)
    for thing in things:
        require_finite(thing.gaussians, Path(f"{files.objects[0]} ({thing.person})"))
    films = {path.stem: read_path(path)[0] for path in paths}
    return FinishedScene(capture.scene, capture, read_model(model.parent), room, marks, people, things, films)


def require_finite(gaussians: Gaussians, source: Path) -> Gaussians:
    """The Gaussians as given; raises UserError with ``source`` and the first one that has a non-finite value.

    An infinite logit, an opacity of 0 or 1, counts as non-finite.
    """
    rows = np.concatenate(
        [
            gaussians.means_m,
            gaussians.quaternions,
            gaussians.log_scales,
            gaussians.sh.reshape(gaussians.count, gaussians.sh.shape[1] * 3),
        ],
        axis=1,
    )
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1) | np.isnan(gaussians.logit_opacities))
    require(source, not len(bad), f"{len(bad)} of its Gaussians are not finite")
    return gaussians
