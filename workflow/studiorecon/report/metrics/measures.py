# SPDX-License-Identifier: Apache-2.0
"""Picture measures of one view against its photo, frame by frame, and their averages.

Per frame → mean over frames → mean over cameras, unweighted, each level stored; squared errors are never pooled over
frames. A value that was not measured is None with a reason, never 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.arrays import mean_of_measured
from studiorecon.images.flip import flip, is_available
from studiorecon.images.flow import dis_flow, grey_levels
from studiorecon.images.metrics import (
    PSNR_CAP_DB,
    change_maps,
    error_map,
    mean_inside,
    psnr_from_error_map,
    ssim,
    ssim_3dgs,
    ssim_map,
    to_levels,
)
from studiorecon.images.temporal import forward_backward_consistent
from studiorecon.models.protocols import PerceptualDistance
from studiorecon.report.metrics.bootstrap import Bootstrap, mean_interval
from studiorecon.report.metrics.distance import missing_flip_reason

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Num

FULL = ("psnr", "ssim", "ssim_3dgs")
TEMPORAL = ("temporal_l1", "warp_rms", "flicker_excess", "temporal_l1_seen", "temporal_l1_unseen")
REGIONS = ("people", "background", "seen", "unseen", "people_seen", "people_unseen")
SHARES = ("share_seen", "share_people_seen")
NOT_FINITE = "not_finite"
NAMES = (
    *FULL,
    "lpips",
    "flip",
    *(f"{measure}_{region}" for region in REGIONS for measure in ("psnr", "ssim")),
    *SHARES,
    *TEMPORAL,
)
# Smaller pictures have no pyramid for the flow search; they get no temporal measures.
_SMALLEST_FLOW_PX = 24
# ꟻLIP takes ten times as long as the others, so it is measured in one frame of this many, starting with the first.
FLIP_EVERY = 12


def measure_picture(
    prediction: Num[np.ndarray, "H W 3"],
    photo: Integer[np.ndarray, "H W 3"],
    regions: Mapping[str, Bool[np.ndarray, "H W"]],
    distance: PerceptualDistance | None = None,
    flipped: bool = False,
) -> dict[str, float | None]:
    """Every picture measure of one frame; ``regions`` are masks of the photo by name.

    LPIPS needs ``distance``. ꟻLIP, which takes ten times as long as the others, is measured only if ``flipped``.
    Non-finite values of a float prediction count as black (white for +inf), and ``not_finite`` is their number.
    """
    similarity, errors = ssim_map(prediction, photo), error_map(prediction, photo)
    values = {
        "psnr": psnr_from_error_map(errors),
        "ssim": ssim(similarity),
        "ssim_3dgs": ssim_3dgs(similarity),
        "lpips": None if distance is None else distance.measure(to_levels(prediction), to_levels(photo)),
        "flip": flip(prediction, photo) if flipped else None,
        NOT_FINITE: 0.0 if prediction.dtype == np.uint8 else float((~np.isfinite(prediction)).sum()),
    }
    for name, mask in regions.items():
        values[f"psnr_{name}"] = psnr_from_error_map(errors, mask)
        values[f"ssim_{name}"] = ssim(similarity, mask)
    for share in SHARES:
        seen = share.removeprefix("share_")
        unseen = seen.replace("seen", "unseen")
        if seen in regions and unseen in regions:
            yes, no = int(regions[seen].sum()), int(regions[unseen].sum())
            values[share] = yes / (yes + no) if yes + no else None
    return values


class Flicker:
    """Temporal measures of a sequence: each picture against the previous one, warped by the flow of the *photos*."""

    def __init__(self, flow_preset: str) -> None:
        self._preset = flow_preset
        self._grey: np.ndarray | None = None
        self._photo: np.ndarray | None = None
        self._pictures: dict[str, np.ndarray] = {}
        self._alike: dict[str, str] = {}

    def measure(
        self,
        photo: Integer[np.ndarray, "H W 3"],
        pictures: Mapping[str, Num[np.ndarray, "H W 3"]],
        regions: Mapping[str, Bool[np.ndarray, "H W"]],
    ) -> dict[str, dict[str, float | None]]:
        """The ``TEMPORAL`` measures of the named pictures and of the ``"photo"``; None for the first frame.

        Pixels count where forward and backward flow agree; ``regions`` belong to the current photo.
        """
        grey = grey_levels(photo)
        values: dict[str, dict[str, float | None]] = {name: dict.fromkeys(TEMPORAL) for name in (*pictures, "photo")}
        first_same, measured = first_identical(pictures), dict[tuple[str, str], dict[str, float | None]]()
        if self._grey is not None and min(grey.shape) >= _SMALLEST_FLOW_PX:
            backward = dis_flow(grey, self._grey, self._preset)
            valid = forward_backward_consistent(backward, dis_flow(self._grey, grey, self._preset))
            assert self._photo is not None
            values["photo"] = self._changed(photo, self._photo, backward, valid, regions)
            for name, picture in pictures.items():
                pair = first_same[name], self._alike[name]
                if pair not in measured:
                    found = self._changed(picture, self._pictures[name], backward, valid, regions)
                    if found["temporal_l1"] is not None:
                        of_photo = values["photo"]["temporal_l1"]
                        assert of_photo is not None
                        found["flicker_excess"] = found["temporal_l1"] - of_photo
                    measured[pair] = found
                values[name] = dict(measured[pair])
        self._grey, self._photo, self._alike = grey, photo, first_same
        self._pictures = {name: to_levels(picture) for name, picture in pictures.items()}
        return values

    def _changed(
        self,
        picture: np.ndarray,
        previous: np.ndarray,
        backward: np.ndarray,
        valid: np.ndarray,
        regions: Mapping[str, np.ndarray],
    ) -> dict[str, float | None]:
        absolute, square = change_maps(picture, previous, backward, valid)
        mean_square = mean_inside(square, valid)
        found = {name: mean_inside(absolute, valid & regions[name]) for name in ("seen", "unseen") if name in regions}
        return {
            "temporal_l1": mean_inside(absolute, valid),
            "warp_rms": None if mean_square is None else float(np.sqrt(mean_square)),
            "flicker_excess": None,
            "temporal_l1_seen": found.get("seen"),
            "temporal_l1_unseen": found.get("unseen"),
        }


def first_identical(pictures: Mapping[str, Num[np.ndarray, "H W 3"]]) -> dict[str, str]:
    """name → the first name with an identical picture, so that pictures without enhancement are measured once."""
    first_same: dict[str, str] = {}
    for name, picture in pictures.items():
        same = (first for first in set(first_same.values()) if _same(pictures[first], picture))
        first_same[name] = next(same, name)
    return first_same


def _same(one: np.ndarray, two: np.ndarray) -> bool:
    return one.dtype == two.dtype and np.array_equal(one, two)


def measure_sequence(
    frames: Iterable[
        tuple[
            Integer[np.ndarray, "H W 3"], Mapping[str, Num[np.ndarray, "H W 3"]], Mapping[str, Bool[np.ndarray, "H W"]]
        ]
    ],
    flow_preset: str,
    distance: PerceptualDistance | None = None,
) -> dict[str, list[dict[str, float | None]]]:
    """version → measures per frame of one camera; ``frames`` are (photo, pictures of every version, regions).

    ``"photo"`` is the photos' own flicker. ꟻLIP is measured in one frame of ``FLIP_EVERY``. Call inside ``one_thread``:
    the flow's result depends on OpenCV's number of threads.
    """
    flicker = Flicker(flow_preset)
    found: dict[str, list[dict[str, float | None]]] = {}
    for t, (photo, versions, masks) in enumerate(frames):
        flipped = t % FLIP_EVERY == 0 and is_available()
        moving = flicker.measure(photo, versions, masks)
        still: dict[str, dict[str, float | None]] = {}
        for name, first in first_identical(versions).items():
            if first not in still:
                still[first] = measure_picture(versions[first], photo, masks, distance, flipped)
            found.setdefault(name, []).append({**still[first], **moving[name]})
        found.setdefault("photo", []).append(moving["photo"])
    return found


def summary(
    frames: Mapping[str, Iterable[float | None]], reason: str, bootstrap: Bootstrap | None = None
) -> dict[str, Any]:
    """One measure over cameras: value, 95 % interval, means per camera, raw values, and counts of frames.

    ``frames`` maps camera → values; ``reason`` applies when there is no measurement at all. Non-finite values are
    skipped.
    """
    cameras: dict[str, dict[str, Any]] = {}
    for camera, values in frames.items():
        listed = [None if value is None or not np.isfinite(value) else float(value) for value in values]
        used = [value for value in listed if value is not None]
        cameras[camera] = {
            "value": mean_of_measured(used),
            "used": len(used),
            "skipped": len(listed) - len(used),
            "frames": listed,
        }
    value = mean_of_measured(entry["value"] for entry in cameras.values())
    interval = mean_interval({c: entry["frames"] for c, entry in cameras.items()}, bootstrap) if bootstrap else None
    return {"value": value, "interval": interval, "reason": None if value is not None else reason, "cameras": cameras}


def summaries(
    per_camera: Mapping[str, Iterable[Mapping[str, float | None]]],
    names: Iterable[str],
    reasons: Mapping[str, str],
    bootstrap: Bootstrap | None = None,
) -> dict[str, Any]:
    """The summary of each named measure; ``reasons`` says why one may be missing."""
    result = {}
    for name in names:
        found = summary(
            {camera: [f.get(name) for f in frames] for camera, frames in per_camera.items()},
            reasons.get(name, ""),
            bootstrap,
        )
        if name.startswith("psnr"):
            for entry in found["cameras"].values():
                entry["capped"] = sum(value == PSNR_CAP_DB for value in entry["frames"])
        result[name] = found
    return result


def null_reasons(people: str, seen: str, people_seen: str, lpips: str) -> dict[str, str]:
    """measure → why it may be null, by the reasons of regions of people and room, of seen surfaces, and of LPIPS."""
    of_region = {
        name: people_seen if name.startswith("people_") else seen if "seen" in name else people for name in REGIONS
    }
    found = {f"{measure}_{name}": of_region[name] for name in REGIONS for measure in ("psnr", "ssim")}
    found |= {share: of_region[share.removeprefix("share_")] for share in SHARES}
    found |= dict.fromkeys(
        TEMPORAL, "needs at least two frames of 24 pixels a side and 256 pixels whose flow leads back"
    )
    found |= dict.fromkeys(("temporal_l1_seen", "temporal_l1_unseen"), seen)
    found |= dict.fromkeys(("ssim", "ssim_3dgs"), "pictures are under 11 pixels a side")
    return found | {"flip": missing_flip_reason(), "lpips": lpips}


def missing_measure(reason: str) -> dict[str, Any]:
    """The entry of a measure that could not be taken."""
    return {"value": None, "interval": None, "reason": reason, "cameras": {}}
