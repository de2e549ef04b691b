# SPDX-License-Identifier: Apache-2.0
"""Every shape in which programs write keypoints: the same people in the same pictures come back."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.keypoints.file_numbers import number_names
from studiorecon.keypoints.readers import read_keypoints
from studiorecon.scene.recorded_keypoints import RecordedKeypoints, read_recorded, write_recorded

# Two people in picture 0, nobody in 1, one in 2.
SEEN = {0: (0, 1), 1: (), 2: (2,)}
POINTS = np.random.default_rng(0).uniform(5, 90, (3, 17, 3)) * [1, 1, 0.01]


def flat(k: int) -> list[float]:
    return POINTS[k].reshape(-1).tolist()


def instance(k: int, **more: Any) -> dict[str, Any]:
    return {"keypoints": POINTS[k, :, :2].tolist(), "keypoint_scores": POINTS[k, :, 2].tolist(), **more}


def folder(person: Callable[[int], Any], around: Callable[[list[Any]], Any], name: str = "{:012d}_keypoints.json"):
    def write(path: Path) -> Path:
        for t, people in SEEN.items():
            (path / name.format(t)).write_text(json.dumps(around([person(k) for k in people])))
        return path

    return write


def one_file(content: Any) -> Callable[[Path], Path]:
    def write(path: Path) -> Path:
        (path / "cam.json").write_text(json.dumps(content))
        return path / "cam.json"

    return write


def per_picture(person: Callable[[int], Any], around: Callable[[int, list[Any]], Any]) -> list[Any]:
    return [around(t, [person(k) for k in people]) for t, people in SEEN.items()]


def coco(name: Callable[[int], Any], **more: Any) -> list[dict[str, Any]]:
    rows = [{"image_id": name(t), "category_id": 1, "keypoints": flat(k), "score": 2.9} | more
            for t, people in SEEN.items() for k in people]  # fmt: skip
    return rows[::-1]  # out of order


def npz(**arrays: np.ndarray) -> Callable[[Path], Path]:
    def write(path: Path) -> Path:
        np.savez(path / "cam.npz", **arrays)
        return path / "cam.npz"

    return write


def grid() -> np.ndarray:
    everybody = np.zeros((3, 2, 17, 3))
    everybody[0], everybody[2, 1] = POINTS[:2], POINTS[2]
    return everybody


def openpose(k: int) -> dict[str, Any]:
    return {"person_id": [-1], "pose_keypoints_2d": flat(k), "face_keypoints_2d": []}


FORMS: dict[str, Callable[[Path], Path]] = {
    "OpenPose": folder(openpose, lambda p: {"version": 1.3, "people": p}),
    "OpenPose, older": folder(lambda k: {"pose_keypoints": flat(k)}, lambda p: {"people": p}),
    "OpenPose, size behind the number": folder(openpose, lambda p: {"people": p}, "{:06d}_keypoints_1080.json"),
    "OpenPose with null people": folder(openpose, lambda p: {"people": [None, *p, {"pose_keypoints_2d": None}]}),
    "OpenPose with empty people": folder(openpose, lambda p: {"people": [*p, {"pose_keypoints_2d": []}]}),
    "OpenPose, null list": folder(openpose, lambda p: {"people": p or None}),
    "EasyMocap": folder(lambda k: {"personID": k, "keypoints": POINTS[k].tolist()}, lambda p: {"annots": p}),
    "AlphaPose": one_file(coco(lambda t: f"{t}.jpg", idx=[[0], [0]])),
    "AlphaPose, idx a number": one_file(coco(lambda t: f"clip2_{t:06d}.jpg", idx=1.0)),
    "AlphaPose as CMU": one_file(
        {f"{t}.jpg": {"version": "AlphaPose v0.2", "bodies": [{"joints": flat(k)} for k in people]}
         for t, people in SEEN.items()}),
    "AlphaPose as OpenPose": one_file(
        {f"{t}.jpg": {"version": "AlphaPose v0.2", "people": [openpose(k) for k in people]}
         for t, people in SEEN.items()}),
    "AlphaPose, a file a picture": folder(lambda k: {"joints": flat(k)}, lambda p: {"bodies": p}, "{}.json"),
    "Detectron": one_file(coco(lambda t: t)),
    "COCO's own": one_file({
        "images": [{"id": 100 + t, "file_name": f"a/{t:06d}.png"} for t in SEEN],
        "annotations": [{"image_id": 100 + t, "keypoints": flat(k)} for t, people in SEEN.items() for k in people],
    }),
    "MMPose demo": one_file({"meta_info": {}, "instance_info": per_picture(
        instance, lambda t, p: {"frame_id": t + 1, "instances": p})}),
    "MMPose demo from 0": one_file({"meta_info": {}, "instance_info": per_picture(
        instance, lambda t, p: {"frame_id": t, "instances": p})}),
    "MMPose inferencer": one_file(per_picture(
        lambda k: instance(k, bbox=[[1, 2, 3, 4]], bbox_score=0.9), lambda t, p: {"frame_id": t, "instances": p})),
    "MMPose inferencer, predictions": one_file(per_picture(instance, lambda _, p: {"predictions": [p]})),
    "MMPose, nested lists": one_file(per_picture(instance, lambda _, p: p)),
    "MMPose, a file a picture": folder(instance, lambda p: p, "{:06d}.json"),
    "MMPose, a nested file a picture": folder(instance, lambda p: [p] if p else [], "{:06d}.json"),
    "MMPose, one person in a list more": folder(
        lambda k: instance(k) | {"keypoints": [POINTS[k, :, :2].tolist()]}, lambda p: p, "{:06d}.json"),
    "easy_ViTPose": one_file({"skeleton": {}, "keypoints": [
        {str(k): POINTS[k][:, [1, 0, 2]].tolist() for k in people} for people in SEEN.values()]}),
    "npz": npz(keypoints=grid()),
    "npz, RTMLib's two arrays": npz(keypoints=grid()[..., :2], scores=grid()[..., 2]),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_shape_gives_the_same_people(tmp_path: Path, form: str) -> None:
    found = read_keypoints(FORMS[form](tmp_path))
    assert found.frame.tolist() == [0, 0, 2]
    order = np.lexsort((found.keypoints[:, 0, 0], found.frame))
    right = sorted((0, 1), key=lambda k: POINTS[k, 0, 0])
    np.testing.assert_allclose(found.keypoints[order], POINTS[[*right, 2]])
    assert found.pictures.tolist() in ([0, 1, 2], [0, 2])


@pytest.mark.parametrize("more", ["", " 0.9", " 0.9 4"], ids=["", "with scores", "with tracks"])
@pytest.mark.parametrize("place", [".", "labels"])
def test_yolo_s_labels_give_the_same_people(tmp_path: Path, more: str, place: str) -> None:
    """Ultralytics writes no file where it sees nobody, and 0 0 for a keypoint that it does not see."""
    (tmp_path / place).mkdir(exist_ok=True)
    shares = (POINTS + np.array([0.5, 0.5, 0])) / [640, 360, 1]
    shares[2, 4] = 0
    for t, people in SEEN.items():
        lines = [f"0 0.5 0.5 0.1 0.3 {' '.join(map(str, shares[k].reshape(-1).tolist()))}{more}\n" for k in people]
        if lines:
            (tmp_path / place / f"film_{t + 1}.txt").write_text("".join(lines))
    found = read_keypoints(tmp_path, (640, 360))
    assert (found.frame.tolist(), found.pictures.tolist()) == ([1, 1, 3], [1, 3])
    wanted = POINTS.copy()
    wanted[2, 4] = np.nan, np.nan, 0
    np.testing.assert_allclose(found.keypoints, wanted)


@pytest.mark.parametrize("people", [[], [None], [{}], [{"person_id": [-1]}], [{"pose_keypoints_2d": []}], None])
def test_nobody_anywhere_is_no_fault(tmp_path: Path, people: Any) -> None:
    for t in range(3):
        (tmp_path / f"{t}.json").write_text(json.dumps({"people": people}))
    found = read_keypoints(tmp_path)
    assert (len(found.frame), found.pictures.tolist()) == (0, [0, 1, 2])


@pytest.mark.parametrize("empty", ["[]", "folder", '{"instance_info": []}'])
def test_files_without_anybody_are_read(tmp_path: Path, empty: str) -> None:
    path = tmp_path if empty == "folder" else tmp_path / "cam.json"
    if empty != "folder":
        path.write_text(empty)
    assert not len(read_keypoints(path).frame)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"people": [{"pose_keypoints_2d": ["1", "2", "0.5"] * 17}]}, "not numbers"),
        ({"people": [{"pose_keypoints_2d": [1, 2]}]}, "triples"),
        ({"people": [{"keypoints": [1, 2, 3]}]}, "has no pose_keypoints_2d, but keypoints"),
        ({"people": [7]}, "must be one person's keypoints"),
        ([instance(0) | {"keypoint_scores": [1.0]}], "17 keypoints and 1 scores"),
        ([instance(0) | {"keypoints": POINTS[0].tolist()}], "beside keypoint_scores; write x and y"),
        ({"bones": []}, "neither"),
    ],
)
def test_what_is_no_person_is_named(tmp_path: Path, content: Any, says: str) -> None:
    (tmp_path / "cam_0003.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=f"cam_0003.*{says}"):
        read_keypoints(tmp_path)


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["000003_keypoints_1080", "000004_keypoints_1080"], [3, 4]),
        (["clip2_000000000012_keypoints", "clip2_000000000013_keypoints"], [12, 13]),
        (["cam01.0000", "cam01.0001"], [0, 1]),
        (["frame_9", "frame_10", "frame_11"], [9, 10, 11]),
        (["000012_keypoints_720"], [12]),
        (["7_233ms", "8_266ms", "9_300ms", "10_333ms"], [7, 8, 9, 10]),
        (["pose_1714557600123456789", "pose_1714557600156790123"], [1714557600123456789, 1714557600156790123]),
    ],
)
def test_the_number_that_counts_pictures_is_taken(names: list[str], numbers: list[int]) -> None:
    assert number_names(names, "keypoints") == numbers


def test_one_person_s_array_is_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "k.npz", keypoints=POINTS)
    assert read_keypoints(tmp_path / "k.npz").frame.tolist() == [0, 1, 2]


def test_what_was_read_survives_its_file_and_a_cut_one_is_named(tmp_path: Path) -> None:
    given = RecordedKeypoints("npz", np.arange(3), np.array([0, 2]), POINTS[:2], True, "coco17", "why")
    write_recorded(tmp_path / "r.npz", given)
    back = read_recorded(tmp_path / "r.npz")
    for name in RecordedKeypoints.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(given, name), err_msg=name)
    write_recorded(
        tmp_path / "r.npz", RecordedKeypoints("npz", np.arange(3), np.array([0]), POINTS[:2], True, "coco17")
    )
    with pytest.raises(UserError, match=r"r\.npz"):
        read_recorded(tmp_path / "r.npz")


VALUES = {
    "no number": ([np.nan, 2, 0.9], "1 of 40 keypoints are not numbers"),
    "infinite score": ([1, 2, np.inf], "1 of 40 keypoints are not numbers"),
    "outside of any picture": ([1e30, 2, 0.9], "1 of 40 keypoints are not numbers or outside of any picture"),
    "score below 0": ([1, 2, -0.5], "1 of 40 scores are below 0"),
    "gap": ([np.nan, np.nan, np.nan], ""),
    "missing": ([0, 0, -1], ""),
}


@pytest.mark.parametrize(
    ("score", "said"), [(0, "all scores are 0 or less"), (-2, "all scores"), (np.nan, "no scores")]
)
def test_people_without_any_score_are_not_dropped_in_silence(
    score: float, said: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    np.savez(tmp_path / "k.npz", keypoints=np.where([True, True, False], POINTS, score))
    assert len(read_keypoints(tmp_path / "k.npz").frame) == 3
    assert said in capsys.readouterr().out


@pytest.mark.parametrize("case", VALUES)
def test_keypoints_that_are_nowhere_are_left_out_and_counted(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    value, said = VALUES[case]
    points = np.tile([10.0, 20.0, 0.8], (2, 1, 20, 1))
    points[1, 0, 3] = value
    np.savez(tmp_path / "k.npz", keypoints=points)
    found = read_keypoints(tmp_path / "k.npz")
    assert said in (out := capsys.readouterr().out)
    assert bool(out) == bool(said)
    assert not found.keypoints[1, 3, 2] > 0
    np.testing.assert_array_equal(np.delete(found.keypoints.reshape(40, 3), 23, 0), np.tile([10, 20, 0.8], (39, 1)))


@pytest.mark.parametrize("kind", [complex, bool, "U4", "M8[s]", [("x", "f4")]], ids=str)
def test_arrays_of_no_real_numbers_are_named_by_their_kind(kind: Any, tmp_path: Path) -> None:
    array = np.zeros((2, 1, 17, 3), kind)
    np.savez(tmp_path / "k.npz", keypoints=array)
    with pytest.raises(UserError, match=r"k\.npz: keypoints: the array holds .*; it must hold real numbers"):
        read_keypoints(tmp_path / "k.npz")
