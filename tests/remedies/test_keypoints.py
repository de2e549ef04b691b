# SPDX-License-Identifier: Apache-2.0
"""What a sentence about a keypoint file advises is done here, and then the same people are read without a word."""

from __future__ import annotations

import json
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.keypoints.layout_choice import choose_layout
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.keypoints.readers import read_keypoints

from tests.made.file_contents import npy
from tests.made.remedies import follow

FRAMES = 3
COCO = LAYOUTS["coco17"].keypoints
Write = Callable[[Path], Path]


def person(points: int = 17, score: float = 0.9, at: int = 0) -> np.ndarray:
    grid = np.stack([np.arange(points) * 5.0 + 20 + at, 200 - np.arange(points) * 3.0 + at], -1)
    return np.column_stack([grid, np.full(points, score)])


def flat(points: int = 17, score: float = 0.9, at: int = 0) -> list[float]:
    return person(points, score, at).ravel().tolist()


def text(name: str, content: str) -> Write:
    def write(folder: Path) -> Path:
        (folder / name).write_text(content)
        return folder / name

    return write


def js(content: Any) -> Write:
    return text("cam.json", json.dumps(content))


def coco(points: int = 17, score: float = 0.9, people: int = 1, **more: Any) -> Write:
    return js(
        [
            {"image_id": frame, "keypoints": flat(points, score, at), **more}
            for frame in range(FRAMES)
            for at in range(people)
        ]
    )


def npz(folder: Path) -> Path:
    np.savez(folder / "cam.npz", keypoints=np.tile(person(), (FRAMES, 1, 1, 1)))
    return folder / "cam.npz"


def deeplabcut(names: tuple[str, ...] = COCO, frames: tuple[int, ...] = tuple(range(FRAMES))) -> Write:
    head = [["scorer", *["DLC"] * 51], ["bodyparts", *(n for n in names for _ in "xyl")]]
    head += [["coords", *["x", "y", "likelihood"] * 17]]
    rows = [[str(frame), *map(str, flat())] for frame in frames]
    return text("cam.csv", "\n".join(",".join(row) for row in [*head, *rows]))


def mmpose(second: dict[str, Any]) -> Write:
    shown = {"instances": [{"keypoints": person()[:, :2].tolist(), "keypoint_scores": [0.9] * 17}]}
    return js([{"frame_id": 0, **shown}, {"frame_id": 1, **shown}, {"frame_id": 2, **shown} | second])


def folder(name: str, content: str) -> Write:
    def write(where: Path) -> Path:
        (where / "cam").mkdir(exist_ok=True)
        for frame in range(FRAMES):
            (where / "cam" / name.format(frame)).write_text(content)
        return where / "cam"

    return write


OPENPOSE = json.dumps({"people": [{"pose_keypoints_2d": flat(18)}]})
LANDMARK = {"x": 0.5, "y": 0.5, "visibility": 0.9}


def mediapipe(landmark: dict[str, float] = LANDMARK) -> Write:
    return js([{"frame": f, "pose_landmarks": [[landmark, *[LANDMARK] * 32]]} for f in range(FRAMES)])


COCO_OK = coco()


def arrays(**named: Any) -> Write:
    def write(where: Path) -> Path:
        np.savez(where / "cam.npz", **named)
        return where / "cam.npz"

    return write


def npz_of(content: bytes, *, times: int = 1) -> Write:
    def write(where: Path) -> Path:
        with zipfile.ZipFile(where / "cam.npz", "w") as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            for _ in range(times):
                archive.writestr("keypoints.npy", content)
        return where / "cam.npz"

    return write


def edited(write: Write, old: str, new: str) -> Write:
    def edit(where: Path) -> Path:
        path = write(where)
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))
        return path

    return edit


def names_in(folder_names: tuple[str, ...]) -> Write:
    def write(where: Path) -> Path:
        (where / "cam").mkdir()
        for name in folder_names:
            (where / "cam" / name).write_text(OPENPOSE)
        return where / "cam"

    return write


def picture(person: Any) -> Write:
    return folder("cam_{}.json", json.dumps({"people": [person]}))


NPY = npy(np.tile(person(), (FRAMES, 1, 1, 1)))
LISTED = {"images": [{"id": f, "file_name": f"{f}.jpg"} for f in range(FRAMES)],
          "annotations": [{"image_id": f, "keypoints": flat()} for f in range(FRAMES)]}  # fmt: skip
VITPOSE = {"skeleton": {}, "keypoints": [{"0": person()[:, [1, 0, 2]].tolist()} for _ in range(FRAMES)]}
RESULTS, CONTENT, TABLE = "keypoints/result_files.py", "keypoints/picture_content.py", "keypoints/deeplabcut.py"
READERS, FILES, NUMBERS = "keypoints/readers.py", "scene/user_files.py", "keypoints/file_numbers.py"
# A good file, and damages of it with the place of the sentence.
MORE: list[tuple[Write, list[tuple[str, Write]]]] = [
    (npz, [
        (f"{READERS} _neutral 1", arrays(points=person())),
        (f"{READERS} _neutral 2", arrays(keypoints=np.ones((3, 17)))),
        (f"{READERS} _neutral 3", arrays(keypoints=np.ones((3, 1, 17, 2)), scores=np.ones(3))),
        (f"{READERS} _checked 2", arrays(keypoints=np.ones((3, 1, 1001, 3)))),
        ("scene/user_values.py numbers 1", arrays(keypoints=np.full((3, 1, 17, 3), "a"))),
        (f"{FILES} _array 1", arrays(keypoints=np.array([{}], object))),
        (f"{FILES} _array 2", npz_of(NPY[:200])),
        (f"{FILES} _array 3", npz_of(b"these are no numbers" * 9)),
        (f"{FILES} read_npz 1", npz_of(NPY, times=2)),
        (f"{FILES} read_npz 3", text("cam.npz", "these are no arrays")),
    ]),
    (folder("cam_{}.json", OPENPOSE), [
        (f"{READERS} _folder", folder("cam_{}.xml", "x")),
        (f"{NUMBERS} number_names 1", names_in(("a.json", "b.json", "c.json"))),
        (f"{NUMBERS} number_names 2", names_in(("a_1.json", "b_1.json", "c_2.json"))),
        (f"{NUMBERS} _whole", names_in((f"a_{'9' * 30}.json", "a_1.json", "a_2.json"))),
        (f"{CONTENT} read_people 1", folder("cam_{}.json", "{}")),
        (f"{CONTENT} read_people 2", picture(5)),
        (f"{CONTENT} read_people 3", picture({"keypoints_of_person": flat()})),
        (f"{CONTENT} _hands", picture({"pose_keypoints_2d": flat(18), "hand_left_keypoints_2d": flat(3)})),
        (f"{CONTENT} _points 3", picture({"pose_keypoints_2d": [[1.0, 2.0, 3.0]] * 17, "keypoint_scores": [1.0] * 17})),
        (f"{CONTENT} _points 4", picture({"pose_keypoints_2d": flat()[:-1]})),
        (f"{FILES} read_json 1", folder("cam_{}.json", "{")),
    ]),
    (js(LISTED), [
        (f"{RESULTS} _coco_dataset 1", js(LISTED | {"images": [{"id": 0}]})),
        (f"{RESULTS} _coco_dataset 2", js(LISTED | {"annotations": [{"image_id": 9, "keypoints": flat()}]})),
    ]),
    (js(VITPOSE), [(f"{RESULTS} _easy_vitpose", js(VITPOSE | {"keypoints": [[1]]}))]),
    (mmpose({}),
     [(f"{READERS} _usable 1", js([{"frame_id": 0, "instances": [{"keypoints": person()[:, :2].tolist()}]}])),
        (f"{RESULTS} _numbered 1", js({"instance_info": [5]}))]),
    (mediapipe(), [
        ("keypoints/mediapipe.py _people", js([{"frame": 0, "pose_landmarks": [5]}])),
        ("keypoints/mediapipe.py _points 2", js([{"frame": 0, "pose_landmarks": [[LANDMARK] * 32]}])),
        ("keypoints/mediapipe.py read_mediapipe", js([{"frame": 0, "pose_landmarks": [[LANDMARK] * 33]}] * 2)),
    ]),
    (deeplabcut(), [
        (f"{TABLE} _table 3", edited(deeplabcut(), "scorer", "points")),
        (f"{TABLE} _table 4", edited(deeplabcut(), "coords,", "coords,x,")),
        (f"{TABLE} _table 5", edited(deeplabcut(), "likelihood", "z")),
        (f"{TABLE} _table 6", deeplabcut((COCO[0], *COCO[:-1]))),
        (f"{TABLE} _values 1", edited(deeplabcut(), "\n1,", "\n")),
        (f"{TABLE} _values 2", edited(deeplabcut(), "0.9", "many")),
    ]),
    (coco(), [
        (f"{READERS} _usable 2", js([{"image_id": f, "keypoints": [1e9, 1e9, 0.9, *flat(16)]} for f in range(FRAMES)])),
        (f"{READERS} _usable 4", js([{"image_id": f, "keypoints": [5, 5, -0.5, *flat(16)]} for f in range(FRAMES)])),
    ]),
]  # fmt: skip
# What is brought, where it is said, and what the sentence advises, done.
ROWS: dict[str, tuple[Write, str, Write]] = {
    "HDF5": (text("cam.h5", "x"), "keypoints/readers.py read_keypoints 1", deeplabcut()),
    "HDF5 of Windows": (text("cam.H5", "x"), "keypoints/readers.py read_keypoints 1", npz),
    "SLEAP": (text("cam.slp", "x"), "keypoints/readers.py read_keypoints 1", npz),
    "pickle": (text("cam.pickle", "x"), "keypoints/readers.py read_keypoints 1", deeplabcut()),
    "npy": (text("cam.npy", "x"), "keypoints/readers.py read_keypoints 1", npz),
    "unknown": (text("cam.txt", "x"), "keypoints/readers.py read_keypoints 2", npz),
    "two models": (
        js([{"image_id": 0, "keypoints": flat()}, {"image_id": 1, "keypoints": flat(18)}]),
        "keypoints/readers.py _checked 1",
        COCO_OK,
    ),
    "crowd": (coco(people=501), "keypoints/readers.py _checked 3", COCO_OK),
    "no such layout": (coco(12), "keypoints/layout_choice.py choose_layout 3", COCO_OK),
    "scores of nobody": (coco(score=-2.0), "keypoints/readers.py _usable 3", COCO_OK),
    "per cent": (coco(score=90.0), "keypoints/readers.py _usable 5", COCO_OK),
    "an animal": (deeplabcut(tuple(f"tail{k}" for k in range(17))), "keypoints/deeplabcut.py _layout 1", deeplabcut()),
    "two noses": (deeplabcut(("nose", "Nose", *COCO[2:])), "keypoints/deeplabcut.py _layout 2", deeplabcut()),
    "a row twice": (deeplabcut(frames=(0, 1, 1)), "keypoints/deeplabcut.py read_deeplabcut", deeplabcut()),
    "SLEAP's table": (text("cam.csv", "track,frame_idx,nose.x\n1,0,2\n"), "keypoints/deeplabcut.py _table 2", npz),
    "no instances": (js([{"frame_id": 0}]), "keypoints/result_files.py _numbered 3", mmpose({})),
    "a frame twice": (mmpose({"frame_id": 1}), "keypoints/result_files.py _numbered 2", mmpose({})),
    "hands only": (
        js({"people": [{"hand_keypoints": flat()}]}),
        "keypoints/result_files.py read_results",
        COCO_OK,
    ),
    "scores apart": (mmpose({"instances": [{"keypoints": person()[:, :2].tolist(), "keypoint_scores": [1]}]}),
                     "keypoints/picture_content.py _points 2", mmpose({})),
    "a landmark's name": (mediapipe({"X": 0.5}), "keypoints/mediapipe.py _points 1", mediapipe()),
    "text in a folder": (folder("cam_{}.txt", "0 0.5"), "keypoints/readers.py _yolo_people",
        folder("cam_{}.json", OPENPOSE)),
    "columns of two lengths": (
        js([[{"keypoints": {"x": [1.0, 2.0], "y": [1.0]}}]]),
        "keypoints/picture_content.py _points 1",
        js([[{"keypoints": dict(zip(("x", "y", "visible"), person().T.tolist()))}] for _ in range(FRAMES)]),
    ),
    **{
        f"{place} {number}": (damaged, place, good)
        for good, several in MORE
        for number, (place, damaged) in enumerate(several)
    },
    "landmarks in pixels": (mediapipe({"x": 640.0, "y": 300.0}), "keypoints/mediapipe.py _points 3", mediapipe()),
}  # fmt: skip


def read(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """(people, what was said of them) of a file, once its layout is chosen."""
    found = read_keypoints(path, (640, 360))
    choose_layout(found.keypoints, "auto", path.name)
    return len(found.frame), capsys.readouterr().out + capsys.readouterr().err


@pytest.mark.parametrize("row", ROWS)
def test_a_keypoint_file_changed_as_advised_is_read(
    row: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    brought, place, done = ROWS[row]
    for name in ("before", "after"):
        (tmp_path / name).mkdir()
    follow(place, lambda: read(brought(tmp_path / "before"), capsys), lambda: read(done(tmp_path / "after"), capsys))
    people, message = read(done(tmp_path / "after"), capsys)
    assert people == FRAMES
    assert not message


@pytest.mark.parametrize(("separator", "point"), [(";", ","), ("\t", ".")])
def test_tables_of_other_languages_are_read(separator: str, point: str, tmp_path: Path) -> None:
    usual = deeplabcut()(tmp_path)
    wanted = read_keypoints(usual).keypoints
    usual.write_text(usual.read_text().replace(",", separator).replace(".", point))
    np.testing.assert_array_equal(read_keypoints(usual).keypoints, wanted)


def test_a_folder_within_the_camera_s_folder_is_read(tmp_path: Path) -> None:
    below = folder("cam_{}_keypoints.JSON", OPENPOSE)(tmp_path).rename(tmp_path / "json")
    (tmp_path / "cam").mkdir()
    below.rename(tmp_path / "cam/json")
    assert read_keypoints(tmp_path / "cam").pictures.tolist() == list(range(FRAMES))


@pytest.mark.parametrize(
    ("given", "points", "messages", "advised"),
    [
        ("openpose", 17, "known layouts are .*coco17", "coco17"),
        ("body_25", 17, "body_25 has 25", "auto"),
        ("auto", 25, "set keypoint_layout in capture.yaml", "body_25b"),
    ],
)
def test_a_layout_named_as_advised_is_taken(given: str, points: int, messages: str, advised: str) -> None:
    keypoints = np.tile(np.array([50.0, 50.0, 0.9]), (4, points, 1))
    with pytest.raises(UserError, match=messages):
        choose_layout(keypoints, given, "cam.json")
    assert choose_layout(keypoints, advised, "cam.json")[0] in LAYOUTS


def standing(layout: str, parts: float = 1.0) -> np.ndarray:
    """(4, K, 3) a person who stands upright, of whom the upper share ``parts`` is seen, in the order of ``layout``."""
    heights = {
        "head_top": 0, "nose": 12, "eye": 10, "ear": 12, "face": 14, "neck": 25, "thorax": 30, "shoulder": 35,
        "elbow": 65, "wrist": 95, "spine": 70, "hip": 100, "knee": 145, "ankle": 190,
    }  # fmt: skip
    points = []
    for name in LAYOUTS[layout].keypoints:
        part = next(key for key in heights if key in name)
        wide = {"eye": 4, "ear": 8}.get(part, 20)
        across = wide if name.startswith("left") else -wide if name.startswith("right") else 0
        points.append([300 + across, 80 + heights[part], 0.9 * (heights[part] <= 200 * parts)])
    return np.tile(np.array(points), (4, 1, 1))


@pytest.mark.parametrize("parts", [1.0, 0.3])
@pytest.mark.parametrize("layout", ["coco17", "human36m17"])
def test_seventeen_points_are_coco_s_unless_whole_people_show_another_order(layout: str, parts: float) -> None:
    chosen, sentence = choose_layout(standing(layout, parts), "auto", "cam.json")
    assert chosen == (layout if parts == 1.0 else "coco17")
    assert (sentence is not None) == (chosen == "human36m17")


def test_mpii_s_sixteen_points_are_known_by_their_number() -> None:
    assert choose_layout(standing("mpii16"), "auto", "cam.json")[0] == "mpii16"
