# SPDX-License-Identifier: Apache-2.0
"""The sections of the configuration in the order of the data, and the dataclasses that declare their settings."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from studiorecon.configuration.plan_settings import General
from studiorecon.configuration.setting import Setting, plain_value, settings_in


@dataclass(frozen=True)
class Section:
    """A section of the configuration.

    Attributes:
        name: of the stage.
        about: the subject of its settings.
        declared_in: ``module:Class`` of the dataclasses that declare its settings, in order; not imported, because most
            steps need libraries that the configuration does without.
    """

    name: str
    about: str
    declared_in: tuple[str, ...]

    def settings(self) -> list[Setting]:
        """Its settings in order; each is declared by one class only."""
        return [setting for place in self.declared_in for setting in settings_in(_class(place), declared=True)]


SECTIONS: tuple[Section, ...] = (
    Section(
        "detect",
        "People in each camera's pictures, before any calibration.",
        (
            "tracks.bodies:Settings",
            "configuration.plan_settings:Detect",
            "keypoints.detections:Settings",
            "keypoints.detections:DetectionLimits",
        ),
    ),
    Section("clocks", "Time offsets of the cameras.", ("clocks.offsets:Settings",)),
    Section(
        "calibration",
        "Source of the calibration, and its check on people.",
        (
            "calibration.network:Settings",
            "calibration.files:Settings",
            "rig.agreement:AgreementLimits",
            "rig.agreement:CalibrationPrior",
        ),
    ),
    Section(
        "capture", "The working frames of every camera.", ("capture.frames:Settings", "footage.source:PictureRate")
    ),
    Section("plates", "The clean plate of each training camera.", ("plates.clean:Settings",)),
    Section("cameras", "Refinement of the cameras on people's keypoints.", ("cameras.refine:Settings",)),
    Section(
        "people",
        "Identities, and each person's body over time.",
        (
            "configuration.plan_settings:People",
            "people.fit_settings:HandSettings",
            "people.fit_settings:TriangulationSettings",
            "people.lift:Settings",
            "people.associate:Settings",
            "people.fit:Settings",
            "people.fit_settings:SmoothingSettings",
        ),
    ),
    Section(
        "depth",
        "Metric depth of the static scene.",
        (
            "depth.network:Settings",
            "configuration.plan_settings:Depth",
            "depth.sweep_settings:FirstLook",
            "depth.refine:Settings",
            "depth.fusion:NetworkTerm",
            "depth.sweep_settings:Matching",
            "depth.sweep:Settings",
            "depth.box:Settings",
            "depth.room:Settings",
        ),
    ),
    Section("survey", "Effects that the scene calls for.", ("survey.effects:EffectSettings",)),
    Section("objects", "Moving objects that are not people.", ("objects.find:Settings",)),
    Section(
        "masks",
        "Masks of people in the training pictures.",
        ("masks.network:Settings", "configuration.plan_settings:Masks", "masks.segment:Settings"),
    ),
    Section(
        "views",
        "New views between the cameras.",
        (
            "views.warp_settings:ViewSource",
            "views.warp_settings:PeopleInViews",
            "configuration.plan_settings:Views",
            "views.generate:Settings",
            "views.fitted:Settings",
            "views.path:Settings",
            "views.warp_settings:Warping",
        ),
    ),
    Section("background", "Static Gaussians of the room.", ("background.train_settings:Settings",)),
    Section(
        "humans",
        "Gaussians of every person.",
        ("humans.start_settings:StartSettings", "humans.train_settings:TrainSettings"),
    ),
    Section(
        "render",
        "Films of the 4D scene.",
        ("render.draw_settings:DrawSettings", "render.shot:Settings", "configuration.plan_settings:Render"),
    ),
    Section(
        "enhance",
        "Films with added detail and without flicker.",
        (
            "enhance.injection_settings:Enhancing",
            "configuration.plan_settings:Enhance",
            "enhance.injection_settings:Carrying",
            "enhance.injection_settings:Injecting",
        ),
    ),
    Section("deliver", "Files for other programs.", ("deliver.export:Settings",)),
    Section("report", "Contents and measures of the report.", ("report.page:Settings", "report.evaluate:Settings")),
)


def general_settings() -> list[Setting]:
    """The settings at the top, outside any section."""
    return list(settings_in(General))


@cache
def _class(place: str) -> type:
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(f"studiorecon.{module}"), name)


def default_configuration() -> Mapping[str, Any]:
    """The default configuration, as in config.yaml."""
    top = {setting.name: plain_value(setting.default) for setting in general_settings()}
    return top | {s.name: {setting.name: plain_value(setting.default) for setting in s.settings()} for s in SECTIONS}
