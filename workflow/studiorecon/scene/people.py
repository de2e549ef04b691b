# SPDX-License-Identifier: Apache-2.0
"""Detections per camera, identities, and bodies over time: the files under ``people/``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.files import write_npz, write_table
from studiorecon.scene.schema import CONFIDENT, ListOf, OptionalField, metres, radians, real, record, text, whole
from studiorecon.scene.step_files import expect, expect_named, read
from studiorecon.scene.user_files import read_rows
from studiorecon.scene.user_values import short_text

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num

PEOPLE_COLUMNS = ("person", "frames", "cameras", "confidence", "source", "status", "reason")
IDENTITY_COLUMNS = ("camera", "track", "person")
_PEOPLE = ListOf(
    {
        "person": text(),
        "frames": whole(low=0),
        "cameras": text(),
        "confidence": real(low=0, high=1, gaps=True),
        "source": text(),
        "status": text("person", "rejected"),
        "reason": text(),
    }
)
_IDENTITIES = ListOf({"camera": text(), "track": text(), "person": text()})
# A track that changes from one person to another is cut: in files "7@120" is track 7 from frame 120 on, in memory the
# number of that part is (120 + 1) · 10⁶ + 7. No camera has so many tracks, and 10⁸ frames fit into 64 bits.
_PART = 10**6
_TRACK = re.compile(r"(-?\d{1,6})(?:@(\d{1,8}))?", re.ASCII)
_DETECTIONS = {
    "camera": text(),
    "layout": text(),
    "frame": whole("D", low=0),
    "track": whole("D"),
    "keypoints": real("D K 3", gaps=True, such=CONFIDENT),
    "body_pose": OptionalField(radians("D 23 3")),
    "pelvis": OptionalField(real("D 3", gaps=True)),
    "body_root": OptionalField(radians("D 3")),
    "body_shape": OptionalField(real("D 10")),
    "points_m": OptionalField(metres("D K 3", gaps=True)),
    "row": OptionalField(whole("D", low=-1)),
    "hands": OptionalField(real("D 2 21 3", gaps=True, such=CONFIDENT)),
    "hands_right": OptionalField(real("D 2", low=0, high=1, gaps=True)),
}


@dataclass(frozen=True)
class Detections:
    """2D keypoints of one camera in undistorted working pixels (centres at +0.5).

    Attributes:
        layout: name of the keypoint layout (``keypoints/layouts.py``).
        frame: working frame of each detection.
        track: per-camera track id; a track lasts while the same person is followed in this camera.
        keypoints: x, y, confidence in [0, 1]; confidence 0 = missing (x, y are then NaN).
        body_pose: axis-angle of a monocular body's joints without the root, NaN where a detection has none, or None.
        pelvis: x, y of its pelvis joint in working pixels and its z-depth in metres, NaN where unknown, or None.
        body_root, body_shape: axis-angle of that body's root in its camera's frame; its shape, SMPL's; or None.
        points_m: a network's estimate of the keypoints in metres relative to the middle of the hips, camera's axes; or
            None.
        row: row in the detector's file that holds the person's mask (-1 = none); or None.
        hands: float32, the left and the right hand's points (``keypoints/hands.py``), as ``keypoints``; or None where
            no hand was searched for.
        hands_right: probability, by the network that found them, that each of ``hands`` is a right one, NaN where there
            is none; or None.
    """

    camera: str
    layout: str
    frame: Integer[np.ndarray, " D"]
    track: Integer[np.ndarray, " D"]
    keypoints: Float[np.ndarray, "D K 3"]
    body_pose: Num[np.ndarray, "D 23 3"] | None = None
    pelvis: Num[np.ndarray, "D 3"] | None = None
    body_root: Num[np.ndarray, "D 3"] | None = None
    body_shape: Num[np.ndarray, "D 10"] | None = None
    points_m: Num[np.ndarray, "D K 3"] | None = None
    row: Integer[np.ndarray, " D"] | None = None
    hands: Num[np.ndarray, "D 2 21 3"] | None = None
    hands_right: Num[np.ndarray, "D 2"] | None = None

    def only(self, which: Bool[np.ndarray, " D"] | Integer[np.ndarray, " M"]) -> Detections:
        """The detections selected by ``which`` (bool mask or indices)."""
        per_detection = [
            n for n in self.__dataclass_fields__ if n not in ("camera", "layout") and getattr(self, n) is not None
        ]
        return replace(self, **{name: getattr(self, name)[which] for name in per_detection})


@dataclass(frozen=True)
class Person:
    """One person's body over all working frames, AMASS-style.

    Attributes:
        name: ``p0``, ``p1``, …
        body: id of the body model and shape space (``BodyModel.identity``).
        poses: axis-angle, SMPL's 24-joint order, radians.
        trans: world position of the pelvis joint, metres.
        betas: shape, plus size if there is one more than the shape space has (``body.model.of_size``).
        joints: world joints, metres.
        valid: frames in which the body was measured (others are filled, so that films do not flicker).
        sigma: standard deviation of the joints, metres (inf where unknown).
        metric: True when lengths are metres.
        hand_poses, hand_joints, hand_sigma: axis-angles of SMPL-H's 30 finger joints, their places in the world and the
            deviations of those, as of ``joints``; None for a person whose fingers were not measured.
        hand_scale: lengths of the left and the right hand relative to the body model's; None likewise.
        present: frames in which the person is present (default: all). In others the arrays interpolate from the place
            of leaving to the place of return, for cameras that follow the person.
    """

    name: str
    body: str
    fps: float
    poses: Num[np.ndarray, "T 72"]
    trans: Num[np.ndarray, "T 3"]
    betas: Num[np.ndarray, " B"]
    joints: Num[np.ndarray, "T 24 3"]
    valid: Bool[np.ndarray, " T"]
    sigma: Num[np.ndarray, "T 24"]
    metric: bool
    present: Bool[np.ndarray, " T"] = field(default_factory=lambda: np.zeros(0, bool))
    hand_poses: Num[np.ndarray, "T 90"] | None = None
    hand_joints: Num[np.ndarray, "T 30 3"] | None = None
    hand_sigma: Num[np.ndarray, "T 30"] | None = None
    hand_scale: Num[np.ndarray, " 2"] | None = None

    def __post_init__(self) -> None:
        if not len(self.present):
            object.__setattr__(self, "present", np.ones(len(self.poses), bool))


def write_detections(path: Path, detections: Detections) -> None:
    fields = {name: getattr(detections, name) for name in Detections.__dataclass_fields__}
    write_npz(path, {name: value for name, value in fields.items() if value is not None})


def read_detections(path: Path) -> Detections:
    """The detections of the camera that names the file; raises UserError as ``step_files.read`` does."""

    def made(data: dict[str, Any]) -> Detections:
        expect_named(path, str(data["camera"]))
        return record(Detections, data)

    return read(path, _DETECTIONS, made)


def write_people(
    path: Path,
    rows: list[tuple[str, int, str, float, str]],
    rejected: Sequence[tuple[str, int, str, float, str, str, str]] = (),
) -> None:
    """Write ``people.tsv``: person, frames seen, cameras, confidence, source, status and reason.

    Cameras are comma-separated, confidence is 0..1, source "keypoints" or "corrected", status "person" or "rejected",
    with a reason; rejected rows follow the people, under names of their own. An empty room has no rows.
    """
    everybody = [*((*row, "person", "") for row in rows), *rejected]
    write_table(
        path, PEOPLE_COLUMNS, [(p, n, c, f"{confidence:.3f}", *rest) for p, n, c, confidence, *rest in everybody]
    )


def read_people(path: Path) -> list[str]:
    """Ids of the scene's people in ``people.tsv``, in file order; raises UserError as ``step_files.read`` does."""
    return [row["person"] for row in people_rows(path)]


def people_rows(path: Path) -> list[dict[str, Any]]:
    """The scene's people, column → value; raises UserError as ``step_files.read`` does."""

    def made(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        expect(len({row["person"] for row in rows}) == len(rows), "a person is listed twice")
        return [row for row in rows if row["status"] == "person"]

    return read(path, _PEOPLE, made)


def write_identities(path: Path, identities: dict[tuple[str, int], str]) -> None:
    """Write ``identities.tsv`` from {(camera, track): person}; an empty person means the track was rejected."""
    write_table(
        path,
        IDENTITY_COLUMNS,
        [(camera, track_text(track), person) for (camera, track), person in sorted(identities.items())],
    )


def track_text(track: int) -> str:
    """The name of a track in files; of its part from a frame on with that frame, ``7@120``."""
    first, base = divmod(track, _PART)
    return f"{base}@{first - 1}" if track >= _PART else str(track)


def track_number(given: str) -> int | None:
    """The number of a track, or of its part, that files call ``given``; None where that is neither."""
    found = _TRACK.fullmatch(given)
    if found is None:
        return None
    return int(found[1]) + (_PART * (int(found[2]) + 1) if found[2] else 0)


def whole_track(track: int) -> int:
    """The track to which a part belongs; other tracks unchanged."""
    return track % _PART if track >= _PART else track


def split_tracks(found: Detections, identities: Mapping[tuple[str, int], str]) -> Detections:
    """``found`` with the tracks cut into the parts that ``identities`` names; without parts, ``found`` itself."""
    parts = sorted(track for camera, track in identities if camera == found.camera and track >= _PART)
    track = np.array(found.track)
    for part in parts:  # by their first frames: of several parts the last one that has begun counts
        track[(found.track == whole_track(part)) & (found.frame >= part // _PART - 1)] = part
    return replace(found, track=track) if parts else found


def read_identities(path: Path) -> dict[tuple[str, int], str]:
    """{(camera, track): person} of ``identities.tsv``; an empty person means the track was rejected.

    Raises UserError as ``step_files.read`` does.
    """

    def made(rows: list[dict[str, Any]]) -> dict[tuple[str, int], str]:
        numbers = [track_number(row["track"]) for row in rows]
        expect(None not in numbers, "a track is no number")
        found = {(row["camera"], track): row["person"] for row, track in zip(rows, numbers) if track is not None}
        expect(len(found) == len(rows), "a track is listed twice")
        return found

    return read(path, _IDENTITIES, made)


def read_given_identities(path: Path) -> dict[tuple[str, int], str]:
    """The result of ``read_identities`` for a user's table.

    Raises UserError with the line for a track that is no number, and for a track with two persons.
    """
    found: dict[tuple[str, int], str] = {}
    for line, row in read_rows(path, IDENTITY_COLUMNS):
        camera, track, person = (row[column].strip() for column in IDENTITY_COLUMNS)
        number = track_number(track)
        if number is None:
            raise UserError(
                f"{path}, line {line}: track is {short_text(row['track'])}; it must be a whole number, or 7@120 for "
                "track 7 from frame 120 on"
            )
        if found.setdefault((camera, number), person) != person:
            raise UserError(f"{path}, line {line}: track {track} of camera {camera} is two people; keep one line")
    if not found:
        raise UserError(f"{path} names no track; start from people/identities.tsv, or take the file away")
    return found
