# SPDX-License-Identifier: Apache-2.0
"""The files that rules take where these depend on the plan, on the people, or on the survey's decisions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from studiorecon.camera_files.calibration import read_lenses
from studiorecon.plan.decisions import Plan
from studiorecon.plan.step_config import step_section
from studiorecon.plan.user_inputs import UserInputs
from studiorecon.scene.decisions import Decision, read_decisions
from studiorecon.scene.people import read_people
from studiorecon.scene.step_files import step_file_context


class Files(UserInputs):
    """Input functions of all rules: the user's files, and outputs of other rules.

    A function that reads one of Snakemake's ``checkpoints`` raises Snakemake's own exception until that has run.
    """

    def __init__(
        self, plan: Plan, config: Mapping[str, Any], home: Path, local: Callable[[str], str], checkpoints: Any
    ) -> None:
        super().__init__(plan, config, home, local)
        self.checkpoints = checkpoints

    # ---- cameras ----

    def cameras(self, wildcards: Any) -> list[str]:
        """Every camera of the plan; where people calibrate the cameras, those that were calibrated so."""
        if not self.plan.from_people:
            return self.plan.cameras
        found = self.checkpoints.calibration_from_people.get(scene=self._scene(wildcards)).output.calibration
        placed = read_lenses(_fetched(found))
        return [camera for camera in self.plan.cameras if camera in placed]

    def training(self, wildcards: Any) -> list[str]:
        """The training cameras among them."""
        return [camera for camera in self.cameras(wildcards) if camera in self.plan.training]

    def held_out(self, wildcards: Any) -> list[str]:
        """The held-out cameras among them."""
        return [camera for camera in self.cameras(wildcards) if camera in self.plan.held_out]

    def evaluated_cameras(self, wildcards: Any) -> list[str]:
        """The cameras whose photos are compared with renders: the held-out ones, else the training cameras."""
        return self.held_out(wildcards) or self.training(wildcards)

    def films(self, wildcards: Any) -> list[str]:
        """Every film, without films of held-out cameras when no held-out camera remains."""
        return [film for film in self.plan.films if film != "heldout" or self.held_out(wildcards)]

    def renders(self, wildcards: Any) -> list[str]:
        """Every film, and "train": the training cameras' own views."""
        return ["train", *self.films(wildcards)]

    def heldout_film(self, wildcards: Any) -> list[str]:
        """The film of the held-out cameras, if there is one."""
        return [film for film in self.films(wildcards) if film == "heldout"]

    def evaluated_film(self, wildcards: Any) -> list[str]:
        """The film that is compared with photos: that of the held-out cameras, or else "train"."""
        return self.heldout_film(wildcards) or ["train"]

    # ---- detections ----

    def first_detection(self, wildcards: Any) -> list[str]:
        """First detections of one camera, without knowledge of other cameras; none in a known empty room."""
        return [f"results/{wildcards.scene}/tracks/{wildcards.camera}.npz"] if self.plan.people else []

    def first_detections(self, wildcards: Any) -> list[str]:
        """First detections of every training camera."""
        cameras = self.training(wildcards) if self.plan.people else []
        return [f"results/{wildcards.scene}/tracks/{camera}.npz" for camera in cameras]

    def detection(self, wildcards: Any) -> list[str]:
        """Detections of one camera after the second pass; recorded keypoints have no second pass."""
        return [self._refined_detections(wildcards.scene, wildcards.camera)] if self.plan.people else []

    def detections(self, wildcards: Any) -> list[str]:
        """Detections of every training camera after the second pass."""
        cameras = self.training(wildcards) if self.plan.people else []
        return [self._refined_detections(self._scene(wildcards), camera) for camera in cameras]

    def association_detections(self, wildcards: Any) -> list[str]:
        """Detections as association compares them: with pelvises at the scene's depth if so configured."""
        if not (self.plan.people and self.plan.lifts_pelvises):
            return self.detections(wildcards)
        return [f"results/{self._scene(wildcards)}/people/lifted/{camera}.npz" for camera in self.training(wildcards)]

    def first_raw_detections(self, wildcards: Any) -> list[str]:
        """The detector's first files, with masks, of the training cameras in which it ran."""
        return [f"results/{self._scene(wildcards)}/detect/found/{camera}.npz" for camera in self._detected(wildcards)]

    def raw_detections(self, wildcards: Any) -> list[str]:
        """The detector's files after the second pass."""
        return [f"results/{self._scene(wildcards)}/people/seen/{camera}.npz" for camera in self._detected(wildcards)]

    def own_plates(self, wildcards: Any) -> list[str]:
        """Plates of the training cameras for which the user gave a picture of the empty room."""
        brought = [camera for camera in self.training(wildcards) if camera in self.plan.dataset.plates]
        return [f"results/{self._scene(wildcards)}/plates/{camera}.png" for camera in brought if self.plan.people]

    def _detected(self, wildcards: Any) -> list[str]:
        looked = self.plan.person_sources.detector_cameras if self.plan.people else []
        return [camera for camera in self.training(wildcards) if camera in looked]

    def _refined_detections(self, scene: str, camera: str) -> str:
        if camera in self.plan.person_sources.detector_cameras:
            return f"results/{scene}/people/detections/{camera}.npz"
        return f"results/{scene}/tracks/{camera}.npz"

    def detector_masks(self, wildcards: Any) -> list[str]:
        """The detector's masks of one camera, its detections, and the identities; none where it did not run."""
        if wildcards.camera not in self.plan.person_sources.detector_cameras:
            return []
        folder = f"results/{wildcards.scene}/people"
        masks = f"{folder}/seen/{wildcards.camera}.npz"
        return [masks, *self.detection(wildcards), f"{folder}/identities.tsv"]

    # ---- people ----

    def people_table(self, wildcards: Any) -> list[str]:
        """The table of people; none when the room is known to be empty."""
        return [f"results/{wildcards.scene}/people/people.tsv"] if self.plan.people else []

    def identities(self, wildcards: Any) -> list[str]:
        """The identity of every track; none when the room is known to be empty."""
        return [f"results/{wildcards.scene}/people/identities.tsv"] if self.plan.people else []

    def association(self, wildcards: Any) -> list[str]:
        """The reason for every track's identity, and the people left out; none when the room is known to be empty."""
        return [f"results/{wildcards.scene}/people/association.json"] if self.plan.people else []

    def people(self, wildcards: Any) -> list[str]:
        """Ids of the people from association; none, without waiting for it, when the room is known to be empty."""
        if not self.plan.people:
            return []
        return read_people(_fetched(self._associated(wildcards).people))

    def person_tracks(self, wildcards: Any) -> list[str]:
        """The file of one person's tracks, so that changes of other people do not rerun this person's jobs."""
        return [self._who(wildcards, f"{wildcards.person}.tsv")]

    def readouts_for(self, wildcards: Any) -> list[str]:
        """The readout times of the cameras; none without ``people.fit.rolling_shutter``."""
        if not self.config["people"]["fit"]["rolling_shutter"]:
            return []
        return [self._who(wildcards, "readouts.json")]

    def fits(self, wildcards: Any) -> list[str]:
        """Body file of every person."""
        return [f"results/{wildcards.scene}/people/{person}.npz" for person in self.people(wildcards)]

    def people_in_room(self, wildcards: Any) -> list[str]:
        """Bodies of the people whom unseen walls enclose and whose paths furniture may not block; none where a network
        decides alone."""
        depth = self.config["depth"]
        return self.fits(wildcards) if depth["primitives"] or depth["source"] == "embedded" else []

    def filmed_people(self, wildcards: Any) -> list[str]:
        """The training cameras; none when association found no person."""
        return self.training(wildcards) if self.people(wildcards) else []

    def masks(self, wildcards: Any) -> list[str]:
        """Person masks of every training camera; none when there are no people."""
        return [f"results/{wildcards.scene}/masks/{camera}.mkv" for camera in self.filmed_people(wildcards)]

    def half_trained(self, wildcards: Any) -> list[str]:
        """Gaussians, provenance, path and film of the half-trained room that a network repaired, if one is selected."""
        parts = ("half.ply", "half.npz", "half.json", "refined.mkv") if self.plan.networks.refiner else ()
        return [f"results/{wildcards.scene}/background/{name}" for name in parts]

    def first_pictures(self, wildcards: Any) -> list[str]:
        """Footage of the training cameras, where training uses their first pictures instead of the plates."""
        if self.config["background"]["room_targets"] == "plates":
            return []
        return [f"results/{wildcards.scene}/capture/{camera}.mkv" for camera in self.training(wildcards)]

    def first_masks(self, wildcards: Any) -> list[str]:
        """Masks of people in those pictures; none when there are no people."""
        return self.masks(wildcards) if self.first_pictures(wildcards) else []

    def key_frames(self, wildcards: Any) -> list[str]:
        """Footage of the training cameras, where a network gets their first pictures with the people in them."""
        shown = self.config["views"]["key_frames"] == "first_frames" and self.plan.networks.views != "warp"
        return (
            [f"results/{wildcards.scene}/capture/{camera}.mkv" for camera in self.training(wildcards)] if shown else []
        )

    def key_masks(self, wildcards: Any) -> list[str]:
        """Masks of people in those pictures; none where depth of that moment has the people already."""
        return self.masks(wildcards) if self.key_frames(wildcards) and not self.plan.networks.first_depth else []

    def key_people(self, wildcards: Any) -> list[str]:
        """Bodies of those people."""
        return self.fits(wildcards) if self.key_frames(wildcards) and not self.plan.networks.first_depth else []

    def key_body(self, wildcards: Any) -> list[str]:
        """The body model of those people; none without them."""
        return [self.body] if self.key_people(wildcards) else []

    def people_of_views(self, wildcards: Any) -> list[str]:
        """Bodies of the people whom views of those pictures show; none where a network masks them."""
        return self.fits(wildcards) if self.key_frames(wildcards) and not self.plan.networks.people_in_views else []

    def people_in_views(self, wildcards: Any) -> list[str]:
        """Masks of people in one gap's film by the detecting network; none where bodies give the masks."""
        looked = self.plan.networks.people_in_views and self.key_frames(wildcards)
        return [f"results/{wildcards.scene}/views/{wildcards.segment}.people.mkv"] if looked else []

    def uncorrected_identities(self, wildcards: Any) -> list[str]:
        """Association's own identities, where the user's table replaces them; none without such a table."""
        needed = self.corrected_identities and self.plan.people
        return [f"results/{self._scene(wildcards)}/people/by_itself/identities.tsv"] if needed else []

    def recognition(self, wildcards: Any) -> list[str]:
        """The detector's scores of people in the films; none when there are no people."""
        return [f"results/{wildcards.scene}/report/recognition.json"] if self.people(wildcards) else []

    def human_gaussians(self, wildcards: Any) -> list[str]:
        """Canonical Gaussians of every person."""
        return [f"results/{wildcards.scene}/humans/{person}.ply" for person in self.people(wildcards)]

    def human_avatars(self, wildcards: Any) -> list[str]:
        """Skinning weights and motion of every person."""
        return [f"results/{wildcards.scene}/humans/{person}.npz" for person in self.people(wildcards)]

    def training_renders(self, wildcards: Any) -> list[str]:
        """Film, path and depth of the training cameras, for an enhancer; none without one."""
        section = step_section("enhance.shot", self.config)
        if section["enhancer"] == "none" and not section["injection"]["history"]:
            return []
        return [f"results/{wildcards.scene}/render/train.{kind}" for kind in ("mkv", "json", "depth.mkv")]

    def enhanced_segments(self, wildcards: Any, kind: str = "mkv") -> list[str]:
        """Segments of a film that a network enhances, each a job; none for films of one segment, and for a segment."""
        cameras = self.held_out(wildcards) if wildcards.shot == "heldout" and self.plan.networks.enhance else []
        if len(cameras) < 2 or hasattr(wildcards, "camera"):
            return []
        return [f"results/{wildcards.scene}/enhance/{wildcards.shot}/{camera}.{kind}" for camera in cameras]

    def made_films(self, wildcards: Any) -> list[str]:
        """The film of a shot that the user made with another tool, or its segments."""
        return self.external_film(wildcards) or self.enhanced_segments(wildcards)

    def segment_decisions(self, wildcards: Any) -> list[str]:
        """The decisions about a film as its segments were made by them, all the same."""
        return [] if self.external_film(wildcards) else self.enhanced_segments(wildcards, "decisions.json")

    def film_depth(self, wildcards: Any) -> list[str]:
        """Rendered depth of the held-out cameras' film, where no exact truth says what is seen."""
        films = [] if self.truth(wildcards) else self.heldout_film(wildcards)
        return [f"results/{wildcards.scene}/render/{film}.depth.mkv" for film in films]

    def region_depths(self, wildcards: Any) -> list[str]:
        """Depth of the training cameras that it is compared with."""
        cameras = self.training(wildcards) if self.film_depth(wildcards) else []
        return [f"results/{wildcards.scene}/depth/{camera}.exr" for camera in cameras]

    def region_masks(self, wildcards: Any) -> list[str]:
        """Masks of people in those cameras."""
        return self.masks(wildcards) if self.film_depth(wildcards) else []

    def region_body(self, wildcards: Any) -> list[str]:
        """The body model of the people in the film."""
        return [self.body] if self.film_depth(wildcards) and self.people(wildcards) else []

    # ---- decisions of the survey ----

    def verdict(self, effect: str, wildcards: Any) -> str:
        """The survey's verdict on an effect: on, off or undetermined; at once where ``survey.force`` decides it."""
        return self.plan.forced_effects.get(effect) or self._decided(effect, wildcards).verdict

    def _decided(self, effect: str, wildcards: Any) -> Decision:
        decided = _fetched(self.checkpoints.survey_decide.get(scene=self._scene(wildcards)).output.decisions)
        with step_file_context(decided):
            return read_decisions(decided)[effect]

    def gains(self, wildcards: Any) -> list[str]:
        """The gains of the cameras: a file, where the survey turned exposure correction on."""
        wanted = self.verdict("exposure", wildcards) == "on"
        return [f"results/{wildcards.scene}/survey/gains.json"] if wanted else []

    def specularity(self, wildcards: Any) -> list[str]:
        """The file of view-dependent colours, where the survey turned them on."""
        wanted = self.verdict("view_dependent_colour", wildcards) == "on"
        return [f"results/{wildcards.scene}/survey/specularity.json"] if wanted else []

    def brightness(self, wildcards: Any) -> list[str]:
        """The brightness of every frame: a file, where the survey measured that the light changes."""
        wanted = self.verdict("changing_light", wildcards) == "on"
        return [f"results/{wildcards.scene}/survey/brightness.json"] if wanted else []

    def exposure(self, wildcards: Any) -> list[str]:
        """All factors that divide pictures before they are compared: gains of cameras, brightness of frames."""
        return [*self.gains(wildcards), *self.brightness(wildcards)]

    def segments(self, wildcards: Any) -> list[str]:
        """Gaps that get synthesised views, as the survey selects; not the widest unless ``closed_path`` is on."""
        forced = self.plan.forced_effects.get("view_synthesis")
        if forced == "off" or self.config["background"]["views_share"] == 0:
            return []
        chosen = self.plan.segments[: len(self.training(wildcards))]
        if not forced:
            parts = self._decided("view_synthesis", wildcards).detail.get("parts", {})
            chosen = [name for name in chosen if parts.get(name, {}).get("verdict") == "on"]
        closed = self.plan.forced_effects.get("closed_path")
        if chosen and closed != "on":
            path = self._decided("closed_path", wildcards)
            if closed == "off" or path.verdict != "on":
                chosen = [name for name in chosen if name != path.detail["widest"]]
        return chosen

    def views(self, wildcards: Any) -> list[str]:
        """The synthesised views of every gap."""
        return [f"results/{wildcards.scene}/views/{segment}.mkv" for segment in self.segments(wildcards)]

    def view_masks(self, wildcards: Any) -> list[str]:
        """Masks of the pixels of those views that cameras saw."""
        return [f"results/{wildcards.scene}/views/{segment}.mask.mkv" for segment in self.segments(wildcards)]

    def loose_objects(self, wildcards: Any) -> list[str]:
        """Loose and carried objects; none unless the survey detects some."""
        wanted = self.verdict("dynamic_objects", wildcards) == "on"
        return [f"results/{self._scene(wildcards)}/objects/objects.npz"] if wanted else []

    def room_light(self, wildcards: Any) -> list[str]:
        """The light for people's shadows; none unless the survey turns moving shadows on and there are people."""
        wanted = self.people(wildcards) and self.verdict("moving_shadows", wildcards) == "on"
        return [f"results/{wildcards.scene}/render/room.light.json"] if wanted else []

    def room_shade(self, wildcards: Any) -> list[str]:
        """The shadows in that light, for the player."""
        return [f"results/{wildcards.scene}/render/room.shade.npz"] if self.room_light(wildcards) else []

    # ---- Snakemake's checkpoints ----

    def _scene(self, wildcards: Any) -> str:
        """The scene in the rule's wildcards; the run's own for a rule without one."""
        return getattr(wildcards, "scene", self.plan.scene)

    def _associated(self, wildcards: Any) -> Any:
        return self.checkpoints.people_associate.get(scene=self._scene(wildcards)).output

    def _who(self, wildcards: Any, name: str) -> str:
        """A file of the folder ``who``, once it is there; as a result and not where an object storage's copy is."""
        self._associated(wildcards)
        return f"results/{self._scene(wildcards)}/people/who/{name}"


def _fetched(output: Any) -> Path:
    """Where a checkpoint's output is; Snakemake fetches one that only an object storage has, and asks again."""
    if getattr(output, "is_storage", False) and not Path(output).exists():
        with output.open():
            pass
    return Path(output)
