# SPDX-License-Identifier: Apache-2.0
"""What breaks in the textbook formula, and what ours does: ``python -m tests.hard.stability`` writes
``docs/stability.md`` and its plots.

One case per family of ``docs/hard-cases.md``: an input that gets harder along x, the error of either formula along y,
measured against an answer that is known exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from studiorecon.geometry import rotations
from studiorecon.geometry.depth_alignment import align_depth
from studiorecon.geometry.distortion import distort, undistort
from studiorecon.geometry.triangulation import Limits, triangulate
from studiorecon.recursive.injection import Injection, inject

from tests.made.scene import ring

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Below this an error counts as none, on the plots.
FLOOR = 1e-16


@dataclass(frozen=True)
class Case:
    """One family's plot.

    Attributes:
        name: of its picture.
        ids: rows of docs/hard-cases.md that it stands for.
        title, breaks, ours: what is computed, what the textbook does, what we do.
        along: what x is, with its unit; ``xs``: its values, hardest last.
        error: what y is, with its unit; ``textbook`` and ``kept``: the errors of both formulas at x.
        bar: the largest error of ours that is right.
        log_x: whether x is drawn in powers of ten.
    """

    name: str
    ids: str
    title: str
    breaks: str
    ours: str
    along: str
    xs: Sequence[float]
    error: str
    textbook: Callable[[float], float]
    kept: Callable[[float], float]
    bar: float
    log_x: bool = True


def _turn(angle_rad: float) -> np.ndarray:
    axis = np.array([0.3, -0.5, 0.81])
    return rotations.exp(axis / np.linalg.norm(axis) * angle_rad)


def _arccos_angle(turn: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))


def _textbook_log(turn: np.ndarray) -> np.ndarray:
    angle = _arccos_angle(turn)
    part = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    with np.errstate(all="ignore"):
        return angle / (2 * np.sin(angle)) * part


def _lost(turn: np.ndarray, vector: np.ndarray) -> float:
    """Degrees between a rotation and the one that its vector stands for; half a turn for a vector that is none."""
    if not np.isfinite(vector).all():
        return 180.0
    return float(np.degrees(rotations.angle(turn, rotations.exp(vector))))


_CAMERAS = ring([0, 80, 170, 260], "cam")
_POINT_M = np.array([0.2, -0.1, 1.2])


def _triangulated(solver: str, off_px: float) -> float:
    pixels = np.stack([camera.project(_POINT_M[None])[0][0] for camera in _CAMERAS])
    pixels[1, 0] += off_px
    found = triangulate(pixels[:, None], np.ones((len(_CAMERAS), 1)), _CAMERAS, Limits(), solver=solver)  # type: ignore[arg-type]
    return float(1000 * np.linalg.norm(found.points_m[0] - _POINT_M)) if found.valid[0] else np.nan


_BARREL = np.array([-0.32, 0.11, 0.0, 0.0, -0.015])


def _fixed_point(question: np.ndarray) -> np.ndarray:
    """The usual inversion: divide by the distortion at the last guess, five times (OpenCV's undistortPoints)."""
    guess = question.copy()
    for _ in range(5):
        guess = question * guess / distort(guess, "opencv", _BARREL)
    return guess


def _undistorted(inverse: Callable[[np.ndarray], np.ndarray], radius: float) -> float:
    true = radius * np.array([0.8, 0.6])
    return float(1000 * np.linalg.norm(inverse(distort(true, "opencv", _BARREL)) - true))


def _darkened(trust: float, form: str) -> float:
    grey = np.full((16, 16, 3), 0.6, np.float32)
    settings = replace(Injection(), form=form, settle=False, strength=0.9)  # type: ignore[arg-type]
    mixed, _ = inject(grey, [grey], [np.full((16, 16), 1 - trust, np.float32)], settings)
    return float(255 * abs(mixed - grey).max())


def _scale_error(moved: float, robust: bool) -> float:
    rng = np.random.default_rng(3)
    true_m = rng.uniform(1.5, 6, 4000)
    predicted = (true_m - 0.2) / 1.7
    where = rng.random(4000) < moved
    seen_m = np.where(where, rng.uniform(0.5, 1.5, 4000), true_m)
    if robust:
        found = align_depth(predicted, seen_m, np.ones(4000, bool), np.random.default_rng(0))
        return 100 * abs(found.scale / 1.7 - 1)
    return float(100 * abs(np.polyfit(predicted, seen_m, 1)[0] / 1.7 - 1))


def _mean_error(apart_deg: float, ours: bool) -> float:
    """Mean of two turns about z that lie ``apart_deg`` either side of half a turn: half a turn."""
    turns = rotations.exp(np.radians([[0.0, 0.0, 180 - apart_deg], [0.0, 0.0, 180 + apart_deg]]))
    found = rotations.mean(turns)[0] if ours else rotations.exp(rotations.log(turns).mean(0))
    return float(np.degrees(rotations.angle(found, rotations.exp(np.array([0.0, 0.0, np.pi])))))


CASES = (
    Case(
        "angle",
        "R01-R04",
        "Angle of a small turn",
        "arccos of the trace loses half of the digits: below 1e-8 rad every turn is none, or the same one",
        "arctan2 of sine and cosine keeps them all",
        "angle, rad",
        [10.0**-k for k in range(13)],
        "relative error",
        lambda x: abs(_arccos_angle(_turn(x)) / x - 1),
        lambda x: float(abs(rotations.angle(np.eye(3), _turn(x)) / x - 1)),
        1e-3,
    ),
    Case(
        "log",
        "R05-R09",
        "Rotation vector near half a turn",
        "the axis is divided by a sine that goes to zero",
        "the axis comes from the largest row of the quaternion",
        "short of half a turn, rad",
        [10.0**-k for k in range(1, 17)],
        "rotation lost, degrees",
        lambda x: _lost(_turn(np.pi - x), _textbook_log(_turn(np.pi - x))),
        lambda x: _lost(_turn(np.pi - x), rotations.log(_turn(np.pi - x))),
        1e-6,
    ),
    Case(
        "mean",
        "R16, R17, S",
        "Mean of turns on either side of half a turn",
        "vectors on either side point in opposite directions, and their mean is no turn at all",
        "the mean is the eigenvector of quaternions' outer products, whose signs do not matter",
        "apart, degrees",
        [40.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.1],
        "error, degrees",
        lambda x: _mean_error(x, False),
        lambda x: _mean_error(x, True),
        1e-6,
    ),
    Case(
        "triangulation",
        "T01-T16",
        "A point of four views, one of them wrong",
        "least squares shares the error among all",
        "pairs propose, the truncated cost picks, and only views that agree refine",
        "pixels that one view is off",
        [0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0],
        "error, mm",
        lambda x: _triangulated("dlt", x),
        lambda x: _triangulated("robust", x),
        20.0,
        log_x=False,
    ),
    Case(
        "distortion",
        "C09, C10",
        "Barrel distortion, undone",
        "dividing by the distortion of the last guess, a few times, ends too early where the picture ends",
        "Newton inside a bracket; beyond the fold there is no answer, and it says so",
        "radius, focal lengths",
        [0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0],
        "error, thousandths of the focal length",
        lambda x: _undistorted(_fixed_point, x),
        lambda x: _undistorted(lambda q: undistort(q, "opencv", _BARREL)[0], x),
        1e-6,
        log_x=False,
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
    Case(
        "depth",
        "D01-D07",
        "Scale of a depth map where people have moved",
        "least squares follows whatever moved",
        "Theil-Sen, then Huber rounds, stand up to 45 % of moved pixels",
        "share of moved pixels",
        [0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.45],
        "error of the scale, %",
        lambda x: _scale_error(x, False),
        lambda x: _scale_error(x, True),
        1.0,
        log_x=False,
    ),
)


def plot(case: Case, width: int = 460, height: int = 220) -> str:
    """The two errors as an SVG picture, errors in powers of ten."""
    left, top, right, bottom = 64, 26, width - 12, height - 40
    lines = {
        "textbook": [max(abs(np.nan_to_num(case.textbook(x), nan=1e3)), FLOOR) for x in case.xs],
        "ours": [max(abs(case.kept(x)), FLOOR) for x in case.xs],
    }
    powers = np.log10([value for values in lines.values() for value in values])
    low, high = float(np.floor(powers.min())), float(np.ceil(powers.max()) + (powers.max() == powers.min()))
    across = -np.log10(case.xs) if case.log_x else np.array(case.xs)
    span = float(across.max() - across.min())

    def place(index: int, value: float) -> str:
        x = left + (right - left) * (across[index] - across.min()) / span
        y = bottom - (bottom - top) * (np.log10(value) - low) / (high - low)
        return f"{x:.1f},{y:.1f}"

    drawn = [
        f'<polyline fill="none" stroke="{colour}" stroke-width="2" points="'
        + " ".join(place(i, value) for i, value in enumerate(lines[name]))
        + '"/>'
        for name, colour in (("textbook", "#b3541e"), ("ours", "#1e6fb3"))
    ]
    texts = [
        (left - 6, top + 8, "end", f"1e{high:.0f}"),
        (left - 6, bottom, "end", f"1e{low:.0f}"),
        (left, bottom + 14, "start", f"{case.xs[int(np.argmin(across))]:g}"),
        (right, bottom + 14, "end", f"{case.xs[int(np.argmax(across))]:g}"),
        ((left + right) / 2, height - 8, "middle", case.along),
        (left, top - 10, "start", case.error),
    ]
    words = [f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}">{text}</text>' for x, y, anchor, text in texts]
    names = '<tspan fill="#b3541e">textbook</tspan> <tspan fill="#1e6fb3">ours</tspan>'
    key = f'<text x="{right - 4}" y="{top - 10}" text-anchor="end">{names}</text>'
    frame = f'<path d="M{left} {top}V{bottom}H{right}" fill="none" stroke="#888"/>'
    body = "\n".join([frame, *drawn, *words, key])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        f'font-size="11" fill="#333">\n<rect width="{width}" height="{height}" fill="#fff"/>\n{body}\n</svg>\n'
    )


def page() -> str:
    """docs/stability.md."""
    rows = [
        f"## {case.title}\n\n![{case.title}: errors of the textbook and of ours](stability/{case.name}.svg)\n\n"
        f"*Textbook:* {case.breaks}. *Ours:* {case.ours}. Cases {case.ids} of the [hard cases](hard-cases.md).\n"
        for case in CASES
    ]
    return (
        "# Numerically stable, shown\n\nMade by `python -m tests.hard.stability`; do not edit by hand. Seven of the "
        "families of [hard cases](hard-cases.md): an input gets harder to the right, and the error of the formula that "
        "stands in most textbooks is drawn beside that of the one that is used here, against an answer that is known "
        "exactly. All 161 cases are tests.\n\n" + "\n".join(rows)
    )


def main() -> None:
    (DOCS / "stability").mkdir(exist_ok=True)
    for case in CASES:
        (DOCS / "stability" / f"{case.name}.svg").write_text(plot(case), encoding="utf-8")
    (DOCS / "stability.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
