# SPDX-License-Identifier: Apache-2.0
"""A picture of the fitted furniture: its edges on every photo, and the room from above with cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from studiorecon.depth.layout.primitives import Primitive
from studiorecon.depth.stereo.plates import Picture
from studiorecon.footage.video import to_bytes
from studiorecon.scene.camera import Camera
from studiorecon.scene.room import RoomBox

if TYPE_CHECKING:
    from jaxtyping import Float, Integer

_WIDTH = 640
_HIDDEN_SHARE = 0.02
_PAPER, _INK = (245, 243, 238), (60, 60, 60)


def primitive_edges(primitive: Primitive) -> Float[np.ndarray, "12 2 3"]:
    """End points of a primitive's edges, metres."""
    plan = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array(primitive.size_m) / 2
    c, s = np.cos(primitive.yaw_rad), np.sin(primitive.yaw_rad)
    plan = plan @ np.array([[c, s], [-s, c]]) + primitive.centre_m
    low, high = (np.column_stack([plan, np.full(len(plan), z)]) for z in (primitive.low_m, primitive.high_m))
    pairs = [(low, np.roll(low, -1, 0)), (high, np.roll(high, -1, 0)), (low, high)]
    return np.concatenate([np.stack(pair, axis=1) for pair in pairs])


def draw_outlines(
    picture: Picture, primitives: Sequence[Primitive], depth_m: Float[np.ndarray, "h w"]
) -> Integer[np.ndarray, "H W 3"]:
    """The photo with the edges that no surface of ``depth_m`` hides, one colour a primitive."""
    height = round(_WIDTH * picture.camera.hw[0] / picture.camera.wh[0])
    camera = picture.camera.resized((_WIDTH, height))
    canvas = cv2.resize(to_bytes(picture.rgb), (_WIDTH, height), interpolation=cv2.INTER_CUBIC)
    seen_m = cv2.resize(depth_m.astype(np.float32), (_WIDTH, height), interpolation=cv2.INTER_NEAREST)
    for k, primitive in enumerate(primitives):
        ends = primitive_edges(primitive)
        share = np.linspace(0, 1, 65)[:, None]
        for a, b in ends:
            pixels, z = camera.project(a + share * (b - a))
            place = np.nan_to_num(pixels, nan=-1).astype(int)
            inside = (z > 0.1) & (place >= 0).all(axis=-1) & (place < (_WIDTH, height)).all(axis=-1)
            behind = seen_m[place[:, 1].clip(0, height - 1), place[:, 0].clip(0, _WIDTH - 1)]
            shown = inside & ((behind <= 0) | (z < behind * (1 + _HIDDEN_SHARE) + _HIDDEN_SHARE))
            for i in np.flatnonzero(shown[:-1] & shown[1:]):
                cv2.line(canvas, tuple(map(int, place[i])), tuple(map(int, place[i + 1])), _colour(k), 2, cv2.LINE_AA)
    return canvas


def floor_plan(
    room_box: RoomBox, cameras: Sequence[Camera], primitives: Sequence[Primitive], height: int
) -> Integer[np.ndarray, "height 640 3"]:
    """The room's walls, every primitive with the height of its top in centimetres, cameras as dots."""
    canvas = np.full((height, _WIDTH, 3), _PAPER, np.uint8)
    u, v = [(room_box.low_m[a], room_box.high_m[a]) for a in (0, 1)]
    corners = np.array([(a, b, 0) for a, b in ((u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1]))]) @ room_box.axes
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    scale = 0.92 * min(_WIDTH / (high - low)[0], height / (high - low)[1])

    def at(points_m: np.ndarray) -> np.ndarray:
        return np.round(
            (np.asarray(points_m)[..., :2] - (low + high) / 2) * (scale, -scale) + (_WIDTH / 2, height / 2)
        ).astype(int)

    cv2.polylines(canvas, [at(corners)], True, _INK, 2, cv2.LINE_AA)
    for k, primitive in enumerate(primitives):
        for a, b in at(primitive_edges(primitive)):
            cv2.line(canvas, tuple(map(int, a)), tuple(map(int, b)), _colour(k), 2, cv2.LINE_AA)
        where = at(np.array(primitive.centre_m)) - (8, -4)
        cv2.putText(
            canvas,
            f"{100 * primitive.high_m:.0f}",
            tuple(map(int, where)),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.35,
            _INK,
            1,
            cv2.LINE_AA,
        )
    for camera in cameras:
        cv2.circle(canvas, tuple(map(int, at(camera.centre_m))), 5, _INK, -1, cv2.LINE_AA)
    return canvas


def overview_sheet(
    pictures: Sequence[Picture],
    room_box: RoomBox,
    primitives: Sequence[Primitive],
    depths_m: Sequence[Float[np.ndarray, "h w"]],
) -> Integer[np.ndarray, "H W 3"]:
    """All photos, two to a row, and the plan last."""
    shown = [draw_outlines(picture, primitives, depth_m) for picture, depth_m in zip(pictures, depths_m)]
    shown.append(floor_plan(room_box, [p.camera for p in pictures], primitives, shown[0].shape[0]))
    tallest = max(s.shape[0] for s in shown)
    shown = [cv2.copyMakeBorder(s, 0, tallest - s.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=_PAPER) for s in shown]
    if len(shown) % 2:
        shown.append(np.full_like(shown[0], _PAPER))
    return np.concatenate([np.concatenate(pair, axis=1) for pair in zip(shown[::2], shown[1::2])])


def _colour(k: int) -> tuple[int, int, int]:
    hue = np.array([[[(k * 67) % 180, 220, 235]]], np.uint8)
    red, green, blue = cv2.cvtColor(hue, cv2.COLOR_HSV2RGB)[0, 0]
    return int(red), int(green), int(blue)
