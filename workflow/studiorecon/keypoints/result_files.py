# SPDX-License-Identifier: Apache-2.0
"""Reads one JSON file of a whole film: its pictures and the keypoints of all people in them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.keypoints.file_numbers import MAX_NUMBER, number_names
from studiorecon.keypoints.mediapipe import is_mediapipe, lacks_frame_numbers, read_mediapipe
from studiorecon.keypoints.picture_content import is_picture, read_people
from studiorecon.scene.user_files import read_json
from studiorecon.scene.user_values import as_list, short_text, whole

if TYPE_CHECKING:
    from jaxtyping import Num


@dataclass(frozen=True)
class Pictures:
    """The content of one file, or folder, about a film's pictures.

    Attributes:
        program: the program whose format it is.
        people: number of a picture → keypoints of all people in it; may be empty.
        counted: whether the format counts frames from 0.
    """

    program: str
    people: Mapping[int, list[Num[np.ndarray, "K 3"]]]
    counted: bool = False


def read_results(path: Path, picture_wh: tuple[int, int]) -> Pictures:
    """A detector's results on a film; MediaPipe's shares become pixels of a picture of ``picture_wh``.

    Raises UserError naming the file, and the position in it, for content in none of the formats.
    """
    content = read_json(path)
    if is_mediapipe(content):
        return Pictures("MediaPipe", read_mediapipe(content, picture_wh, path), lacks_frame_numbers(content))
    if isinstance(content, Mapping):
        if "instance_info" in content:
            return _mmpose_demo(as_list(content["instance_info"], f"{path}: instance_info", "[{…}, {…}]"), path)
        if isinstance(content.get("annotations"), list):
            return _coco_dataset(content, path)
        if isinstance(content.get("keypoints"), list) and "skeleton" in content:
            return _easy_vitpose(content["keypoints"], path)
        if content and all(map(is_picture, content.values())):
            return _named(content, path)
    elif isinstance(content, list):
        if all(isinstance(one, Mapping) and {"image_id", "keypoints"} <= one.keys() for one in content):
            return _coco_results(content, path)
        if all(isinstance(one, Mapping) and "frame_id" in one for one in content):
            return Pictures("MMPose", dict(_numbered(content, path)))
        if all(isinstance(one, list) or is_picture(one) for one in content):
            listed_ = {place: read_people(one, f"{path}: entry {place}")[0] for place, one in enumerate(content)}
            return Pictures("MMPose", listed_, counted=True)
    raise UserError(
        f"{path} is none of the known results: a list of COCO results (AlphaPose, Detectron), AlphaPose's pictures by "
        "name, MMPose's instance_info or list of frame_id and instances, easy_ViTPose's or MediaPipe's lists"
    )


def _mmpose_demo(entries: list[Any], path: Path) -> Pictures:
    found = dict(_numbered(entries, path))
    # MMPose's demo counts frames from 1; a frame 0 shows another program's numbering.
    first = 0 if 0 in found else 1
    return Pictures("MMPose", {number - first: people for number, people in found.items()}, counted=True)


def _numbered(entries: list[Any], path: Path) -> Iterator[tuple[int, list[np.ndarray]]]:
    """Yields pictures of MMPose's {frame_id, instances}."""
    known = set()
    for place, entry in enumerate(entries):
        if not isinstance(entry, Mapping):
            raise UserError(f"{path}: entry {place} is {short_text(entry)}; it must be {{frame_id: …, instances: […]}}")
        number = whole(entry.get("frame_id"), f"{path}: frame_id of entry {place}", 0, MAX_NUMBER)
        if number in known:
            raise UserError(f"{path}: frame_id {number} comes twice; keep one entry per picture")
        known.add(number)
        if "instances" not in entry and "predictions" not in entry:
            raise UserError(f"{path}: entry {place} has no instances; write [] for a picture without people")
        yield number, read_people(entry, f"{path}, frame {number}")[0]


def _coco_results(entries: list[Mapping[str, Any]], path: Path) -> Pictures:
    """Results with one entry per person; pictures are numbered, or named."""
    number_of = _image_numbers([entry["image_id"] for entry in entries], path)
    found = defaultdict[int, list[Any]](list)
    for place, entry in enumerate(entries):
        number = number_of[entry["image_id"]]
        found[number] += read_people([entry], f"{path}, picture {number} (entry {place})")[0]
    return Pictures("AlphaPose/COCO", found)


def _coco_dataset(content: Mapping[str, Any], path: Path) -> Pictures:
    """COCO's own form: ``images`` with names, and ``annotations`` of them."""
    images = as_list(content.get("images"), f"{path}: images", "[{id: 1, file_name: 000000.jpg}]")
    for place, one in enumerate(images):
        if not (isinstance(one, Mapping) and isinstance(one.get("id"), (int, str)) and "file_name" in one):
            raise UserError(f"{path}: entry {place} of images is {short_text(one)}; it needs id and file_name")
    names = _image_numbers([str(one["file_name"]) for one in images], path)
    number_of = {one["id"]: names[str(one["file_name"])] for one in images}
    found: dict[int, list[Any]] = {number: [] for number in number_of.values()}
    for place, one in enumerate(content["annotations"]):
        if not isinstance(one, Mapping) or one.get("image_id") not in number_of:
            raise UserError(f"{path}: entry {place} of annotations belongs to no picture of images")
        found[number_of[one["image_id"]]] += read_people([one], f"{path}: entry {place} of annotations")[0]
    return Pictures("COCO", found)


def _named(content: Mapping[str, Any], path: Path) -> Pictures:
    """AlphaPose's pictures by name, in the forms of CMU's programs."""
    number_of = _image_numbers(list(content), path)
    people = {number_of[name]: read_people(one, f"{path}: {name}")[0] for name, one in content.items()}
    return Pictures("AlphaPose", people)


def _easy_vitpose(entries: list[Any], path: Path) -> Pictures:
    """easy_ViTPose's list of pictures, each {person: rows of y, x, score}."""
    found: dict[int, list[Any]] = {}
    for place, people in enumerate(entries):
        if not isinstance(people, Mapping):
            raise UserError(
                f"{path}: entry {place} of keypoints is {short_text(people)}; it must map people to keypoints"
            )
        rows = [{"keypoints": points} for points in people.values()]
        found[place] = [one[:, [1, 0, 2]] for one in read_people(rows, f"{path}, frame {place}")[0]]
    return Pictures("easy_ViTPose", found, counted=True)


def _image_numbers(names: list[Any], path: Path) -> dict[Any, int]:
    """image_id, a whole number or a name → number."""
    ids = list(dict.fromkeys(names)) if all(isinstance(n, (int, str, float)) for n in names) else names
    if ids and all(isinstance(one, str) for one in ids):
        stems = [one.rsplit(".", 1)[0] if "." in one else one for one in ids]
        return dict(zip(ids, number_names(stems, str(path))))
    what = "a name or a whole number"
    return {one: whole(one, f"{path}: image_id of entry {place}", 0, MAX_NUMBER, what) for place, one in enumerate(ids)}
