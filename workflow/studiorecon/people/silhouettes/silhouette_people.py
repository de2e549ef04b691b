# SPDX-License-Identifier: Apache-2.0
"""People without keypoints: found in the hull of what differs from the given plates, with the silhouettes and start of
their fit.

Only cameras whose plate the user brought take part: a plate estimated from the clip cannot show whoever never moves
away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.body.fitting.basis import State
from studiorecon.body.model import BodyModel
from studiorecon.body.silhouettes import grown_outlines
from studiorecon.configuration.setting import setting
from studiorecon.people.silhouettes import hull, upright
from studiorecon.people.silhouettes.contour import ContourSettings, Silhouette
from studiorecon.people.silhouettes.facing import Facing, across_of
from studiorecon.people.silhouettes.foreground import ForegroundSettings, SilhouetteView, labels, pictures
from studiorecon.people.silhouettes.hull import HullLimits, HullTrack
from studiorecon.people.silhouettes.mask_video import FilmTargets, LabelFilm
from studiorecon.people.silhouettes.person_masks import silhouettes
from studiorecon.people.silhouettes.tracking import follow
from studiorecon.progress import progress, say
from studiorecon.scene.camera import Camera
from studiorecon.scene.files import write_npz
from studiorecon.scene.intermediate import as_written, read_arrays
from studiorecon.scene.people import Detections, Person

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

# Parts of the hull whose middle is this near to a person's are the person's: a leg apart; metres.
_APART_M = 0.5


@dataclass(frozen=True)
class HullSettings:
    """How people without keypoints are found and fitted.

    Attributes:
        foreground, limits, contour: see ``ForegroundSettings``, ``HullLimits``, ``ContourSettings``.
        min_agreement: intersection over union of body and silhouettes below which nobody is believed, and no frame is.
        sigma_m: deviation of the joints of a body that agrees perfectly.
    """

    use: Literal["auto", "never"] = setting(
        "auto", "Look for people without keypoints; auto = in cameras whose clean plate the user brought."
    )
    foreground: ForegroundSettings = ForegroundSettings()
    limits: HullLimits = HullLimits()
    contour: ContourSettings = ContourSettings()
    min_agreement: float = 0.6
    sigma_m: float = 0.03


@dataclass(frozen=True)
class SilhouettePerson:
    """One person without keypoints.

    Attributes:
        name: ``p1``, …; cameras: names of the cameras whose silhouettes these are; seen_by: those that show the person.
        labels: the silhouettes of the frames that have some; places_m: (F, 2) where the hull stood in them.
        start: where the fit starts, and how sure its facing is.
    """

    name: str
    cameras: tuple[str, ...]
    seen_by: tuple[str, ...]
    places_m: Float[np.ndarray, "F 2"]
    labels: LabelFilm
    start: upright.UprightFit

    @property
    def frames(self) -> Integer[np.ndarray, " F"]:
        """(F,) frames that have silhouettes."""
        return np.array(list(self.labels), dtype=np.int64)


def find_standing(
    views: Sequence[SilhouetteView],
    known: Sequence[Person],
    body: BodyModel,
    frames: int,
    fps: float,
    settings: HullSettings,
    detections: Sequence[Detections] = (),
    sizes: Sequence[tuple[int, int]] = (),
) -> list[SilhouettePerson]:
    """People who stand out from the plates of ``views`` and are not ``known``; named in order of appearance after
    those. ``detections`` in pictures of ``sizes`` may say which way they face."""
    cameras = [v.camera for v in views]
    surface = Silhouette(body, cameras, settings.contour)
    lasting = _lasting(views, known, body, fps, settings)
    found: list[SilhouettePerson] = []
    first = max((int(p.name[1:]) for p in known), default=-1) + 1
    for track, (shown, extent_m) in zip(lasting, _silhouettes(lasting, views, known, body, settings)):
        places_m = np.array([_place(track, t) for t in shown])
        walk = replace(_walk(shown, places_m, fps), sides=across_of(shown, cameras, detections, sizes))
        start = upright.shaped(surface, walk, upright.find(surface, walk, *extent_m))
        where = f"somebody without keypoints at ({track.places_m[0, 0]:.1f}, {track.places_m[0, 1]:.1f}) m"
        if start.agreement < settings.min_agreement:
            say(
                f"{where} stays undetermined: no upright body agrees with the silhouettes "
                f"by more than {start.agreement:.2f}, "
                f"{settings.min_agreement:g} is needed"
            )
            continue
        seen_by = tuple(c.name for c, seen in zip(cameras, track.seen_by) if seen)
        name = f"p{first + len(found)}"
        say(
            f"{name}: {where}, seen in {len(shown)} of {frames} frames by {', '.join(seen_by)} "
            "against the given plates; an upright body "
            f"agrees with the silhouettes by {start.agreement:.2f}; {start.facing.sentence()}"
        )
        found.append(SilhouettePerson(name, tuple(c.name for c in cameras), seen_by, places_m, shown, start))
    return found


def _lasting(
    views: Sequence[SilhouetteView], known: Sequence[Person], body: BodyModel, fps: float, settings: HullSettings
) -> list[HullTrack]:
    """Tracks of human size, away from the people already known."""
    cameras, limits = [v.camera for v in views], settings.limits
    cells_m, shape = hull.watched_cells(cameras, limits.voxel_m, limits.cameras)
    seen = []
    for t, rgbs in pictures(views, max(1, round(limits.step_s * fps))):
        pictured = _labels(rgbs, t, views, known, body, settings.foreground)
        found = hull.parts(cells_m, shape, cameras, pictured, limits.voxel_m)
        seen.append((t, [p for p in found if hull.is_person(p, limits.voxel_m, limits)]))
    kept = []
    for track in hull.tracks(seen, fps, limits):
        near = [np.median(apart_m(p, track)) for p in known]
        if min(near, default=np.inf) >= limits.apart_m:
            kept.append(track)
    return kept


def apart_m(person: Person, track: HullTrack) -> Float[np.ndarray, " F"]:
    """(F,) distance of a person from every place of a track, infinite while the person is away."""
    apart_m = np.linalg.norm(person.trans[track.frames, :2] - track.places_m, axis=1)
    return np.where(person.present[track.frames], apart_m, np.inf)


def _silhouettes(
    tracks: Sequence[HullTrack],
    views: Sequence[SilhouetteView],
    known: Sequence[Person],
    body: BodyModel,
    settings: HullSettings,
) -> list[tuple[LabelFilm, tuple[float, float]]]:
    """For every track: labels of the frames in which the person is there, per camera; height of the floor and of the
    person, metres."""
    if not tracks:
        return []
    cameras, voxel_m = [v.camera for v in views], settings.limits.voxel_m / 2
    films = [LabelFilm(np.array([c.wh for c in cameras])) for _ in tracks]
    ends: list[list[tuple[float, float]]] = [[] for _ in tracks]
    for t, rgbs in progress(pictures(views, 1), "silhouettes"):
        pictured = _labels(rgbs, t, views, known, body, settings.foreground)
        places = [_place(track, t) for track in tracks]
        parts = [
            hull.whole_person(*hull.cells_around(place, voxel_m), cameras, pictured, voxel_m, place, _APART_M)
            for place in places
        ]
        there = {k: part for k, part in enumerate(parts) if part is not None and part.seen_by.sum() >= 2}
        drawn = [
            silhouettes(list(there.values()), [places[k] for k in there], v, camera, label, voxel_m)
            for v, (camera, label) in enumerate(zip(cameras, pictured))
        ]
        for i, (k, part) in enumerate(there.items()):
            ends[k].append((part.cells_m[:, 2].min(), part.cells_m[:, 2].max()))
            films[k].add(t, [of_camera[i] for of_camera in drawn])
    extents = [np.median(e, axis=0) for e in ends]
    return [(film, (float(low), float(high - low))) for film, (low, high) in zip(films, extents)]


def _labels(
    rgbs: Sequence[np.ndarray],
    frame: int,
    views: Sequence[SilhouetteView],
    known: Sequence[Person],
    body: BodyModel,
    settings: ForegroundSettings,
) -> list[np.ndarray]:
    return [
        labels(rgb, v, grown_outlines(known, body, v.camera, frame, settings.margin_m), settings)
        for rgb, v in zip(rgbs, views)
    ]


def _place(track: HullTrack, frame: int) -> np.ndarray:
    return np.array([np.interp(frame, track.frames, track.places_m[:, axis]) for axis in (0, 1)])


def _walk(shown: LabelFilm, places_m: np.ndarray, fps: float) -> upright.UprightWalk:
    return upright.UprightWalk(FilmTargets(shown), dict(zip(shown, places_m)), fps)


def follow_standing(
    person: SilhouettePerson, cameras: Sequence[Camera], body: BodyModel, fps: float, settings: HullSettings
) -> dict[int, tuple[State, float]]:
    """State and agreement of every frame with silhouettes; ``cameras`` are the model's, any size."""
    by_name = {c.name: c for c in cameras}
    sized = [by_name[name].resized((int(wh[0]), int(wh[1]))) for name, wh in zip(person.cameras, person.labels.wh)]
    walk = _walk(person.labels, person.places_m, fps)
    return follow(Silhouette(body, sized, settings.contour), walk, person.start.frame, person.start.state)


def write_standing(path: Path, people: Sequence[SilhouettePerson]) -> None:
    """Write everybody's silhouettes and starts; nobody is an empty list of names."""
    arrays: dict[str, np.ndarray] = {"names": np.array([p.name for p in people], dtype=str)}
    for p in people:
        fields = {
            "cameras": np.array(p.cameras),
            "seen_by": np.array(p.seen_by),
            "places": p.places_m,
            **p.labels.to_arrays(),
            "frame": p.start.frame,
            "local": p.start.state.local,
            "trans": p.start.state.trans,
            "betas": p.start.state.betas,
            "agreement": p.start.agreement,
            "facing": np.array(astuple(p.start.facing)),
        }
        arrays |= {f"{p.name}_{key}": np.asarray(value) for key, value in fields.items()}
    write_npz(path, arrays)


def read_standing(path: Path) -> list[SilhouettePerson]:
    """Everybody in a file of ``write_standing``."""
    data = read_arrays(path)
    with as_written(path):
        return [
            _standing(str(name), {k.removeprefix(f"{name}_"): data[k] for k in data if k.startswith(f"{name}_")})
            for name in data["names"]
        ]


def _standing(name: str, fields: dict[str, np.ndarray]) -> SilhouettePerson:
    state = State(fields["local"], fields["trans"], fields["betas"], 0.0, np.zeros((0, 3)))
    facing = Facing(*(float(v) for v in fields["facing"]))
    start = upright.UprightFit(int(fields["frame"]), state, float(fields["agreement"]), facing)
    cameras, seen_by = (tuple(str(c) for c in fields[key]) for key in ("cameras", "seen_by"))
    return SilhouettePerson(name, cameras, seen_by, fields["places"], LabelFilm.from_arrays(fields), start)
