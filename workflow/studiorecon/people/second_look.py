# SPDX-License-Identifier: Apache-2.0
"""``people.second_look``: detects again in one camera's pictures, where the other cameras predict a person.

The other cameras' agreement is projected into this camera. The landmark network runs where no person of that name was
detected, or one with other landmarks. With two cameras, each predicts the other's people by its network's metric guess.
Detections that agree with the other cameras are kept; those on another person, and duplicates, are removed. One camera
alone cannot distinguish a hidden person from a missed one; several calibrated ones can.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.body.model import BodyModel
from studiorecon.camera_files.calibration import find_lens
from studiorecon.camera_files.colmap import read_model
from studiorecon.detector.blazepose import LAYOUT, MASK_PX, BlazePose, Landmarks
from studiorecon.detector.crops import region_of_body
from studiorecon.detector.frame_detection import detect_in_region
from studiorecon.detector.hand_landmarks import HandLandmarks
from studiorecon.detector.network_files import DetectorFiles
from studiorecon.detector.tracking import keypoints_with_confidence
from studiorecon.footage.frames import read_stills
from studiorecon.footage.source import FootageSource, open_source
from studiorecon.geometry.lens import video_from_working, working_from_video
from studiorecon.keypoints.hands import SIDES
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.people.expected_keypoints import (
    BELIEVED,
    BETTER,
    ExpectedKeypoints,
    Plan,
    agreement,
    plan_second_look,
    project_expected,
    swap_left_right,
)
from studiorecon.people.fit_settings import HandSettings, TriangulationSettings
from studiorecon.people.hand_search import arms_in_view, find_hands, hands_of_rows, interpolate_hands
from studiorecon.people.monocular_guess import is_left_right_swapped, project_guess
from studiorecon.progress import progress, say
from studiorecon.rig.body_points import person_tracks
from studiorecon.rig.hand_sizes import hand_sizes_px, large_hands
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, read_manifest
from studiorecon.scene.clocks import Clocks, read_clocks
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, read_detections, read_identities, write_detections
from studiorecon.scene.raw_detections import read_raw_detections, write_raw_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num


@dataclass(frozen=True)
class Settings(HandSettings, TriangulationSettings):
    """Limits of agreement between views, and whether hands are searched for."""


@dataclass(frozen=True)
class SecondLook:
    """A new detection: frame, index of the person, detection that is replaced (-1 = none), and working pixels (K,
    3)."""

    frame: int
    person: int
    replaces: int
    seen: Landmarks
    keypoints: Float[np.ndarray, "K 3"]


def redetect(
    network: BlazePose,
    pictures: Iterable[Integer[np.ndarray, "H W 3"]],
    plan: Plan,
    people: Sequence[ExpectedKeypoints],
    own: Detections,
    view: CameraPictures,
) -> list[SecondLook]:
    """New detections in ``pictures`` (those of the frames of ``plan.searches``, in order) that agree with the other
    cameras."""
    results = []
    names = LAYOUTS[LAYOUT].keypoints
    frames = sorted({frame for frame, _, _ in plan.searches})
    for frame, picture in zip(frames, pictures):
        for _, k, before in (look for look in plan.searches if look[0] == frame):
            # Predicted at the time of the picture; the landmarks are then moved to the frame's own time.
            now = people[k].at(frame)
            place = people[k].at(frame, view.late_frames(frame, now)) if now is not None else None
            region = (
                region_of_body(dict(zip(names, view.in_footage(place))), view.footage.source_wh)
                if place is not None
                else None
            )
            first = detect_in_region(network, picture, region) if region is not None else None
            if first is None or place is None or now is None:
                continue
            # The network's own region is better, unless it contains another person.
            tried = [first, *filter(None, [detect_in_region(network, picture, first.next_region)])]
            looks = [SecondLook(frame, k, before, t, view.working(t)) for t in tried]
            near = people[k].near_share
            best = max(looks, key=lambda look: agreement(look.keypoints, place, near))
            least = BELIEVED if before < 0 else max(BELIEVED, agreement(own.keypoints[before], place, near) + BETTER)
            if agreement(best.keypoints, place, near) >= least:
                back = np.column_stack([np.nan_to_num(now - place), np.zeros(len(now))])
                results.append(replace(best, keypoints=best.keypoints + back))
    return results


@dataclass(frozen=True)
class CameraPictures:
    """One camera's footage, lens and clock, and the confidence factor of its landmarks."""

    footage: Footage
    lens: Lens
    worth: dict[str, list[float]]
    clocks: Clocks

    def late_frames(self, frame: int, pixels: Num[np.ndarray, "K 2"]) -> Float[np.ndarray, " K"]:
        """Delay of each working pixel in the picture of ``frame``, in working frames: the picture's and its row's."""
        rows = np.nan_to_num(pixels[:, 1] / self.footage.wh[1], nan=0.5) - 0.5
        readout = self.clocks.of(self.footage.camera).readout_s * self.clocks.fps
        return self.clocks.late_frames(self.footage.camera)[frame] + readout * rows

    def in_footage(self, pixels: Num[np.ndarray, "K 2"]) -> Float[np.ndarray, "K 2"]:
        """Working pixels converted to pixels of the footage."""
        return video_from_working(pixels, self.lens, self.footage.source_wh, np.array(self.footage.intrinsics))

    def in_working(self, pixels: Num[np.ndarray, "K 2"]) -> tuple[Float[np.ndarray, "K 2"], Bool[np.ndarray, " K"]]:
        """Pixels of the footage converted to working pixels, and where that is possible."""
        return working_from_video(pixels, self.lens, self.footage.source_wh, np.array(self.footage.intrinsics))

    def working(self, seen: Landmarks) -> Float[np.ndarray, "K 3"]:
        """Working pixels and confidence of landmarks; NaN and 0 where there are none."""
        keypoints = keypoints_with_confidence(seen, self.footage.source_wh, self.worth)
        there = keypoints[:, 2] > 0
        pixels, valid = self.in_working(np.where(there[:, None], keypoints[:, :2], 1.0))
        there &= valid
        return np.column_stack([np.where(there[:, None], pixels, np.nan), np.where(there, keypoints[:, 2], 0.0)])

    def raw(self, look: SecondLook) -> tuple:
        """The row of the detector's file for a new detection."""
        seen, keypoints = look.seen, keypoints_with_confidence(look.seen, self.footage.source_wh, self.worth)
        crop = seen.region.crop_from_picture(MASK_PX)
        return self.footage.used[look.frame], keypoints, seen.presence, seen.points_m, seen.mask, crop


def improve_detections(
    own: Detections,
    plan: Plan,
    looks: Sequence[SecondLook],
    people: Sequence[ExpectedKeypoints],
    owners: Sequence[str],
    row: int,
) -> Detections:
    """The camera's detections after ``plan``, with the new ones, whose masks are rows ``row`` and after."""
    kept = ~plan.drop
    kept[[look.replaces for look in looks if look.replaces >= 0]] = False
    keypoints, guess = own.keypoints.copy(), np.array(own.points_m)
    keypoints[plan.swap_sides] = swap_left_right(own.layout, keypoints[plan.swap_sides])
    guess[plan.swap_sides] = swap_left_right(own.layout, guess[plan.swap_sides])
    first = replace(own, track=plan.track, keypoints=keypoints, points_m=guess).only(kept)
    whose = np.array(owners, dtype=object)
    fresh = max(plan.track, default=-1) + 1
    tracks = []
    for look in looks:
        theirs = np.flatnonzero(whose == people[look.person].person)
        near = theirs[np.argmin(np.abs(own.frame[theirs] - look.frame))] if len(theirs) else None
        tracks.append(
            plan.track[look.replaces]
            if look.replaces >= 0
            else plan.track[near]
            if near is not None
            else fresh + look.person
        )
    whole = replace(
        first,
        frame=np.concatenate([first.frame, np.array([look.frame for look in looks], dtype=np.int64)]),
        track=np.concatenate([first.track, np.array(tracks, dtype=np.int64)]),
        keypoints=np.concatenate(
            [first.keypoints, np.array([look.keypoints for look in looks]).reshape(-1, *own.keypoints.shape[1:])]
        ),
        points_m=np.concatenate(
            [np.array(first.points_m), np.array([look.seen.points_m for look in looks]).reshape(-1, *guess.shape[1:])]
        ),
        row=np.concatenate([np.array(first.row), row + np.arange(len(looks))]),
    )
    return whole.only(np.argsort(whole.frame, kind="stable"))


def with_hands(
    network: HandLandmarks,
    source: FootageSource,
    view: CameraPictures,
    own: Detections,
    who: Mapping[tuple[str, int], str],
    people: Sequence[ExpectedKeypoints],
    large: Float[np.ndarray, "P T 2"],
) -> Detections:
    """``own`` with the hands that are searched for in the pictures of ``source``: those with a size in ``large``."""
    names = [p.person for p in people]
    person = np.array(
        [names.index(p) if p in names else -1 for p in (who.get((own.camera, int(t)), "") for t in own.track)]
    )
    arms = arms_in_view(own, person, people, large, view.in_footage, view.clocks.fps)
    frames = sorted({arm.frame for arm in arms})
    wanted = [view.footage.used[frame] for frame in frames]
    pictures = progress(read_stills(source, wanted), f"hands of {own.camera}", len(wanted))
    found = find_hands(network, pictures, arms)
    hands, right = hands_of_rows(found, len(own.frame), view.in_working)
    for row, side in found:
        now = people[person[row]].at(int(own.frame[row]))
        if now is not None and view.clocks.late_frames(own.camera).any():
            place = people[person[row]].at(int(own.frame[row]), view.late_frames(int(own.frame[row]), now))
            wrist = LAYOUTS[own.layout].index(f"{SIDES[side]}_wrist")
            hands[row, side, :, :2] += np.nan_to_num((now - place)[wrist])
    whole = interpolate_hands(hands, own, person, view.clocks.fps)
    say(f"camera {own.camera}: {len(found)} hands found at {len(arms)} ends of arms in {len(frames)} pictures")
    return replace(own, hands=whole, hands_right=right)


@dataclass(frozen=True)
class CameraFiles:
    """A camera's footage, and the files with its lens and clock."""

    source: Path
    picture_fps: float
    manifest: Path
    calibration: Path
    clocks: Path


@dataclass(frozen=True)
class FirstFiles:
    """Files of the first association: ``found``, the camera's file of the detector; ``first``, detections of all
    training cameras; and their ``identities``."""

    found: Path
    first: list[Path]
    identities: Path


def run(
    settings: Settings,
    camera: str,
    footage: CameraFiles,
    before: FirstFiles,
    detector: DetectorFiles,
    hand_network: list[Path],
    model: Path,
    body: Path,
    detections: Written,
    seen: Written,
    report: Written,
) -> None:
    """Write ``detections`` (the camera's, improved), ``seen`` (the detector's file and what was added) and ``report``
    (JSON, how many). ``hand_network``: the network for hands, none where they are off."""
    cameras, who = read_model(model.parent), read_identities(before.identities)
    given = [read_detections(path) for path in before.first]
    at = [c.name for c in cameras].index(camera)
    own, whole = given[at], read_raw_detections(before.found, masks=True)
    about_footage = read_manifest(footage.manifest)
    filmed = about_footage.of(camera)
    view = CameraPictures(filmed, find_lens(footage.calibration, camera), detector.worth(), read_clocks(footage.clocks))
    names = sorted({p for p in who.values() if p})
    if len(cameras) > 2:
        about = BodyModel.load(body), filmed.frames, settings.triangulation
        people = [project_expected(p, at, cameras, given, who, *about) for p in names]
    else:
        people = [project_guess(p, at, cameras, given, who, filmed.frames) for p in names]
    plan = plan_second_look(own, people, who, filmed.frames)
    owners = [who.get((camera, int(t)), "") for t in own.track]
    if len(cameras) == 2:
        # Which of two cameras that disagree has left and right swap_left_right: the one that contradicts itself.
        plan = replace(plan, swap_sides=plan.swap_sides & is_left_right_swapped(own, cameras[at], owners, filmed.fps))
    wanted = [filmed.used[frame] for frame in sorted({look[0] for look in plan.searches})]
    source = open_source(footage.source, footage.picture_fps)
    pictures = progress(read_stills(source, wanted), f"frames of {camera}", len(wanted))
    looks = redetect(detector.placer(), pictures, plan, people, own, view)
    result = improve_detections(own, plan, looks, people, owners, len(whole.frame))
    arms_px = hand_sizes_px(
        person_tracks(given, who, names, filmed.frames, settings.triangulation.min_confidence),
        cameras,
        [about_footage.of(c.name).film_px for c in cameras],
    )
    large = large_hands(arms_px, settings.hands)[at]
    if large.any():
        result = with_hands(HandLandmarks(hand_network[0]), source, view, result, who, people, large)
    write_detections(detections, result)
    write_raw_detections(seen, whole.grown([view.raw(look) for look in looks]))
    counts = _counts(own, plan, looks, result)
    write_json(report, {"camera": camera, **counts})
    say(
        f"camera {camera}: {counts['detections']} detections; searched again at {counts['looked']} predicted "
        f"places: {counts['added']} added, {counts['replaced']} replaced, {counts['removed']} removed; left and "
        f"right exchanged in {counts['sides_exchanged']}; {counts['adopted']} assigned to the person they fit"
    )


def _counts(own: Detections, plan: Plan, looks: Sequence[SecondLook], result: Detections) -> dict[str, int]:
    replaced = sum(look.replaces >= 0 for look in looks)
    return {
        "detections": len(own.frame),
        "looked": len(plan.searches),
        "added": len(looks) - replaced,
        "replaced": replaced,
        "sides_exchanged": int(plan.swap_sides.sum()),
        "adopted": int((plan.track != own.track).sum()),
        "removed": len(own.frame) + len(looks) - replaced - len(result.frame),
    }
