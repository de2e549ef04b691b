# SPDX-License-Identifier: Apache-2.0
"""Refuses inputs that cannot be run, in a sentence with the place and a remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studiorecon.calibration.formats import accepted_formats
from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import Kind
from studiorecon.models.catalogue.registry import MODELS, cards_of_kind
from studiorecon.plan.decisions import Plan
from studiorecon.scene.user_files import file_size

# Endings of files that were made outside this workflow, the likelier ones first.
PRECOMPUTED = {
    "detect": (".npz", ".pt"),
    "masks": (".mkv", ".mp4", ""),
    "depth": (".exr", ".npy", ".npz", ".png"),
    "views": (".mkv", ".mp4"),
    "enhance": (".mkv", ".mp4"),
}
# Depth networks that need no GPU.
_ON_A_CPU = [card.name for card in cards_of_kind("monocular depth", "inverse depth") if card.memory.gpu_gb is None]


def _networks(kind: Kind) -> str:
    """The names of a kind of networks, as a setting takes them."""
    return " or ".join(card.name for card in cards_of_kind(kind))


def find_precomputed(config: Mapping[str, Any], section: str, stem: str) -> Path:
    """The file of ``stem`` in the folder that ``<section>.precomputed`` names; raises UserError where there is none."""
    folder = config[section]["precomputed"]
    found = [path for suffix in PRECOMPUTED[section] if (path := Path(folder) / f"{stem}{suffix}").exists()]
    if not found:
        names = " or ".join(f"{stem}{suffix}" for suffix in PRECOMPUTED[section])
        raise UserError(
            f"{section}.precomputed is {folder!r}, which has no {names}: bring that file, or name the folder that has "
            "it"
        )
    return found[0]


def check_plan(plan: Plan, config: Mapping[str, Any]) -> None:
    """Raises UserError for the first missing or contradictory input."""
    _calibration(plan)
    _enhancement(plan, config)
    _named_files(plan, config)
    _precomputed(plan, config)
    if (named := config["detect"]["network"]) and named not in MODELS and not Path(named).is_file():
        raise UserError(
            f"detect.network names {named}, which does not exist; name an .onnx file, or "
            f"{_networks('point detector')}, or leave it empty"
        )
    if plan.networks.depth == "onnx" and not Path(config["depth"]["network"]).is_file():
        raise UserError(
            f"depth.source is onnx and depth.network is {config['depth']['network']!r}, which is no file: name your "
            f".onnx file, or set the source to one that snakemake weights fetches ({', '.join(_ON_A_CPU)})"
        )
    if plan.people:
        _keypoints(plan)
    if plan.networks.first_depth and not plan.networks.cameras:
        raise UserError(
            "depth.reference is calibration, which is the depth of the network that estimates the cameras, but "
            f"calibration.source is {config['calibration']['source']}: set that to "
            f"{_networks('pose and depth')}, or the reference to planes"
        )
    if config["views"]["people"] == "network" and not plan.networks.masks:
        raise UserError(
            "views.people is network, which is the network of masks.source, but that is "
            f"{config['masks']['source']}: set that to {_networks('person segmenter')}, or views.people to bodies"
        )
    if plan.lifts_pelvises:
        _lifting(plan)
    if plan.from_people and (unseen := [c for c in plan.cameras if c not in plan.person_sources.cameras]):
        raise UserError(
            f"dataset {plan.dataset.folder} has no calibration, so people's keypoints must give the cameras, but "
            f"camera {unseen[0]} has no keypoints: add {unseen[0]}/*.json, set detect.source to auto, leave the camera "
            "out with train: [...] in capture.yaml, or bring a calibration"
        )


def _named_files(plan: Plan, config: Mapping[str, Any]) -> None:
    """Raises UserError for the first file that a setting names and that cannot be read."""
    named = {"body": plan.given_body, "people.identities": config["people"]["identities"]}
    for shot, given in config["render"]["shots"].items():
        where = f"render.shots.{shot}"
        named |= {f"{where}.{key}": given.get(key, "") for key in ("file", "reference")}
        named |= {
            f"{where}.replace.{person}": other
            for person, other in given.get("replace", {}).items()
            if not re.fullmatch(r"p\d+|nobody", other)
        }
    for setting, file in named.items():
        if file:
            try:
                file_size(Path(file))
            except UserError as refusal:
                raise UserError(
                    f"{setting} names a file that cannot be read: {refusal}; correct the setting or add the file"
                ) from None


def _precomputed(plan: Plan, config: Mapping[str, Any]) -> None:
    """Raises UserError for the first camera without its file of what was made elsewhere."""
    wanted = {
        "detect": plan.people and plan.person_sources.body_network == "precomputed",
        "masks": plan.people and config["masks"]["source"] == "precomputed",
        "depth": plan.networks.depth == "precomputed",
    }
    for section in PRECOMPUTED:
        key = {"views": "synthesizer", "enhance": "enhancer"}.get(section, "source")
        if config[section]["precomputed"] and config[section][key] != "precomputed":
            raise UserError(
                f"{section}.precomputed is {config[section]['precomputed']!r}, but {section}.{key} is "
                f"{config[section][key]}: set that to precomputed, or leave the folder out"
            )
    has_own = {"detect": {}, "masks": plan.dataset.masks, "depth": plan.dataset.depth}
    for section in (name for name, requested in wanted.items() if requested):
        for camera in plan.training:
            if camera not in has_own[section]:
                find_precomputed(config, section, camera)


def _calibration(plan: Plan) -> None:
    if plan.networks.cameras and plan.dataset.pixel_maps:
        raise UserError(
            f"calibration.source is {plan.networks.cameras}, which uses the footage as it is, but capture.yaml has "
            "pixel_maps, which belong to a calibration: delete them, or set calibration.source to files"
        )
    if not plan.from_people and not plan.networks.cameras and not plan.dataset.calibration:
        raise UserError(
            f"dataset {plan.dataset.folder} has no calibration: put one there ({accepted_formats()}), or name it in "
            "capture.yaml (calibration: FILE)"
        )


def _enhancement(plan: Plan, config: Mapping[str, Any]) -> None:
    enhance = config["enhance"]
    if config["background"]["refinement"]["views"] and not plan.networks.refiner:
        raise UserError(
            "background.refinement.views needs a network that repairs views of the half-trained room, but "
            f"enhance.enhancer is {enhance['enhancer']}: set that to {_networks('picture enhancer')}, or the views to 0"
        )
    for setting, value in (("enhancer", "none"), ("strength", 0)):
        if plan.forced_effects.get("enhancement") == "on" and enhance[setting] == value:
            raise UserError(
                f"survey.force has enhancement: on, but enhance.{setting} is {value}, which adds nothing: leave one of "
                "the two out"
            )
    if plan.forced_effects.get("injection") == "on" and not enhance["injection"]["history"]:
        raise UserError(
            "survey.force has injection: on, but enhance.injection.history is 0, which injects nothing: leave one of "
            "the two out"
        )


def _lifting(plan: Plan) -> None:
    setting = "people.association.position: scene"
    if not plan.networks.cameras:
        raise UserError(
            f"{setting} needs the first moment's depth of the network that estimates the cameras: set "
            f"calibration.source to {_networks('pose and depth')}, or the position to rays"
        )
    if plan.networks.depth not in [card.name for card in cards_of_kind("monocular depth")]:
        raise UserError(
            f"{setting} needs the depth of every frame: set depth.source to {_networks('monocular depth')}, or the "
            "position to rays"
        )
    if plan.person_sources.detector_cameras:
        raise UserError(
            f"{setting} needs people from a network's bodies or keypoint files, but the built-in detector is used for "
            f"camera {plan.person_sources.detector_cameras[0]}: set detect.source to comotion or keypoints, or the "
            "position to rays"
        )


def _keypoints(plan: Plan) -> None:
    sources, dataset = plan.person_sources, plan.dataset
    if not sources.can_show_people:
        raise UserError(
            f"dataset {dataset.folder} has no 2D keypoints and detect.source is keypoints: set it to auto, put "
            "keypoints/<camera>/*.json (OpenPose, AlphaPose, MMPose, …) there, or write people: 0 into capture.yaml "
            "for an empty room"
        )
    blind = [c for c in plan.training if c not in sources.cameras]
    if sources.cameras and not sources.body_network and blind:
        raise UserError(
            f"camera {blind[0]} of dataset {dataset.folder} has no keypoints in "
            f"{next(iter(dataset.keypoints.values())).parent}: add {blind[0]}/*.json there, leave the camera out with "
            "train: [...] in capture.yaml, or set detect.source to auto"
        )
