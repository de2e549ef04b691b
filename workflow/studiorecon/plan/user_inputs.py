# SPDX-License-Identifier: Apache-2.0
"""The files that rules take from the user, from the workflow's own folder, or from a network that replaces them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.models.catalogue.preflight import staged_weights
from studiorecon.models.catalogue.registry import MODELS, find_card
from studiorecon.plan.decisions import Plan
from studiorecon.plan.plan_checks import find_precomputed
from studiorecon.plan.step_config import step_section
from studiorecon.scene.dataset import colmap_files
from studiorecon.scene.replacement_photos import is_photo, photos_of_strangers


class UserInputs:
    """Input functions of rules, from wildcards to files; none where there is no input.

    ``local`` is Snakemake's: it marks a path as local, whatever storage results go to.
    """

    def __init__(self, plan: Plan, config: Mapping[str, Any], home: Path, local: Callable[[str], str]) -> None:
        self.plan, self.config, self.home, self.local = plan, config, home, local
        self.shots: Mapping[str, Mapping[str, Any]] = config["render"]["shots"]

    def bundled(self, name: str) -> str:
        """A file of the workflow's own folder."""
        return self.local(str(self.home / name))

    def in_dataset(self, path: Path | str) -> str:
        """A file of the dataset: a result in a synthetic studio, a local file in a user's own dataset."""
        return str(path) if self.plan.studio else self.local(str(path))

    def precomputed(self, section: str, stem: str) -> str:
        """A file that the user made outside this workflow; raises UserError where it is missing."""
        return self.local(str(find_precomputed(self.config, section, stem)))

    @cached_property
    def given_body(self) -> str:
        return self.local(self.plan.given_body)

    @cached_property
    def body(self) -> str:
        """The body model as plain arrays."""
        return self.plan.body if self.plan.body != self.plan.given_body else self.given_body

    @cached_property
    def detector(self) -> list[str]:
        return [self.bundled(f"resources/detector/{name}") for name in self.plan.person_sources.detector_files]

    @cached_property
    def hand_network(self) -> list[str]:
        """The network for hands, unless they are off."""
        off = step_section("people.second_look", self.config)["hands"] == "off"
        return [] if off else [self.bundled("resources/detector/hand_landmark_full.onnx")]

    def second_network(self, _: Any) -> list[str]:
        """The landmark network, if there is one: the user's own file, or the fetched and verified one."""
        named = self.config["detect"]["network"]
        if named not in MODELS:
            return [self.local(named)] if named else []
        card = find_card(named)
        return [self.local(str(staged_weights(card, Path(self.plan.networks.weights)) / card.weights[0].path))]

    @cached_property
    def player(self) -> list[str]:
        """The player's page and scripts."""
        parts = sorted((self.home / "resources" / "player").iterdir())
        return [self.bundled(str(part.relative_to(self.home))) for part in parts]

    @cached_property
    def calibration(self) -> list[str]:
        written = bool(self.plan.networks.cameras)
        return [file if written else self.in_dataset(file) for file in self.plan.calibration]

    @cached_property
    def lenses(self) -> list[str]:
        """Lenses without poses."""
        return [self.in_dataset(file) for file in self.plan.dataset.lenses]

    @cached_property
    def all_footage(self) -> list[str]:
        """The footage of every camera, in their order."""
        return [self._film(camera) for camera in self.plan.cameras]

    @cached_property
    def corrected_identities(self) -> list[str]:
        """The user's table of identities, if there is one."""
        named = self.config["people"]["identities"]
        return [(self.local if named else self.in_dataset)(self.plan.identities)] if self.plan.identities else []

    def footage(self, wildcards: Any) -> str:
        """Video file or folder of pictures of one camera."""
        return self._film(wildcards.camera)

    def _film(self, camera: str) -> str:
        if camera in self.plan.dataset.chapters:
            return f"results/{self.plan.scene}/detect/chapters/{camera}.ffconcat"
        return self.in_dataset(self.plan.dataset.footage[camera])

    def chapters(self, wildcards: Any) -> list[str]:
        """The chapters of one camera's recording, in order; none when the recording is one film."""
        return [self.in_dataset(film) for film in self.plan.dataset.chapters[wildcards.camera]]

    def keypoints(self, wildcards: Any) -> list[str]:
        """Keypoints of one camera: recorded ones, of every chapter where they exist per chapter, or the detector's of
        some moments."""
        camera = wildcards.camera
        if searched := self.first_search(wildcards):
            return searched
        recorded = self.plan.dataset.chapter_keypoints.get(camera, (self.plan.dataset.keypoints[camera],))
        return [self.in_dataset(path) for path in recorded]

    def first_search(self, wildcards: Any) -> list[str]:
        """Who was found in some moments of one camera; none where it was not searched yet."""
        camera = wildcards.camera
        searched = camera in self.plan.first_searched
        return [f"results/{wildcards.scene}/clocks/people/{camera}.npz"] if searched else []

    def read_keypoints(self, wildcards: Any) -> list[str]:
        """Keypoints of one camera: all of the detector's, or recorded ones after comparison with their film."""
        if wildcards.camera in self.plan.person_sources.searched_cameras:
            return [f"results/{wildcards.scene}/detect/found/{wildcards.camera}.npz"]
        return [f"results/{wildcards.scene}/detect/recorded/{wildcards.camera}.npz"]

    def keypoints_of_other_cameras(self, camera: str) -> list[str]:
        """The other cameras with recorded keypoints, if this camera's are used: two cameras' may be swapped."""
        looked_for = self.plan.person_sources.searched_cameras
        if camera in looked_for:
            return []
        return [c for c in self.plan.dataset.keypoints if c != camera and c not in looked_for]

    def other_keypoints(self, wildcards: Any) -> list[str]:
        """Files and folders of the other cameras' recorded keypoints."""
        return [
            self.in_dataset(self.plan.dataset.keypoints[c]) for c in self.keypoints_of_other_cameras(wildcards.camera)
        ]

    def given_bodies(self, wildcards: Any) -> list[str]:
        """The user's file of a network's bodies of one camera, if bodies are precomputed."""
        if self.plan.person_sources.body_network != "precomputed":
            return []
        return [self.precomputed("detect", wildcards.camera)]

    def given_plate(self, wildcards: Any) -> list[str]:
        """The user's clean plate of one camera, if there is one."""
        plates = self.plan.dataset.plates
        return [self.in_dataset(plates[wildcards.camera])] if wildcards.camera in plates else []

    def given_masks(self, wildcards: Any) -> list[str]:
        """The user's person masks of one camera, if there are any."""
        if wildcards.camera in self.plan.dataset.masks:
            return [self.in_dataset(self.plan.dataset.masks[wildcards.camera])]
        if self.config["masks"]["source"] == "precomputed":
            return [self.precomputed("masks", wildcards.camera)]
        return []

    def given_depth(self, wildcards: Any) -> str:
        """The user's depth map of one camera."""
        return self.in_dataset(self.plan.dataset.depth[wildcards.camera])

    def truth(self, wildcards: Any) -> list[str]:
        """The folder of exact truth of a synthetic studio."""
        return [self.in_dataset(self.plan.dataset.truth)] if self.plan.dataset.truth else []

    # ---- made by a network or outside this workflow ----

    def estimated_depth(self, wildcards: Any) -> list[str]:
        """A network's depth of one camera, in an arbitrary unit, where ``depth.source`` selects one."""
        if not self.plan.networks.depth or self.plan.networks.first_depth:
            return []
        if self.plan.networks.depth != "precomputed":
            return [f"results/{wildcards.scene}/depth/{wildcards.camera}.estimate.exr"]
        return [self.precomputed("depth", wildcards.camera)]

    def depth_network(self, _: Any) -> list[str]:
        """The user's own depth network, where ``depth.source`` is onnx."""
        return [self.local(self.config["depth"]["network"])] if self.plan.networks.depth == "onnx" else []

    def generated_film(self, wildcards: Any) -> str:
        """Film of one gap's synthesised views."""
        if self.plan.networks.views != "precomputed":
            return f"results/{wildcards.scene}/views/{wildcards.segment}.film.mkv"
        return self.precomputed("views", wildcards.segment)

    def tracked_masks(self, wildcards: Any) -> list[str]:
        """A network's film of person ids for one camera, where a network is selected and the user gave no masks."""
        wanted = self.plan.networks.masks and wildcards.camera not in self.plan.dataset.masks
        return [f"results/{wildcards.scene}/masks/{wildcards.camera}.tracks.mkv"] if wanted else []

    def external_film(self, wildcards: Any) -> list[str]:
        """The film of a shot that the user enhanced with another tool, if films are precomputed."""
        if self.config["enhance"]["enhancer"] != "precomputed" or self.plan.forced_effects.get("enhancement") == "off":
            return []
        return [self.precomputed("enhance", wildcards.shot)]

    # ---- inputs of a shot ----

    def shot_path(self, wildcards: Any) -> list[str]:
        """The files of the camera path that a shot follows, if it follows one: a COLMAP model is several files."""
        file = self.shots.get(wildcards.shot, {}).get("file")
        parts = colmap_files(Path(file)) if file and Path(file).stem == "images" else [file] if file else []
        return [self.local(str(part)) for part in parts]

    def replacement_people(self, wildcards: Any) -> list[str]:
        """Files of the people who replace others in a shot; people of this scene are inputs in any case."""
        wanted = self.shots.get(wildcards.shot, {}).get("replace", {}).values()
        made = [f"results/{wildcards.scene}/humans/{name}.canonical.ply" for name in photos_of_strangers(wanted)]
        files = [Path(s) for s in wanted if not (re.fullmatch(r"p\d+|nobody", s) or is_photo(s))]
        beside = (str(f.with_suffix(".npz")) for f in files if f.with_suffix(".npz").is_file())
        return [*made, *map(str, files), *beside]

    def replacement_photo(self, wildcards: Any) -> str:
        """The photo of a person outside the scene that a shot's ``replace`` names."""
        named = photos_of_strangers(s for shot in self.shots.values() for s in shot.get("replace", {}).values())
        if wildcards.stranger not in named:
            raise UserError(
                f"no film's replace names a photo of {wildcards.stranger.removeprefix('stranger_')}: "
                "name one in render.shots"
            )
        return self.local(named[wildcards.stranger])

    def replacement_truth(self, wildcards: Any) -> list[str]:
        """The truth film of a shot in which a person is replaced: photos of the original person cannot correct it."""
        replaced = self.shots.get(wildcards.shot, {}).get("replace")
        return [f"results/{wildcards.scene}/render/{wildcards.shot}.truth.mkv"] if replaced else []

    def edited_reference(self, wildcards: Any) -> list[str]:
        """The edited picture that a network takes as its reference for a shot, if one is named."""
        file = self.shots.get(wildcards.shot, {}).get("reference")
        return [self.local(file)] if file else []
