# SPDX-License-Identifier: Apache-2.0
"""Hard cases of bodies, skinning, Gaussians, pictures, optimisers and enhancement (families M, L, G, I, O, E)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import scipy.optimize
from studiorecon.body.avatar.encoding import encode_position, in_body_box
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.fitting.start import start
from studiorecon.body.model import BodyModel, upright_global_orientation
from studiorecon.geometry import rotations
from studiorecon.images import metrics
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.recursive.injection import Injection, inject
from studiorecon.scene.camera import Camera
from studiorecon.splatting.conventions import ELLIPSE_A, ELLIPSE_C, LOG2_E
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.hard.stability_case import Case
from tests.made.splatting_limits import one

BODY = Path(__file__).resolve().parents[2] / "resources" / "body.npz"


@cache
def _body() -> tuple[BodyModel, list[str], np.ndarray]:
    """The bundled body, and the keypoints (K, 3) of it at rest, upright."""
    body, names = BodyModel.load(BODY), list(LAYOUTS["body_25"].keypoints)
    poses = np.zeros((1, 72))
    poses[0, :3] = upright_global_orientation(0.0)
    return body, names, body.keypoints(names, poses, np.zeros(10), np.zeros((1, 3)))[0]


def _faces_away(turned_deg: float, ours: bool) -> float:
    """Degrees by which the pelvis is off of somebody who has turned about the vertical, from where a fit starts."""
    body, names, points = _body()
    turn = rotations.exp(np.array([0.0, 0.0, np.radians(turned_deg)]))
    seen = points @ turn.T
    upright = rotations.exp(upright_global_orientation(0.0))
    if ours:
        at_rest, turned = (start(body, names, p[None], np.ones((1, len(p)), bool)).local[0, 0] for p in (points, seen))
        return float(np.degrees(rotations.angle(turned @ at_rest.T, turn)))

    def misfit(vector: np.ndarray) -> float:
        return float(((points @ rotations.exp(vector).T - seen) ** 2).sum())

    # From the body as it stands, downhill.
    found = scipy.optimize.minimize(misfit, np.zeros(3), method="L-BFGS-B")
    return float(np.degrees(rotations.angle(rotations.exp(found.x) @ upright, turn @ upright)))


def _shrunk(twist_deg: float, ours: bool) -> float:
    """What a Gaussian's axis of 10 mm loses between a bone that rests and one that is twisted; mm."""
    transforms = np.tile(np.eye(4), (24, 1, 1))
    transforms[1, :3, :3] = rotations.exp(np.array([np.radians(twist_deg), 0.0, 0.0]))
    blend = 0.5 * (transforms[0] + transforms[1])[:3, :3]
    if ours:
        posing = Posing(np.array([[0, 1]]), np.array([[0.5, 0.5]]))
        still = np.array([[1, 0, 0, 0]], np.float32)
        posing.out(np.zeros((1, 3), np.float32), still, np.zeros((1, 1, 3), np.float32), transforms)
        blend = posing.turn[0]
    return float(np.abs(10 - np.linalg.norm(blend @ np.diag([10.0, 10.0, 10.0]), axis=0)).max())


_FOCAL_PX, _DEPTH_M, _THIN_PX, _LOW_PASS = 500.0, 2.0, 0.05, 0.3
_STRAIGHT = Camera("straight", (65, 65), np.array([[_FOCAL_PX, 0, 32.5], [0, _FOCAL_PX, 32.5], [0, 0, 1.0]]), np.eye(4))


def _determinant(long_px: float, ours: bool) -> float:
    """Relative error of the determinant of a needle's covariance in the picture, float32 both."""
    exact = (long_px**2 + _LOW_PASS) * (_THIN_PX**2 + _LOW_PASS)
    if ours:
        sizes = np.log(np.array([long_px, _THIN_PX, _THIN_PX]) * _DEPTH_M / _FOCAL_PX)
        needle = one(means_m=[0, 0, _DEPTH_M], log_scales=sizes, quaternions=[np.cos(0.2), 0, 0, np.sin(0.2)])
        rasteriser = Rasteriser(near_m=0.01, threads=1)
        rasteriser.forward(needle, _STRAIGHT)
        record = rasteriser._splats[:16].astype(np.float64)
        half = 0.5 * float(LOG2_E)
        return abs(half * half / (record[ELLIPSE_A] * record[ELLIPSE_C]) / exact - 1)
    across, along = np.float32(np.cos(0.4)), np.float32(np.sin(0.4))
    long, thin = np.float32(long_px) ** 2, np.float32(_THIN_PX) ** 2
    a = across * across * long + along * along * thin + np.float32(_LOW_PASS)
    c = along * along * long + across * across * thin + np.float32(_LOW_PASS)
    b = across * along * (long - thin)
    return abs(float(a * c - b * b) / exact - 1)


def _flat(contrast: float, ours: bool) -> float:
    """Error of the similarity of two bright pictures whose noise has this many levels of contrast."""
    rng = np.random.default_rng(0)
    first, second = (
        np.clip(np.rint(230 + contrast * rng.normal(size=(48, 48, 3))), 0, 255).astype(np.uint8) for _ in range(2)
    )
    exact = _similarity(first, second, np.float64)
    found = metrics.ssim_map(first, second) if ours else _similarity(first, second, np.float32)
    inner = np.s_[8:-8, 8:-8]
    return float(np.abs(found[inner] - exact[inner]).max())


def _similarity(first: np.ndarray, second: np.ndarray, kind: type) -> np.ndarray:
    """SSIM by mean of squares less square of the mean."""

    def blurred(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values.astype(kind), (11, 11), 1.5, borderType=cv2.BORDER_CONSTANT)

    x, y = (picture.astype(kind) / kind(255) for picture in (first, second))
    mean_x, mean_y = blurred(x), blurred(y)
    var_x, var_y = blurred(x * x) - mean_x * mean_x, blurred(y * y) - mean_y * mean_y
    both = blurred(x * y) - mean_x * mean_y
    c1, c2 = kind(0.01) ** 2, kind(0.03) ** 2
    upper = (2 * mean_x * mean_y + c1) * (2 * both + c2)
    return np.asarray((upper / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))).mean(-1), np.float64)


def _encoded(away_m: float, ours: bool) -> float:
    """Root mean square error of the highest band of the code of points on somebody who stands this far away."""
    truth = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    metres = away_m + truth
    if ours:
        code = encode_position(in_body_box(metres, np.full(3, away_m - 1), np.full(3, away_m + 1)))[:, -6:-3]
        return float(np.sqrt(((code - np.sin(2.0**9 * truth)) ** 2).mean()))
    found = np.sin(np.float32(2.0**9) * metres.astype(np.float32))
    return float(np.sqrt(((found - np.sin(2.0**9 * metres)) ** 2).mean()))


def _darkened(trust: float, form: str) -> float:
    grey = np.full((16, 16, 3), 0.6, np.float32)
    settings = replace(Injection(), form=form, settle=False, strength=0.9)  # type: ignore[arg-type]
    mixed, _ = inject(grey, [grey], [np.full((16, 16), 1 - trust, np.float32)], settings)
    return float(255 * abs(mixed - grey).max())


CASES = (
    Case(
        "heading",
        "M05",
        "Where the fit of a body starts, by how far somebody has turned away",
        "downhill from the body as it stands: half a turn away the slope is zero, and it stays",
        "the pelvis in closed form from the torso's points, then downhill",
        "turned, degrees",
        [0.0, 45.0, 90.0, 135.0, 170.0, 179.0, 180.0],
        "error, degrees",
        lambda x: _faces_away(x, False),
        lambda x: _faces_away(x, True),
        1e-3,
        log_x=False,
    ),
    Case(
        "twist",
        "L04, L05",
        "A Gaussian carried by two bones, one of them twisted",
        "the blended matrix is taken for a rotation: the Gaussian shrinks, at half a turn to nothing",
        "the rotation nearest to the blend, which keeps its size",
        "twist, degrees",
        [0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 179.0],
        "lost of 10 mm, mm",
        lambda x: _shrunk(x, False),
        lambda x: _shrunk(x, True),
        1e-5,
        log_x=False,
    ),
    Case(
        "needle",
        "G03, G04, G10",
        "Determinant of a long needle",
        "a c less b² in float32 is the difference of two numbers that agree in all their digits",
        "the product of the two pivots, none of which is a difference of large numbers",
        "length, px (0.05 px thin)",
        [10.0**k for k in (0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5)],
        "relative error",
        lambda x: _determinant(x, False),
        lambda x: _determinant(x, True),
        1e-4,
    ),
    Case(
        "flat",
        "I01, I04",
        "Similarity of two bright pictures that are almost flat",
        "in float32 the mean of squares less the square of the mean is rounding, and may be negative",
        "variances about a level of the picture's own, in whole numbers",
        "contrast, levels of 255",
        [30.0, 10.0, 3.0, 1.0, 0.3, 0.1],
        "error of the similarity",
        lambda x: _flat(x, False),
        lambda x: _flat(x, True),
        1e-9,
    ),
    Case(
        "encoding",
        "O01",
        "The code of a place, by how far from the origin somebody stands",
        "sines of 512 times the metres, in float32, lose their digits to the distance",
        "places in a box about the body, in float64 until after the sine",
        "away, m",
        [0.1, 1.0, 10.0, 100.0, 1000.0, 10000.0],
        "error of the highest sine",
        lambda x: _encoded(x, False),
        lambda x: _encoded(x, True),
        1e-4,
    ),
    Case(
        "injection",
        "E01, E02",
        "A constant picture with earlier outputs injected",
        "the printed formula takes the share of history away whatever its confidence, and darkens",
        "what confidence does not take stays with the picture",
        "confidence that is missing",
        [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0],
        "levels of 255",
        lambda x: _darkened(x, "literal"),
        lambda x: _darkened(x, "residual"),
        1e-3,
        log_x=False,
    ),
)
