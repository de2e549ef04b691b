# SPDX-License-Identifier: Apache-2.0
"""One camera's clean plate: the room without people, with an alpha that marks the measured pixels.

Every pixel has the colour that most pictures agree on, counting only those in which no detected person covers it. A
pixel that people always cover stays unknown: a guess would be a ghost. The user's plate fills those pixels, after its
exposure is matched to the footage. Where the two differ, one of them shows a person. A part that moves during the clip,
if only an arm of it, is an undetected person, and the user's plate wins. A part that never moves is the room, and the
person is in the user's plate.

Reads the section ``plate``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.arrays import spread_indices
from studiorecon.body.person_boxes import people_regions
from studiorecon.camera_files.calibration import find_lens
from studiorecon.configuration.setting import setting
from studiorecon.errors import UserError
from studiorecon.footage.stills import read_plate
from studiorecon.footage.video import read_frames
from studiorecon.geometry.lens import WorkingView, video_from_working
from studiorecon.images.channels import channel_max, channel_sum
from studiorecon.images.photometric_normalisation import STEADY, light_factors, normalise_light
from studiorecon.images.plate import noise_levels, temporal_modes, write_plate
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, read_footage
from studiorecon.scene.people import read_detections
from studiorecon.signature import Written

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer

# Grey levels by which a given plate must differ from the footage to show something else, and how far (share of the
# longer side) this may reach into pixels that the footage cannot confirm.
_OTHER_LEVELS = 30.0
_DOUBT_SHARE = 0.025
# A given plate is revealed at a pixel when this share of its pictures agree with it to these levels. Of the pixels
# behind a person who stands for 1.7 s, 0.2 to 0.27 are revealed; none of those where a person is in the plate.
_SAME_LEVELS, _REVEALED, _MOVING = 20.0, 0.1, 0.1
# A person who stays in place always hides the same wall, but sways and waves: this share of the part leaves its usual
# colour in a tenth of the pictures (a waving person: 0.15 to 0.27; an object: none). The picture with the person has
# the edges of their outline, this many times as strong as the other picture's (measured: 2.1 to 5.2).
_UNSTEADY, _EDGE_RATIO = 0.1, 1.5
# Parts of one person that are separated by pixels with the room's colour are joined over this share of the longer side.
_JOIN_SHARE = 0.01
# Steps of the tone curve from a given plate to the footage; the fewest pixels of a step, and their largest
# interquartile range in levels.
_TONE_STEPS, _TONE_PIXELS, _TONE_SPREAD = 24, 50, 24.0


@dataclass(frozen=True)
class Settings:
    """When a pixel counts as measured.

    Attributes:
        agree_levels: colours that differ by at most this in every channel, grey levels of 255, are the same surface;
            never less than four times the noise, and never more than four times this.
        min_share: a pixel counts as measured when the room shows in at least this share of the pictures.
        min_agreement: at least this share of the pictures without a person at the pixel must agree.
        margin: detected people are drawn wider by this share of their height.
        hold_s: a detection counts this long before and after, seconds.
        max_difference: the user's plate must agree with the footage to this median difference, grey levels of 255;
            another room or another light differs by more.
    """

    frames: int = setting(60, "Pictures used per camera, evenly over the clip.", minimum=2, maximum=1000)
    agree_levels: float = 8.0
    min_share: float = 0.1
    min_agreement: float = 0.5
    margin: float = 0.03
    hold_s: float = 0.07
    max_difference: float = 25.0


def temporal_plate(
    frames: Integer[np.ndarray, "T H W 3"], occupied: Bool[np.ndarray, "T H W"], settings: Settings
) -> tuple[Float[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"]]:
    """Float32 colours 0..255, and where they are measured, from frames with people at ``occupied``."""
    free = ~occupied
    # Flickering light looks like noise; the limit keeps all colours from agreeing.
    tolerance = min(max(settings.agree_levels, 4 * noise_levels(frames)), 4 * settings.agree_levels)
    colour, votes, rival = temporal_modes(frames, free, tolerance)
    available = free.sum(axis=0)
    # A second colour nearly as frequent means that two surfaces alternate, and nothing shows which is the room.
    clear = (votes >= settings.min_agreement * available) & (votes >= 2 * rival)
    return colour, clear & (votes >= max(2, settings.min_share * len(frames)))


def fit_given_plate(
    given_rgb: Float[np.ndarray, "h w 3"],
    given_measured: Bool[np.ndarray, "h w"],
    lens: Lens,
    footage: Footage,
    colour: Float[np.ndarray, "H W 3"],
    measured: Bool[np.ndarray, "H W"],
) -> tuple[Float[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"], float]:
    """A given plate in [0, 1] in working pixels: colours 0..255, where it is known, and its median difference.

    A plate may have the video's pixels, or the calibration's when the video was resized or padded afterwards: the one
    that agrees better with the footage (``colour`` where ``measured``) is used. The difference is NaN without overlap.
    """
    given_wh = (given_rgb.shape[1], given_rgb.shape[0])
    maps = [np.eye(2, 3)] if given_wh == tuple(lens.wh) else []
    to_video = np.diag([footage.source_wh[0] / given_wh[0], footage.source_wh[1] / given_wh[1]])
    own = np.asarray(lens.calibration_from_video, np.float64)
    maps.append(np.concatenate([own[:, :2] @ to_video, own[:, 2:]], axis=1))
    best = None
    for calibration_from_given in maps:
        rgb, known = _working_picture(
            given_rgb, given_measured, replace(lens, calibration_from_video=calibration_from_given), footage
        )
        common = known & measured
        difference = float(np.median(np.abs(rgb[common] - colour[common]))) if common.any() else np.nan
        if best is None or difference < best[2]:
            best = rgb, known, difference
    assert best is not None
    return best


def _working_picture(
    rgb: np.ndarray, measured: np.ndarray, lens: Lens, footage: Footage
) -> tuple[np.ndarray, np.ndarray]:
    """A picture of any size, seen through ``lens``, in the footage's working pixels 0..255, and where it is known."""
    wh, intrinsics = footage.wh, np.array(footage.intrinsics)
    picture_wh = (rgb.shape[1], rgb.shape[0])
    n = max(1, round(picture_wh[0] / wh[0]))
    columns, rows = np.meshgrid((np.arange(n * wh[0]) + 0.5) / n, (np.arange(n * wh[1]) + 0.5) / n)
    source = video_from_working(np.stack([columns, rows], axis=-1), lens, picture_wh, intrinsics)
    view = WorkingView(
        wh, intrinsics, n, (source[..., 0] - 0.5).astype(np.float32), (source[..., 1] - 0.5).astype(np.float32)
    )
    inside = ((source >= 0) & (source <= picture_wh)).all(axis=-1).astype(np.float32)
    inside *= cv2.remap(
        measured.astype(np.float32), view.map_x, view.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    share = cv2.resize(inside, wh, interpolation=cv2.INTER_AREA) if n > 1 else inside
    return view.picture(rgb.astype(np.float32)) * 255, share > 0.99


def share_showing(
    frames: Integer[np.ndarray, "T H W 3"], free: Bool[np.ndarray, "T H W"], colour: Float[np.ndarray, "H W 3"]
) -> Float[np.ndarray, "H W"]:
    """Float32 share of the ``free`` pictures that show ``colour`` at a pixel; 0 if never free."""
    shown = np.zeros(colour.shape[:2], np.float32)
    for frame, unoccupied in zip(frames, free):
        shown += unoccupied & (channel_max(np.abs(frame - colour)) <= _SAME_LEVELS)
    return shown / np.maximum(free.sum(axis=0), 1).astype(np.float32)


def match_exposure(
    colour: Float[np.ndarray, "H W 3"], common: Bool[np.ndarray, "H W"], given: Float[np.ndarray, "H W 3"]
) -> Float[np.ndarray, "H W 3"]:
    """A given plate 0..255 in the footage's exposure, matched on the pixels ``common`` to both.

    First one tone curve per channel (exposure, white balance and gamma are the same everywhere), by medians, so that
    people in either picture do not bend it. Then a smooth ratio, interpolated from the surroundings, so that no seam
    shows.
    """
    if not common.any():
        return given
    toned = np.stack([_match_tone(given[..., c], colour[..., c], common) for c in range(3)], axis=-1)
    usable = common & (toned > 8).all(axis=-1) & (colour > 8).all(axis=-1)
    ratio = np.where(usable[..., None], np.log(np.maximum(colour, 1) / np.maximum(toned, 1)), 0).astype(np.float32)
    # Objects that differ between plate and footage (people, moved props) are not exposure.
    is_close = usable & (channel_max(np.abs(ratio)) < 0.2)
    sigma = max(colour.shape[:2]) / 16
    weight = cv2.GaussianBlur(is_close.astype(np.float32), (0, 0), sigma)
    local = cv2.GaussianBlur(np.where(is_close[..., None], ratio, 0).astype(np.float32), (0, 0), sigma)
    return toned * np.exp(local / (weight + 0.05)[..., None])


def _match_tone(given: np.ndarray, colour: np.ndarray, common: np.ndarray) -> np.ndarray:
    """(H, W) one channel through the rising curve of the medians of ``colour`` at equal steps of ``given``."""
    source, target = given[common], colour[common]
    step = np.minimum((source / 256 * _TONE_STEPS).astype(int), _TONE_STEPS - 1)
    rows = []
    for k in range(_TONE_STEPS):
        chosen = step == k
        if chosen.sum() < _TONE_PIXELS:
            continue
        low, middle, high = np.percentile(target[chosen], (25, 50, 75))
        # One brightness that maps to many is not a tone curve but another object.
        if high - low < _TONE_SPREAD:
            rows.append((np.median(source[chosen]), middle))
    if not rows:
        return given * np.float32(np.median(target) / max(np.median(source), 1))
    x, y = np.array(rows).T
    y = np.maximum.accumulate(y)
    # Beyond the measured steps the outermost ratio continues.
    curve = np.interp(given, x, y)
    curve = np.where(given < x[0], given * y[0] / max(x[0], 1), curve)
    return np.where(given > x[-1], given * y[-1] / max(x[-1], 1), curve).astype(np.float32)


def merge_plates(
    colour: Float[np.ndarray, "H W 3"],
    measured: Bool[np.ndarray, "H W"],
    matched: Float[np.ndarray, "H W 3"],
    known: Bool[np.ndarray, "H W"],
    seen: Bool[np.ndarray, "H W"],
    shown: Float[np.ndarray, "H W"],
    usual: Float[np.ndarray, "H W"],
) -> tuple[Float[np.ndarray, "H W 3"], Bool[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """Colours merged from the footage's plate and a given one (``matched`` in exposure), which are known, and moving
    parts.

    The footage counts where measured, otherwise the given plate. ``seen``: not always occupied; ``shown``: how often
    the footage shows the given plate, ``usual`` its own ``colour``. Where the two clearly differ there are two cases.
    If the given plate is revealed along the edges of such a part, or the part is unsteady and outlined in the footage
    and not in the plate, it is an undetected person in the footage: the given plate counts there. Otherwise the given
    plate shows a person or object, or the room has a new one. Its extent in unmeasured pixels is not known, so a border
    stays unknown.
    """
    differs = (seen & known & (channel_max(np.abs(matched - colour)) > _OTHER_LEVELS)).astype(np.uint8)
    differs = cv2.morphologyEx(differs, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    longer = max(colour.shape[:2])
    joined = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, _disc(longer * _JOIN_SHARE))
    count, labels = cv2.connectedComponents(joined, connectivity=8)
    total = np.bincount(labels[differs > 0], minlength=count)
    revealed = np.bincount(labels[(differs > 0) & (shown > _REVEALED)], minlength=count)
    unsteady = np.bincount(labels[(differs > 0) & (usual < 1 - _REVEALED)], minlength=count)
    drawn = _edges(colour, labels, count) > _EDGE_RATIO * _edges(matched, labels, count)
    moving = ((revealed > _MOVING * total) | ((unsteady > _UNSTEADY * total) & drawn))[labels] & (labels > 0)
    person = (cv2.dilate(moving.astype(np.uint8), _disc(longer * _JOIN_SHARE)) > 0) & known
    doubtful = cv2.dilate(differs * ~moving, _disc(longer * _DOUBT_SHARE)) > 0
    footage = measured & ~person
    return np.where(footage[..., None], colour, matched), footage | person | (known & ~doubtful), person


def _edges(picture: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """Mean strength of the edges of ``picture`` along the border of every part of ``labels``."""
    smooth = picture.astype(np.float32)
    strength = channel_sum(np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)))
    parts = labels.astype(np.float32)
    border = (cv2.dilate(parts, np.ones((3, 3))) != cv2.erode(parts, np.ones((3, 3)))) & (labels > 0)
    at = labels[border]
    return np.bincount(at, strength[border], minlength=count) / np.maximum(np.bincount(at, minlength=count), 1)


def _disc(radius_px: float) -> np.ndarray:
    size = 2 * max(1, round(radius_px)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))


def run(
    settings: Settings,
    video: Path,
    footage: Path,
    calibration: Path,
    detections: list[Path],
    given: list[Path],
    plate: Written,
) -> None:
    """Write the clean plate of ``video`` as an RGBA PNG, from the people's ``detections`` and the user's plate, if
    any."""
    options = settings
    about = read_footage(footage)
    chosen = spread_indices(about.frames, options.frames)
    wanted = set(chosen.tolist())
    frames = np.stack([frame for number, frame in enumerate(read_frames(video)) if number in wanted])
    occupied = np.zeros(frames.shape[:3], bool)
    for path in detections:
        hold = round(options.hold_s * about.fps)
        occupied |= people_regions(read_detections(path), chosen, frames.shape[1:3], options.margin, hold)
    factors = light_factors(frames, ~occupied)
    frames = normalise_light(frames, factors)
    if np.ptp(factors.mean(axis=1)) > 2 * STEADY:
        low, high = factors.mean(axis=1).min(), factors.mean(axis=1).max()
        say(f"{about.camera}: the light changes between {low:.0%} and {high:.0%}; the plate is normalised for it")
    colour, measured = temporal_plate(frames, occupied, options)
    say(f"{about.camera}: {measured.mean():.1%} of the plate is visible in {len(frames)} pictures of the footage")
    for picture in given:
        colour, measured = _add_given(picture, calibration, about, frames, occupied, colour, measured, options)
    if measured.mean() < 0.8:
        unknown = 1 - measured.mean()
        warn(
            f"{about.camera}: {unknown:.1%} is always hidden and stays unknown; add a picture of the empty room in "
            "plates/"
        )
    write_plate(plate, np.clip(np.rint(colour), 0, 255).astype(np.uint8), measured)


def _add_given(
    given: Path,
    calibration: Path,
    about: Footage,
    frames: np.ndarray,
    occupied: np.ndarray,
    colour: np.ndarray,
    measured: np.ndarray,
    options: Settings,
) -> tuple[np.ndarray, np.ndarray]:
    lens = find_lens(calibration, about.camera)
    given_rgb, given_measured = read_plate(given)
    rgb, known, difference = fit_given_plate(given_rgb, given_measured, lens, about, colour, measured)
    if difference > options.max_difference:
        raise UserError(
            f"plate {given} differs from the footage of camera {about.camera} by {difference:.0f} grey levels in "
            "the median; it must show the same room from the same camera position and exposure: replace it, or "
            "remove it"
        )
    filled = float((known & ~measured).mean())
    agrees = (
        f"agrees with the footage to {difference:.1f} grey levels"
        if np.isfinite(difference)
        else "cannot be compared with the footage"
    )
    say(f"{about.camera}: {given.name} {agrees} and fills {filled:.1%} of the picture")
    matched = match_exposure(colour, measured & known, rgb)
    free = ~occupied
    shown = share_showing(frames, free, matched), share_showing(frames, free, colour)
    colour, both, person = merge_plates(colour, measured, matched, known, np.any(free, axis=0), *shown)
    if moving := float((person & measured).mean()):
        warn(
            f"{about.camera}: {moving:.1%} of the picture moves in front of {given.name}: a person without detection; "
            "the plate is used"
        )
    return colour, both
