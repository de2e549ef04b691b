# SPDX-License-Identifier: Apache-2.0
"""Reads the keypoints of all people from a detector's output on one picture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.hands import HAND_POINTS
from studiorecon.scene.user_values import as_list, numbers, short_text

if TYPE_CHECKING:
    from jaxtyping import Float

# Key of the list of people → (program, keys of a person's keypoints). OpenPose's names changed with its versions.
_LISTS = {
    "people": ("OpenPose", ("pose_keypoints_2d", "pose_keypoints", "body_parts")),
    "bodies": ("AlphaPose", ("joints",)),
    "annots": ("EasyMocap", ("keypoints",)),
    "instances": ("MMPose", ("keypoints",)),
    "predictions": ("MMPose", ("keypoints",)),
}
# Keys of a person's left and right hand, in OpenPose's versions and in EasyMocap.
_HANDS = (
    ("hand_left_keypoints_2d", "hand_right_keypoints_2d"),
    ("hand_left_keypoints", "hand_right_keypoints"),
    ("handl2d", "handr2d"),
)
# Beginnings of the keys for faces and hands.
_PARTS = ("face", "hand", "left", "righ")


def is_picture(content: Any) -> bool:
    """Whether ``content`` is a mapping that holds the people of one picture."""
    return isinstance(content, Mapping) and any(key in content for key in _LISTS)


def read_people(content: Any, where: str) -> tuple[list[Float[np.ndarray, "K 3"]], str]:
    """Keypoints (x, y, score) of all people in one picture, and the program that writes this format.

    ``content`` is a mapping with a list of people, or MMPose's bare list, nested or not. Null or empty entries, and
    ones with null keypoints, are left out. Raises UserError that begins with ``where``.
    """
    key = next((key for key in _LISTS if isinstance(content, Mapping) and key in content), None)
    if key is None and not isinstance(content, list):
        raise UserError(
            f"{where} is neither OpenPose's ({{people: […]}}), EasyMocap's ({{annots: […]}}) nor MMPose's ([…]) content"
        )
    program, keys = _LISTS[key or "instances"]
    people = as_list(content[key] if key else content, f"{where}: {key or 'the list'}", "[{…}, {…}]")
    if program == "MMPose" and any(isinstance(one, list) for one in people):
        people = [person for inner in people for person in (inner if isinstance(inner, list) else [inner])]
    found = []
    for place, person in enumerate(people):
        if person is None:
            continue
        who = f"{where}: entry {place} of {key or 'the list'}"
        if not isinstance(person, Mapping):
            raise UserError(f"{who} is {short_text(person)}; it must be one person's keypoints, or null for no person")
        given = next((person[name] for name in keys if name in person), ...)
        if given is ... and set(person) - {"person_id"}:
            others = [k for k in person if "keypoint" in str(k) and str(k)[:4] not in _PARTS]
            where_else = f", but {others[0]}" if others else f" ({short_text(', '.join(map(str, person)))} only)"
            raise UserError(f"{who} has no {keys[0]}{where_else}; write the body's keypoints so, or null for no person")
        if given is not None and given is not ... and len(points := _points(given, person, who)):
            found.append(np.concatenate([points, *_hands(person, who)]))
    return found, program


def _hands(person: Mapping[Any, Any], where: str) -> list[np.ndarray]:
    """Both hands' keypoints where a person has some: a hand that is missing is zeros, as OpenPose writes it."""
    given = next(([person.get(key) or [] for key in keys] for keys in _HANDS if any(map(person.get, keys))), [])
    hands = [_points(one, {}, f"{where}, a hand") if len(one) else np.zeros((HAND_POINTS, 3)) for one in given]
    if wrong := [len(one) for one in hands if len(one) != HAND_POINTS]:
        raise UserError(f"{where} has a hand of {wrong[0]} keypoints; it must have {HAND_POINTS}, or none")
    return hands


def _points(given: Any, person: Mapping[Any, Any], where: str) -> np.ndarray:
    """Keypoints of one person: triples, flat or in rows, pairs with ``keypoint_scores``, or Ultralytics' columns; NaN
    without scores."""
    if isinstance(given, Mapping) and {"x", "y"} <= given.keys():
        columns = [numbers(given[k], f"{where}: {k}", finite=False) for k in ("x", "y", "visible") if k in given]
        if any(column.shape != columns[0].shape or column.ndim != 1 for column in columns):
            raise UserError(f"{where}: x, y and visible have different lengths; one of each per keypoint is needed")
        given = np.column_stack(columns).tolist()
    points = numbers(given, f"{where}: keypoints", finite=False)
    points = points[0] if points.ndim == 3 and len(points) == 1 else points
    scores = person.get("keypoint_scores")
    if points.ndim == 2 and points.shape[1] == 2:
        given_scores = [math.nan] * len(points) if scores is None else scores
        score = numbers(given_scores, f"{where}: keypoint_scores", finite=False)
        if score.size != len(points):
            raise UserError(f"{where} has {len(points)} keypoints and {score.size} scores; one for each is needed")
        return np.column_stack([points, score.reshape(-1)])
    if scores is not None and points.ndim == 2 and points.size:
        raise UserError(f"{where}: keypoints are an array {points.shape} beside keypoint_scores; write x and y of each")
    if points.ndim > 2 or points.size % 3 or (points.ndim == 2 and points.size and points.shape[1] != 3):
        raise UserError(
            f"{where}: keypoints are an array {points.shape}; they must be triples of x, y, score, or pairs of x, y"
        )
    return points.reshape(-1, 3)
