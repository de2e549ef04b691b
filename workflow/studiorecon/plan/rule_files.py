# SPDX-License-Identifier: Apache-2.0
"""The files that rules take, where these hang on the plan, on who was found, or on what the survey decided."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from studiorecon.plan.brought import Brought
from studiorecon.plan.decisions import Plan
from studiorecon.plan.told import section
from studiorecon.scene.intermediate import read
from studiorecon.scene.people import read_people
from studiorecon.scene.schema import Anything, Named


class Files(Brought):
    """Input functions of all rules: what was brought, and what other rules make.

    What asks one of Snakemake's ``checkpoints`` raises Snakemake's own exception until that has run.
    """

    def __init__(
        self, plan: Plan, config: Mapping[str, Any], home: Path, local: Callable[[str], str], checkpoints: Any
    ) -> None:
        super().__init__(plan, config, home, local)
        self.checkpoints = checkpoints

    # ---- which cameras take part ----

    def cameras(self, wildcards: Any) -> list[str]:
        """Every camera of the plan; where the cameras are found from people, those that people place."""
        if not self.plan.from_people:
            return self.plan.cameras
        found = self.checkpoints.calibration_from_people.get(scene=self._scene(wildcards)).output.calibration
        placed = read(Path(found), Named(Anything()), lambda held: {lens["name"] for lens in held["lenses"]})
        return [camera for camera in self.plan.cameras if camera in placed]

    def training(self, wildcards: Any) -> list[str]:
        """Those of them that the scene is made from."""
        return [camera for camera in self.cameras(wildcards) if camera in self.plan.training]

    def held_out(self, wildcards: Any) -> list[str]:
        """Those of them that only the report looks at."""
        return [camera for camera in self.cameras(wildcards) if camera in self.plan.held_out]

    def judged_cameras(self, wildcards: Any) -> list[str]:
        """Those whose photos are compared with pictures: the held-out ones, or for want of them those of training."""
        return self.held_out(wildcards) or self.training(wildcards)

    def films(self, wildcards: Any) -> list[str]:
        """Every film; none of held-out cameras where none of them is left."""
        return [film for film in self.plan.films if film != "heldout" or self.held_out(wildcards)]

    def drawn(self, wildcards: Any) -> list[str]:
        """Every film, and "train": the training cameras themselves."""
        return ["train", *self.films(wildcards)]

    def heldout_film(self, wildcards: Any) -> list[str]:
        """The film of the held-out cameras, where there is one."""
        return [film for film in self.films(wildcards) if film == "heldout"]

    def judged(self, wildcards: Any) -> list[str]:
        """What is compared with photos: that film, or for want of it the training cameras."""
        return self.heldout_film(wildcards) or ["train"]

    # ---- what cameras saw of people ----

    def first_detection(self, wildcards: Any) -> list[str]:
        """What one camera alone says of people; none when nobody can be there."""
        return [f"results/{wildcards.scene}/tracks/{wildcards.camera}.npz"] if self.plan.people else []

    def first_detections(self, wildcards: Any) -> list[str]:
        """The same of every training camera."""
        cameras = self.training(wildcards) if self.plan.people else []
        return [f"results/{wildcards.scene}/tracks/{camera}.npz" for camera in cameras]

    def detection(self, wildcards: Any) -> list[str]:
        """The same of one camera after the second look, which recorded keypoints do not have."""
        return [self._looked_at(wildcards.scene, wildcards.camera)] if self.plan.people else []

    def detections(self, wildcards: Any) -> list[str]:
        """The same of every training camera after the second look."""
        cameras = self.training(wildcards) if self.plan.people else []
        return [self._looked_at(self._scene(wildcards), camera) for camera in cameras]

    def compared(self, wildcards: Any) -> list[str]:
        """The same as association compares it: with pelvises at the scene's depth where that is asked for."""
        if not (self.plan.people and self.plan.lifted):
            return self.detections(wildcards)
        return [f"results/{self._scene(wildcards)}/people/lifted/{camera}.npz" for camera in self.training(wildcards)]

    def first_found(self, wildcards: Any) -> list[str]:
        """The detector's files, with masks, of the training cameras in which it looked."""
        return [f"results/{self._scene(wildcards)}/detect/found/{camera}.npz" for camera in self._detected(wildcards)]

    def found(self, wildcards: Any) -> list[str]:
        """The same after the second look."""
        return [f"results/{self._scene(wildcards)}/people/seen/{camera}.npz" for camera in self._detected(wildcards)]

    def own_plates(self, wildcards: Any) -> list[str]:
        """Plates of the training cameras of whose empty room the user has brought a picture."""
        brought = [camera for camera in self.training(wildcards) if camera in self.plan.dataset.plates]
        return [f"results/{self._scene(wildcards)}/plates/{camera}.png" for camera in brought if self.plan.people]

    def _detected(self, wildcards: Any) -> list[str]:
        looked = self.plan.sight.detected if self.plan.people else []
        return [camera for camera in self.training(wildcards) if camera in looked]

    def _looked_at(self, scene: str, camera: str) -> str:
        if camera in self.plan.sight.detected:
            return f"results/{scene}/people/detections/{camera}.npz"
        return f"results/{scene}/tracks/{camera}.npz"

    def seen_people(self, wildcards: Any) -> list[str]:
        """The detector's masks of one camera, its detections, and who is who; nothing where it did not look."""
        if wildcards.camera not in self.plan.sight.detected:
            return []
        folder = f"results/{wildcards.scene}/people"
        masks = f"{folder}/seen/{wildcards.camera}.npz"
        return [masks, *self.detection(wildcards), f"{folder}/identities.tsv"]

    # ---- who was found ----

    def people_table(self, wildcards: Any) -> list[str]:
        """The table of people; none when the room is known to be empty."""
        return [f"results/{wildcards.scene}/people/people.tsv"] if self.plan.people else []

    def identities(self, wildcards: Any) -> list[str]:
        """Whose every track is; none when the room is known to be empty."""
        return [f"results/{wildcards.scene}/people/identities.tsv"] if self.plan.people else []

    def association(self, wildcards: Any) -> list[str]:
        """Why every track is whose it is, and who was left out; none when the room is known to be empty."""
        return [f"results/{wildcards.scene}/people/association.json"] if self.plan.people else []

    def people(self, wildcards: Any) -> list[str]:
        """Ids of the people that association found; none, without asking, when the room is known to be empty."""
        if not self.plan.people:
            return []
        return read_people(Path(self._associated(wildcards).people))

    def tracks_of(self, wildcards: Any) -> list[str]:
        """Which tracks are this person's, in a file of their own: a change of somebody else's is none of theirs."""
        return [f"{self._associated(wildcards).who}/{wildcards.person}.tsv"]

    def readouts_for(self, wildcards: Any) -> list[str]:
        """By how much rows look one after the other; nothing without ``people.fit.rolling_shutter``."""
        if not self.config["people"]["fit"]["rolling_shutter"]:
            return []
        return [f"{self._associated(wildcards).who}/readouts.json"]

    def fits(self, wildcards: Any) -> list[str]:
        """Body file of every person."""
        return [f"results/{wildcards.scene}/people/{person}.npz" for person in self.people(wildcards)]

    def walkers(self, wildcards: Any) -> list[str]:
        """Bodies of the people whose ways are kept free of furniture; none where ``depth.primitives`` wants none."""
        return self.fits(wildcards) if self.config["depth"]["primitives"] else []

    def sightings(self, wildcards: Any) -> list[str]:
        """What cameras saw of those people, which nothing can stand in front of."""
        return self.detections(wildcards) if self.walkers(wildcards) else []

    def sighted(self, wildcards: Any) -> list[str]:
        """Whose those sightings are."""
        return self.identities(wildcards) if self.sightings(wildcards) else []

    def filmed_people(self, wildcards: Any) -> list[str]:
        """Training cameras, if anybody was found whom they can show."""
        return self.training(wildcards) if self.people(wildcards) else []

    def masks(self, wildcards: Any) -> list[str]:
        """Person masks of every training camera; none when there are no people."""
        return [f"results/{wildcards.scene}/masks/{camera}.mkv" for camera in self.filmed_people(wildcards)]

    def half_trained(self, wildcards: Any) -> list[str]:
        """The room half-way and views of it that a network repaired, where one is asked: Gaussians, provenance, path,
        film."""
        parts = ("half.ply", "half.npz", "half.json", "refined.mkv") if self.plan.networks.refiner else ()
        return [f"results/{wildcards.scene}/background/{name}" for name in parts]

    def first_pictures(self, wildcards: Any) -> list[str]:
        """Footage of the training cameras, where their first pictures are trained on in the plates' place."""
        if self.config["background"]["photos"] == "plates":
            return []
        return [f"results/{wildcards.scene}/capture/{camera}.mkv" for camera in self.training(wildcards)]

    def first_masks(self, wildcards: Any) -> list[str]:
        """Who is in those pictures; none when there are no people."""
        return self.masks(wildcards) if self.first_pictures(wildcards) else []

    def key_frames(self, wildcards: Any) -> list[str]:
        """Footage of the training cameras, where a network is shown their first pictures with the people in them."""
        shown = self.config["views"]["key_frames"] == "first_frames" and self.plan.networks.views != "warp"
        return (
            [f"results/{wildcards.scene}/capture/{camera}.mkv" for camera in self.training(wildcards)] if shown else []
        )

    def key_masks(self, wildcards: Any) -> list[str]:
        """Who is in those pictures; none when there are no people."""
        return self.masks(wildcards) if self.key_frames(wildcards) else []

    def key_people(self, wildcards: Any) -> list[str]:
        """Their bodies."""
        return self.fits(wildcards) if self.key_frames(wildcards) else []

    def people_in_views(self, wildcards: Any) -> list[str]:
        """Who is in one segment's film by the network that looks for people; none where bodies say so."""
        looked = self.plan.networks.people_in_views and self.key_frames(wildcards)
        return [f"results/{wildcards.scene}/views/{wildcards.segment}.people.mkv"] if looked else []

    def by_itself(self, wildcards: Any) -> list[str]:
        """Who association says is who where the user's own table says otherwise; none without one."""
        asked = self.corrected and self.plan.people
        return [f"results/{self._scene(wildcards)}/people/by_itself/identities.tsv"] if asked else []

    def recognition(self, wildcards: Any) -> list[str]:
        """Whom the detector finds in the films; nothing where nobody is there to be found."""
        return [f"results/{wildcards.scene}/report/recognition.json"] if self.people(wildcards) else []

    def human_gaussians(self, wildcards: Any) -> list[str]:
        """Canonical Gaussians of every person."""
        return [f"results/{wildcards.scene}/humans/{person}.ply" for person in self.people(wildcards)]

    def human_avatars(self, wildcards: Any) -> list[str]:
        """Skinning and motion of every person."""
        return [f"results/{wildcards.scene}/humans/{person}.npz" for person in self.people(wildcards)]

    def drawn_beside_photos(self, wildcards: Any) -> list[str]:
        """Film, path and depth of the training cameras, which an enhancer compares with their photos; none where films
        stay as they are drawn."""
        told = section("enhance.shot", self.config)
        if told["enhancer"] == "none" and not told["injection"]["history"]:
            return []
        return [f"results/{wildcards.scene}/render/train.{kind}" for kind in ("mkv", "json", "depth.mkv")]

    # ---- what the survey decided ----

    def verdict(self, effect: str, wildcards: Any) -> str:
        """What the survey says of one effect: on, off or undetermined; without asking it where ``survey.force`` has."""
        return self.plan.forced.get(effect) or self._decided(effect, wildcards)["verdict"]

    def _decided(self, effect: str, wildcards: Any) -> Mapping[str, Any]:
        decided = self.checkpoints.survey_decide.get(scene=self._scene(wildcards)).output.decisions
        return read(Path(decided), Named(Anything()), lambda held: {d["effect"]: d for d in held["decisions"]}[effect])

    def gains(self, wildcards: Any) -> list[str]:
        """What the cameras' exposures are divided by: a file, where the survey calls for it."""
        wanted = self.verdict("exposure", wildcards) == "on"
        return [f"results/{wildcards.scene}/survey/gains.json"] if wanted else []

    def specularity(self, wildcards: Any) -> list[str]:
        """A file where the survey calls for colours that change with the direction of view."""
        wanted = self.verdict("view_dependent_colour", wildcards) == "on"
        return [f"results/{wildcards.scene}/survey/specularity.json"] if wanted else []

    def brightness(self, wildcards: Any) -> list[str]:
        """What every frame's brightness is divided by: a file, where the survey says that the light changes."""
        wanted = self.verdict("changing_light", wildcards) == "on"
        return [f"results/{wildcards.scene}/survey/brightness.json"] if wanted else []

    def exposure(self, wildcards: Any) -> list[str]:
        """All that pictures are divided by before they are compared: gains of cameras, brightness of frames."""
        return [*self.gains(wildcards), *self.brightness(wildcards)]

    def segments(self, wildcards: Any) -> list[str]:
        """Gaps between cameras that get new views: those for which the survey calls for them, without the widest where
        it leaves the stage open."""
        forced = self.plan.forced.get("view_synthesis")
        if forced == "off" or self.config["background"]["views_share"] == 0:
            return []
        chosen = self.plan.segments[: len(self.training(wildcards))]
        if not forced:
            parts = self._decided("view_synthesis", wildcards)["detail"].get("parts", {})
            chosen = [name for name in chosen if parts.get(name, {}).get("verdict") == "on"]
        closed = self.plan.forced.get("closed_path")
        if chosen and closed != "on":
            path = self._decided("closed_path", wildcards)
            if closed == "off" or path["verdict"] != "on":
                chosen = [name for name in chosen if name != path["detail"]["widest"]]
        return chosen

    def views(self, wildcards: Any) -> list[str]:
        """The new views of every segment."""
        return [f"results/{wildcards.scene}/views/{segment}.mkv" for segment in self.segments(wildcards)]

    def view_masks(self, wildcards: Any) -> list[str]:
        """Where those views show what cameras saw."""
        return [f"results/{wildcards.scene}/views/{segment}.mask.mkv" for segment in self.segments(wildcards)]

    def loose_objects(self, wildcards: Any) -> list[str]:
        """Loose and held things; none unless the survey finds some."""
        wanted = self.verdict("dynamic_objects", wildcards) == "on"
        return [f"results/{self._scene(wildcards)}/objects/objects.npz"] if wanted else []

    def room_light(self, wildcards: Any) -> list[str]:
        """The light by which people shade the room; none unless the survey calls for moving shadows and somebody is
        there to throw them."""
        wanted = self.people(wildcards) and self.verdict("moving_shadows", wildcards) == "on"
        return [f"results/{wildcards.scene}/render/room.light.json"] if wanted else []

    def room_shade(self, wildcards: Any) -> list[str]:
        """The shadows in that light, for the player."""
        return [f"results/{wildcards.scene}/render/room.shade.npz"] if self.room_light(wildcards) else []

    # ---- asked of Snakemake ----

    def _scene(self, wildcards: Any) -> str:
        """The rule's scene; the run's own for a rule without one."""
        return getattr(wildcards, "scene", self.plan.scene)

    def _associated(self, wildcards: Any) -> Any:
        return self.checkpoints.people_associate.get(scene=self._scene(wildcards)).output
