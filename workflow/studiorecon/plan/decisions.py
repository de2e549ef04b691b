# SPDX-License-Identifier: Apache-2.0
"""The plan: everything about a run that the configuration and the dataset decide."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from studiorecon.plan.networks import Networks
from studiorecon.plan.person_sources import PersonSources
from studiorecon.scene.dataset import Dataset


@dataclass(frozen=True)
class Plan:
    """Everything that is decided before the first job.

    Attributes:
        dataset: paths of the dataset's files, whether they exist or will be made.
        studio, description: name and file of the synthetic studio that is filmed first; "" for a user's own dataset.
        scene: the scene's folder below ``results``.
        given_body, body: the body model that the configuration names, and the same as plain arrays, which steps read.
        identities: file of the user's own table of identities; "" when there is none.
        person_sources, networks: how people are detected; the selected upstream networks.
        lifts_pelvises: people are separated by the 3D positions of their pelvises at the scene's depth.
        from_people: cameras are calibrated from the people in the pictures.
        calibration: files of the calibration: the user's, or those that a network writes.
        segments: the gaps between neighbouring training cameras, once around, that synthesised views may fill.
        films: names of the films.
        forced_effects: effect → on or off, where ``survey.force`` decides it.
    """

    dataset: Dataset
    studio: str
    description: str
    scene: str
    given_body: str
    body: str
    identities: str
    person_sources: PersonSources
    networks: Networks
    lifts_pelvises: bool
    from_people: bool
    calibration: list[str]
    segments: list[str]
    films: list[str]
    forced_effects: Mapping[str, str]

    @property
    def people(self) -> bool:
        """Whether people can be in the scene at all."""
        return self.dataset.people

    @property
    def calibrated(self) -> bool:
        """Whether the user gave a calibration, so that poses are known before any picture is read."""
        return bool(self.dataset.calibration) and not self.from_people and not self.networks.cameras

    @property
    def cameras(self) -> list[str]:
        """Every camera that is used."""
        return list(self.dataset.cameras)

    @property
    def training(self) -> list[str]:
        """The training cameras."""
        return list(self.dataset.training)

    @property
    def first_searched(self) -> list[str]:
        """The cameras in which the detector searches some moments, for the doctor and for a calibration from people."""
        asked = self.cameras if self.from_people else self.person_sources.doctor_cameras
        return [camera for camera in asked if camera in self.person_sources.searched_cameras]

    @property
    def held_out(self) -> list[str]:
        """The held-out cameras."""
        return list(self.dataset.held_out)

    @property
    def first_film(self) -> list[str]:
        """The film for a first preview: the first one that is not only there for measurement."""
        return [film for film in self.films if film != "heldout"][:1] or self.films[:1]

    @property
    def shots(self) -> list[str]:
        """Every film, and "train": the training cameras' own views, which are compared with the photos."""
        return ["train", *self.films]


def camera_pattern(names: Iterable[str]) -> str:
    """A wildcard constraint that matches exactly these names; nothing when ``names`` is empty."""
    return "|".join(map(re.escape, names)) or "(?!)"
