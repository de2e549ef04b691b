# SPDX-License-Identifier: Apache-2.0
"""The plan: everything about a run that the configuration and the dataset decide."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from studiorecon.plan.networks import Networks
from studiorecon.plan.sight import Sight
from studiorecon.scene.dataset import Dataset


@dataclass(frozen=True)
class Plan:
    """What is decided before anything runs.

    Attributes:
        dataset: where the dataset's files lie, or will lie.
        studio, description: name and file of the synthetic studio that is filmed first; "" for a user's own dataset.
        scene: the scene's folder below ``results``.
        given_body: the body model that the configuration names; body: the same as plain arrays, which steps read.
        identities: file of the user's own say on who is who; "" when there is none.
        sight: in which cameras people are looked for; networks: which upstream networks are asked for.
        lifted: people are told apart by pelvises at the scene's depth.
        from_people: the cameras are found from the people in the pictures.
        calibration: files of the calibration: the user's, or those that a network writes.
        segments: the gaps between neighbouring training cameras that new views may fill, once around.
        films: names of the films.
        forced: effect → on or off, where ``survey.force`` has decided beforehand.
    """

    dataset: Dataset
    studio: str
    description: str
    scene: str
    given_body: str
    body: str
    identities: str
    sight: Sight
    networks: Networks
    lifted: bool
    from_people: bool
    calibration: list[str]
    segments: list[str]
    films: list[str]
    forced: Mapping[str, str]

    @property
    def people(self) -> bool:
        """Whether anybody can be there at all."""
        return self.dataset.people

    @property
    def calibrated(self) -> bool:
        """Whether calibration files of the user's own say where the cameras are, before anything is looked at."""
        return bool(self.dataset.calibration) and not self.from_people and not self.networks.cameras

    @property
    def cameras(self) -> list[str]:
        """Every camera that is used."""
        return list(self.dataset.cameras)

    @property
    def training(self) -> list[str]:
        """The cameras that the scene is made from."""
        return list(self.dataset.training)

    @property
    def held_out(self) -> list[str]:
        """The cameras that only the report looks at."""
        return list(self.dataset.held_out)

    @property
    def first_film(self) -> list[str]:
        """The film of a first look: the first that is not only there to be measured."""
        return [film for film in self.films if film != "heldout"][:1] or self.films[:1]

    @property
    def shots(self) -> list[str]:
        """Every film, and "train": the training cameras themselves, which enhancement and report compare with the
        photos."""
        return ["train", *self.films]


def one_of(names: Iterable[str]) -> str:
    """A wildcard constraint: exactly these names; none matches anything where there are none."""
    return "|".join(map(re.escape, names)) or "(?!)"
