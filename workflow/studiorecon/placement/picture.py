# SPDX-License-Identifier: Apache-2.0
"""One picture of a plan: the room from above with its cameras, coverage, joint error, and figures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from studiorecon.placement.camera_placement import Move
from studiorecon.placement.rig_quality import RigEvaluator, RigQuality
from studiorecon.placement.room import HEAD_M, HIPS_M, WIDTH_M, Room
from studiorecon.scene.camera import Camera

_MAP_PX, _GAP_PX, _TOP_PX, _LINE_PX = 430, 50, 92, 19
# Names of viewing directions in the picture, from right (0°) counter-clockwise in steps of 45 degrees.
_WAYS = ("right", "far right", "to the far wall", "far left", "left", "near left", "to the near wall", "near right")
# Number of cameras that see a position at head height, 0 … 4 or more; two is the least that gives depth, three the
# least that can be checked.
_COUNTS = (("none", "#b9452f"), ("1", "#dd9a57"), ("2", "#efe0a0"), ("3", "#a3cfa0"), ("4 or more", "#4f9a78"))
# Upper limits of the error of a joint at hip height, millimetres.
_ERRORS = ((10, "#2f6f9f"), (15, "#6ba3c4"), (20, "#a9cbd9"), (30, "#efe0a0"), (50, "#dd9a57"), (np.inf, "#b9452f"))


def draw_plan(
    title: str, cameras: Sequence[Camera], evaluator: RigEvaluator, figures: RigQuality, moves: Sequence[Move] = ()
) -> str:
    """The picture as SVG; ``moves`` are drawn as arrows and listed."""
    room = evaluator.room
    width, depth = room.size_m[:2]
    scale = _MAP_PX / max(width, depth)
    high = scale * depth
    lines = [
        *figure_lines(figures),
        "",
        *(camera_position_text(camera, room) for camera in cameras),
        "",
        *(advice_line(move) for move in moves),
    ]
    total_w, total_h = 2 * _MAP_PX + 3 * _GAP_PX, _TOP_PX + high + 100 + _LINE_PX * (len(lines) + 1)
    counts, errors = _maps(cameras, evaluator)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total_w:.0f} {total_h:.0f}" '
        f'width="{total_w:.0f}" height="{total_h:.0f}" '
        'font-family="system-ui, sans-serif" font-size="13" fill="#2b2b2b">',
        f'<rect width="{total_w:.0f}" height="{total_h:.0f}" fill="#faf9f6"/>',
        _text(_GAP_PX, 36, title, "font-size='20' font-weight='600'"),
    ]
    titles = (f"Cameras that see a head ({HEAD_M} m)", f"Error of a joint at the hips ({HIPS_M} m), millimetres")
    legends = (
        _COUNTS,
        [(f"≤ {limit:.0f}" if np.isfinite(limit) else "more, or none", colour) for limit, colour in _ERRORS],
    )
    for k, (cells, described, legend) in enumerate(zip((counts, errors), titles, legends)):
        left = _GAP_PX + k * (_MAP_PX + _GAP_PX)
        parts += [
            _text(left, _TOP_PX - 14, described, "font-weight='600'"),
            f'<g transform="translate({left:.1f} {_TOP_PX})">',
        ]
        parts += _cells(cells, scale * width, high)
        parts += _plan(cameras, evaluator, scale, high, moves)
        parts += [*_axes(room, scale, high), "</g>", *_legend(left, _TOP_PX + high + 58, legend)]
    parts += [_text(_GAP_PX, _TOP_PX + high + 100 + _LINE_PX * k, line, "") for k, line in enumerate(lines)]
    return "\n".join([*parts, "</svg>", ""])


def figure_lines(figures: RigQuality) -> list[str]:
    """The figures as sentences."""

    def share(value: float) -> str:
        return f"{100 * value:.0f} %"

    def shares(named: dict[str, float], name: str, hidden: dict[str, float]) -> str:
        return f"{share(named[name])} of the stage ({share(hidden[name])} with somebody in the way)"

    known = [
        (words, value)
        for words, value in (("median", figures.error_m), ("90 % within", figures.worst_error_m))
        if np.isfinite(value)
    ]
    error = ", ".join(f"{words} {1000 * value:.0f} mm" for words, value in known) or "undetermined for most"
    unseen = ", ".join(f"{name} {share(figures.unseen[name])}" for name in ("floor", "walls", "ceiling"))
    return [
        *(
            f"Seen by two cameras at {name} height: {shares(figures.two, name, figures.two_hidden)}"
            for name in ("head", "floor")
        ),
        *(
            f"Seen by three cameras at {name} height: {shares(figures.three, name, figures.three_hidden)}"
            for name in ("head", "floor")
        ),
        f"Error of a joint, by the detector's noise alone: {error}; undetermined {share(figures.undetermined)}",
        "Seen by no camera, somebody standing in the middle: "
        f"{share(figures.unseen['all'])} of the room's surface ({unseen})",
    ]


def advice_line(move: Move) -> str:
    """One line of advice."""
    return f"{move.words[0].upper()}{move.words[1:]}: {100 * move.gain:.0f} % better, the others staying"


def camera_position_text(camera: Camera, room: Room) -> str:
    """Position and direction of a camera in words and metres; left, right, near and far as in the picture."""
    x, y, z = camera.centre_m - np.array(room.low_m)
    heading = np.degrees(np.arctan2(camera.forward[1], camera.forward[0])) % 360
    tilt = np.degrees(np.arcsin(np.clip(camera.forward[2], -1, 1)))
    way = _WAYS[round(heading / 45) % 8]
    return (
        f"{camera.name}: {x:.2f} m from the left wall, {y:.2f} m from the near one, {z:.2f} m high; faces {way} "
        f"({heading:.0f}°), {abs(tilt):.0f}° {'down' if tilt < 0 else 'up'}"
    )


def _maps(cameras: Sequence[Camera], evaluator: RigEvaluator) -> tuple[list[list[str]], list[list[str]]]:
    """Colours of the cells [row from the far side][column] of both maps."""
    room = evaluator.room
    step = max(room.size_m[:2]) / 44
    counted = [max(round(size / step), 1) for size in room.size_m[:2]]
    x, y = (low + (np.arange(n) + 0.5) * size / n for low, size, n in zip(room.low_m, room.size_m[:2], counted))
    flat = np.stack(np.meshgrid(x, y[::-1]), axis=-1).reshape(-1, 2)
    heads = np.column_stack([flat, np.full(len(flat), room.low_m[2] + HEAD_M)])
    counts = evaluator.sees(cameras, heads, None).sum(axis=0).reshape(len(y), len(x))
    errors = evaluator.joint_errors_m(
        cameras, np.column_stack([flat, np.full(len(flat), room.low_m[2] + HIPS_M)])
    ).reshape(counts.shape)
    limits = np.array([limit for limit, _ in _ERRORS]) / 1000
    banded = np.minimum(np.searchsorted(limits, errors), len(_ERRORS) - 1)
    return [[_COUNTS[min(n, 4)][1] for n in row] for row in counts], [[_ERRORS[n][1] for n in row] for row in banded]


def _cells(colours: list[list[str]], wide: float, high: float) -> list[str]:
    size = high / len(colours)
    across = wide / len(colours[0])
    drawn_cells = [
        f'<rect x="{column * across:.2f}" y="{row * size:.2f}" width="{across + 0.4:.2f}" '
        f'height="{size + 0.4:.2f}" fill="{colour}"/>'
        for row, line in enumerate(colours)
        for column, colour in enumerate(line)
    ]
    return ['<g shape-rendering="crispEdges">', *drawn_cells, "</g>"]


def _plan(
    cameras: Sequence[Camera], evaluator: RigEvaluator, scale: float, high: float, moves: Sequence[Move]
) -> list[str]:
    room = evaluator.room

    def at(place: np.ndarray) -> tuple[float, float]:
        return (place[0] - room.low_m[0]) * scale, high - (place[1] - room.low_m[1]) * scale

    stage = room.stage_m()
    (x0, y1), (x1, y0) = at(stage.min(axis=0)), at(stage.max(axis=0))
    x, y = at(room.middle_m)
    parts = [
        f'<rect width="{room.size_m[0] * scale:.1f}" height="{high:.1f}" '
        'fill="none" stroke="#2b2b2b" stroke-width="3"/>',
        f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" fill="none" stroke="#2b2b2b" '
        'stroke-dasharray="5 5"/>',
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{WIDTH_M / 2 * scale:.1f}" fill="none" '
        'stroke="#2b2b2b" stroke-width="1.5"/>',
    ]
    for camera in cameras:
        eye = camera.centre_m
        edges = (
            camera.unproject(np.array([[0.0, camera.wh[1] / 2], [camera.wh[0], camera.wh[1] / 2]]), np.ones(2))[:, :2]
            - eye[:2]
        )
        cone = eye[:2] + 1.1 * edges / np.linalg.norm(edges, axis=1, keepdims=True)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in (at(eye), at(cone[0]), at(cone[1])))
        parts.append(
            f'<polygon points="{points}" fill="#ffffff" fill-opacity="0.45" stroke="#2b2b2b" stroke-width="1"/>'
        )
        x, y = at(eye)
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="#2b2b2b"/>')
        x, y = at(cone.mean(axis=0))
        parts.append(_text(x, y, camera.name, "text-anchor='middle' font-weight='600'"))
    where = {camera.name: camera for camera in cameras}
    for move in moves:
        (x0, y0), (x1, y1) = at(where[move.camera].centre_m), at(move.better.centre_m)
        parts.append(
            f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="#c0267e" stroke-width="3"/>'
        )
        parts.append(f'<circle cx="{x1:.1f}" cy="{y1:.1f}" r="5" fill="none" stroke="#c0267e" stroke-width="3"/>')
    return parts


def _axes(room: Room, scale: float, high: float) -> list[str]:
    """SVG marks at every metre along the left and the near wall, from their corner, and the axes' names."""
    width, depth = room.size_m[:2]
    parts = []
    for k in range(int(width) + 1):
        parts.append(f'<line x1="{k * scale:.1f}" x2="{k * scale:.1f}" y1="{high}" y2="{high + 5}" stroke="#2b2b2b"/>')
        parts.append(_text(k * scale, high + 18, str(k), "text-anchor='middle' font-size='11'"))
    for k in range(int(depth) + 1):
        y = high - k * scale
        parts.append(f'<line x1="-5" x2="0" y1="{y:.1f}" y2="{y:.1f}" stroke="#2b2b2b"/>')
        parts.append(_text(-9, y + 4, str(k), "text-anchor='end' font-size='11'"))
    along = "metres from the left wall (near wall below)"
    parts.append(_text(width * scale / 2, high + 33, along, "text-anchor='middle' font-size='11'"))
    turned = f"text-anchor='middle' font-size='11' transform='rotate(-90 -30 {high / 2:.1f})'"
    return [*parts, _text(-30, high / 2, "metres from the near wall", turned)]


def _legend(left: float, top: float, entries: Sequence[tuple[str, str]]) -> list[str]:
    parts, x = [], left
    for words, colour in entries:
        parts.append(
            f'<rect x="{x:.1f}" y="{top - 11:.1f}" width="13" height="13" fill="{colour}" '
            'stroke="#2b2b2b" stroke-width="0.5"/>'
        )
        parts.append(_text(x + 18, top, words, ""))
        # Mean width of a letter.
        x += 18 + 7 * len(words) + 14
    return parts


def _text(x: float, y: float, words: str, how: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" {how}>{escape(words)}</text>'
