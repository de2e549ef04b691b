# SPDX-License-Identifier: Apache-2.0
"""Every file of a capture's folder is used, or named with the reason."""

from __future__ import annotations

import tempfile
import unicodedata
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.footage.chapters import write_chapters
from studiorecon.footage.container import read_film_list
from studiorecon.footage.frames import read_stills, seek_frames
from studiorecon.footage.kinds import is_film
from studiorecon.footage.source import open_source
from studiorecon.footage.video import write_watchable
from studiorecon.plan.discovery import open_dataset
from studiorecon.plan.make import make_plan

from tests.faults.campaign import as_nobody
from tests.faults.rules import PLACES, Variant
from tests.made.footage import write_video

GB = 10**9


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., Path]:
    """A folder with these files, of so many bytes where a number follows a colon; a name that ends in / is a folder.

    Films differ in size, so that none is another's copy.
    """

    def make(names: str | Iterable[str]) -> Path:
        for number, entry in enumerate(names.split() if isinstance(names, str) else names):
            name, _, size = entry.partition(":")
            path = tmp_path / name
            if name.endswith("/"):
                path.mkdir(parents=True)
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("wb") as file:
                file.truncate(int(size or 0) + number)
        return tmp_path

    return make


@pytest.mark.parametrize(
    ("films", "keypoints", "pairs"),
    [
        ("2024.05.01_a.mp4 2024.05.01_b.mp4", "2024.05.01_a.npz 2024.05.01_b.npz", 2),
        ("a.mp4 b.MOV", "a.JSON b.csv", 2),
        ("a.mp4 b.mp4", "a.mp4.json b_keypoints.json", 2),
        ("a.mp4 b.mp4", "A.json B.json", 2),
        ("cam01.mp4 cam02.mp4", "cam1.json cam2.json", 2),
        ("Cam_1.mp4 Cam_2.mp4", "cam-01.json cam-02.json", 2),
        ("cam1.mp4 cam2.mp4 cam3.mp4", "01.npz 02.npz 03.npz", 3),
        ("Walk0003_Miqus_1.mp4 Walk0003_Miqus_2.mp4", "3.npz 4.npz", 0),
        ("a.mp4 b.mp4", "aDLC_resnet50_x.csv bDLC_resnet50_x.csv", 2),
        ("a.mp4 b.mp4", "a_json/ b_json/", 2),
        ("2024-05-11_take2_cam1.mp4 2024-05-11_take2_cam2.mp4", "cam1.json cam2.json", 2),
        ("cam1.mp4 cam2.mp4", "take2_cam1_2d.json take2_cam2_2d.json", 2),
        ("cam1.mp4 cam10.mp4", "take_cam1.json take_cam10.json", 2),
        ("cam1.mp4 cam1_b.mp4", "x_cam1.json x_cam1_b.json", 2),
        ("cam1.mp4 cam2.mp4", "cam3.json cam12.json", 0),
        ("cam1.mp4 cam2.mp4", "x_cam1.json y_cam1.json", 0),
    ],
)
def test_keypoints_belong_to_a_film_by_their_names(
    made: Callable[..., Path], films: str, keypoints: str, pairs: int
) -> None:
    folder = made([f"videos/{n}" for n in films.split()] + [f"keypoints/{n}" for n in keypoints.split()])
    found = open_dataset(folder)
    assert [p.name for p in found.keypoints.values()] == keypoints.replace("/", "").split()[:pairs]
    assert bool(found.notes) == (pairs == 0)


def test_names_that_differ_in_the_form_of_their_letters_are_one(made: Callable[..., Path]) -> None:
    one, other = (unicodedata.normalize(form, "Caméra gauche") for form in ("NFC", "NFD"))
    found = open_dataset(made([f"videos/{one}.mp4", "videos/b.mp4", f"keypoints/{other}.json", "keypoints/b.json"]))
    assert set(found.keypoints) == {one, "b"}
    assert not found.notes


FILMS = "videos/a.mp4 videos/b.mp4 "


@pytest.mark.parametrize("folder", ["pose-2d", "pose_2d", "pose", "openpose", "json", "keypoints_2d", "out/alphapose"])
def test_a_folder_of_keypoints_of_another_spelling_is_taken(made: Callable[..., Path], folder: str) -> None:
    found = open_dataset(made(f"{FILMS} {folder}/a.json {folder}/b.json"))
    assert set(found.keypoints) == {"a", "b"}


def test_of_two_folders_the_user_chooses_as_the_sentence_says(made: Callable[..., Path]) -> None:
    folder = made(f"{FILMS} pose-2d/a.json pose-2d/b.json detections/a.json detections/b.json pose-3d/a.csv")
    found = open_dataset(folder)
    assert not found.keypoints
    chosen = next(note for note in found.notes if "keypoints: " in note).rpartition("capture.yaml: ")[2]
    (folder / "capture.yaml").write_text(chosen + "\n")
    found = open_dataset(folder)
    assert {p.parent.name for p in found.keypoints.values()} == {chosen.partition(": ")[2]}
    assert [note.split(":")[1].split("/")[0].strip() for note in found.notes] == ["pose-2d", "pose-3d"]
    assert "another folder could be meant" in found.notes[0]


def test_films_deep_in_the_cameras_folders_are_found(made: Callable[..., Path]) -> None:
    found = open_dataset(made("Videos/Cam0/InputMedia/walk/walk.mp4 Videos/Cam1/InputMedia/walk/walk.mp4"))
    assert list(found.footage) == ["Cam0", "Cam1"]


def test_a_download_that_did_not_end_is_no_film(tmp_path: Path) -> None:
    film = write_video(tmp_path / "a.mp4", np.zeros((2, 32, 32, 3), np.uint8))
    assert is_film(film.rename(tmp_path / "a.xyz"))
    assert not is_film((tmp_path / "a.xyz").rename(tmp_path / "a.mp4.part"))


@pytest.mark.parametrize(
    ("files", "named"),
    [
        ("intri.yml extri.yml", ""),
        ("Intri.yaml EXTRI.YML", ""),
        ("calibration/intri.yml calibration/extri.yml", ""),
        ("Cameras/Intri.yml Cameras/extri.yaml", ""),
        ("other/intri.yml other/extri.yml", "other/extri.yml"),
        ("other/intri.yml other/extri.yml", "other/intri.yml"),
        ("calibration/intri.yml calibration/extri.yml cameras/intri.yml cameras/extri.yml", "cameras/extri.yml"),
    ],
)
def test_both_files_of_a_calibration_are_found(made: Callable[..., Path], files: str, named: str) -> None:
    folder = made(f"{FILMS} {files}")
    if named:
        assert not open_dataset(folder).calibration
        (folder / "capture.yaml").write_text(f"calibration: {named}\n")
    wanted = [name for name in files.split() if name.startswith(named.rpartition("/")[0])]
    found = open_dataset(folder)
    assert [path.relative_to(folder).as_posix() for path in found.calibration] == wanted
    assert any("is taken from" in note for note in found.notes) == ("/" in files and not named)


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("videos/c.xyz", "no film ends in .xyz"),
        ("c.mp4", "films are taken from videos/"),
        ("raw/c.mp4", "raw/ (1 file): films are taken from videos/"),
        ("videos/GX010101.LRV", "preview"),
        ("keypoints/a.json keypoints/b.json keypoints/c.json", "no camera's name fits it; cameras are a, b"),
        ("keypoints/a.json keypoints/b.json keypoints/a.csv", "camera a has keypoints in a.json already"),
        ("sound.wav", "sound"),
        ("keypoints.zip", "unpack"),
        ("a.png", "pictures are read from images/<camera>/"),
        ("calibration.json", "calibration: calibration.json into capture.yaml"),
        ("intri.yml extri.yml other.toml", "the calibration is intri.yml, extri.yml"),
        ("plates/a.png plates/x.png", "no camera's name fits"),
        ("notes.txt", "no file of a kind that is read"),
        ("empty/", "it is empty"),
        ("videos/.c.mp4", "a hidden or half-copied film"),
        ("videos/.c.mp4.x7Qz2k", "a hidden or half-copied film"),
        ("videos/capture.yaml", "in the capture's own folder"),
        ("capture.json", "in the capture's own folder"),
    ],
)
def test_what_is_not_used_is_named_with_the_reason(made: Callable[..., Path], extra: str, words: str) -> None:
    found = open_dataset(made(f"{FILMS} {extra} LICENSE readme.md .DS_Store videos/Thumbs.db videos/._a.mp4"))
    assert list(found.footage) == ["a", "b"]
    (note,) = found.notes
    assert note.startswith("not used: ")
    assert words in note


def test_previews_beside_films_are_no_cameras(tmp_path: Path) -> None:
    (tmp_path / "videos").mkdir()
    for number, name in enumerate(("a.mp4", "b.mp4", "GL010101.LRV", "LRV_b.mp4", "c.unknown")):
        made = grey_film(tmp_path / "film.mp4", range(3 + number))
        made.rename(tmp_path / "videos" / name)
    found = open_dataset(tmp_path)
    assert list(found.footage) == ["a", "b", "c"], "what holds a film is one, whatever its suffix"
    assert ["preview" in note for note in found.notes] == [True, True]


def test_a_camera_that_train_leaves_out_is_named(made: Callable[..., Path]) -> None:
    folder = made(f"{FILMS} videos/c.mp4 keypoints/a.json keypoints/b.json keypoints/c.json")
    (folder / "capture.yaml").write_text("train: [a, b]\n")
    assert [note.rpartition(": ")[2] for note in open_dataset(folder).notes] == [
        "train in capture.yaml leaves this camera out"
    ] * 2


@pytest.mark.parametrize("suffix", [".m4v", ".MTS", ".ts", ".mpg", ".wmv", ".3gp", ".mxf"])
def test_films_of_every_usual_suffix_are_found(made: Callable[..., Path], suffix: str) -> None:
    assert list(open_dataset(made(f"{FILMS} videos/c{suffix}")).footage) == ["a", "b", "c"]


@pytest.mark.parametrize(
    "names", ["Videos/a.mp4 Videos/b.mp4", "a/x.mp4 b/x.mp4", "videos/a/1.mp4 videos/b/1.mp4", "raw/a.mp4 raw/b.mp4"]
)
def test_films_in_other_folders_are_found_where_it_is_clear(made: Callable[..., Path], names: str) -> None:
    assert list(open_dataset(made(names)).footage) == ["a", "b"]


CHAPTERS = {
    "GoPro": ("GX010101 GX020101 GX010102 GX020102 GX030102", "GX010101:2 GX010102:3"),
    "GoPro before 2018": ("GOPR0101 GP010101 GP020101 GOPR0102", "GOPR0101:3 GOPR0102:1"),
    "renamed GoPro": ("left_GH010007 left_GH020007 right_GH010007", "left_GH010007:2 right_GH010007:1"),
    "Insta360": ("VID_20240501_120000_00_001 VID_20240501_120000_00_002 b", "VID_20240501_120000_00_001:2 b:1"),
    "full files of a camera": (f"C0001:{4 * GB} C0002:{GB} C0004:{GB}", "C0001:2 C0004:1"),
    "AVCHD": (f"00000:{2 * GB} 00001:{2 * GB} 00002 b", "00000:3 b:1"),
    "takes of a camera": ("C0001:1000 C0002:2000", "C0001:1 C0002:1"),
    "numbered cameras": (f"cam1:{4 * GB} cam2:{4 * GB} cam3:{4 * GB}", "cam1:1 cam2:1 cam3:1"),
    "second chapter alone": ("GX020101 GX010102", "GX020101:1 GX010102:1"),
}


@pytest.mark.parametrize(("names", "expected"), CHAPTERS.values(), ids=CHAPTERS)
def test_chapters_of_one_recording_are_one_camera(made: Callable[..., Path], names: str, expected: str) -> None:
    films = (name.partition(":") for name in names.split())
    found = open_dataset(made(f"videos/{name}.MP4{colon}{size}" for name, colon, size in films))
    counts = {camera: len(found.chapters.get(camera, [1])) for camera in found.footage}
    assert counts == {name: int(count) for name, count in (part.split(":") for part in expected.split())}
    assert len(found.notes) == sum(count > 1 for count in counts.values())
    for films_in_order in found.chapters.values():
        assert list(films_in_order) == sorted(films_in_order, key=lambda p: ("GP" in p.name, p.name))


def test_parts_that_are_not_sure_are_joined_as_the_sentence_says(made: Callable[..., Path]) -> None:
    folder = made(f"videos/cam{c}-{part}.mp4" for c in (1, 2) for part in (1, 2))
    found = open_dataset(folder)
    assert len(found.footage) == 4
    (note,) = found.notes
    line = note.partition("capture.yaml: ")[2].partition(", and likewise")[0]
    other = line.partition("{")[2].rstrip("}").replace("cam1", "cam2")
    (folder / "capture.yaml").write_text(f"{line.rstrip('}')}, {other}}}\n")
    found = open_dataset(folder)
    assert {c: [p.name for p in films] for c, films in found.chapters.items()} == {
        f"cam{c}-1": [f"cam{c}-1.mp4", f"cam{c}-2.mp4"] for c in (1, 2)
    }


def test_several_takes_in_a_camera_s_folder_are_joined_as_the_sentence_says(made: Callable[..., Path]) -> None:
    folder = made("videos/a/C0001.MP4 videos/a/C0002.MP4 videos/b/C0001.MP4")
    with pytest.raises(UserError) as refused:
        open_dataset(folder)
    (folder / "capture.yaml").write_text(str(refused.value).rpartition("capture.yaml: ")[2] + "\n")
    assert [p.name for p in open_dataset(folder).chapters["a"]] == ["C0001.MP4", "C0002.MP4"]


def grey_film(path: Path, levels: Iterable[int]) -> Path:
    write_watchable(path, (np.full((36, 64, 3), level, np.uint8) for level in levels), 25.0)
    return path


def test_chapters_are_read_as_one_film(tmp_path: Path) -> None:
    levels = np.arange(30, 230, 10)
    films = [grey_film(tmp_path / "it's 1.mp4", levels[:12]), grey_film(tmp_path / "it's 2.mp4", levels[12:])]
    joined = tmp_path / "x" / "joined.ffconcat"
    assert write_chapters(joined, films) == (12, 8)
    assert read_film_list(joined) == tuple(films)
    source = open_source(joined, 0.0)
    np.testing.assert_allclose(source.times_s, np.arange(20) / 25, atol=1e-3)
    for wanted in ([0, 5, 11, 12, 19], [13], [40]):
        expected = levels[np.minimum(wanted, 19)]
        np.testing.assert_allclose([p.mean() for p in seek_frames(source, wanted)], expected, atol=3)
    np.testing.assert_allclose([p.mean() for p in read_stills(source, [11, 12])], levels[[11, 12]], atol=3)


def test_films_of_two_sizes_are_no_chapters(tmp_path: Path) -> None:
    films = [grey_film(tmp_path / "1.mp4", range(3)), tmp_path / "2.mp4"]
    write_watchable(films[1], (np.zeros((72, 128, 3), np.uint8) for _ in range(3)), 25.0)
    with pytest.raises(UserError, match="differ"):
        write_chapters(tmp_path / "joined.ffconcat", films)


def test_paths_may_have_the_separators_of_windows(made: Callable[..., Path]) -> None:
    folder = made(f"{FILMS} out/2d/a.json out/2d/b.json cal/intri.yml cal/extri.yml")
    (folder / "capture.yaml").write_text("keypoints: out\\2d\ncalibration: [cal\\intri.yml, cal\\extri.yml]\r\n")
    found = open_dataset(folder)
    assert set(found.keypoints) == {"a", "b"}
    assert [path.name for path in found.calibration] == ["intri.yml", "extri.yml"]


@pytest.mark.parametrize("name", ["capture.yml", "Capture.yaml", "CAPTURE.YML"])
def test_the_description_may_be_spelled_otherwise(made: Callable[..., Path], name: str) -> None:
    folder = made(FILMS + " x/c.mp4")
    (folder / name).write_text("frames: {first: 3}\n")
    found = open_dataset(folder)
    assert found.first_frame == 3
    assert not any(name in note for note in found.notes)


def test_cameras_named_on_a_mac_have_composed_letters(made: Callable[..., Path]) -> None:
    apart = unicodedata.normalize("NFD", "Überkopf")
    found = open_dataset(made(f"videos/{apart}.mp4 videos/b.mp4 keypoints/Überkopf.json keypoints/b.json"))
    assert set(found.footage) == {"b", "Überkopf"}
    assert set(found.keypoints) == {"b", "Überkopf"}


# ---- Missing files that settings name are refused before the first job, and accepted once they exist ----


def orbit(**more: Any) -> dict[str, Any]:
    return {"render": {"shots": {"a": {"kind": "orbit", **more}}}}


NAMED = {
    "body": lambda file: {"body": file},
    "a stand-in": lambda file: orbit(replace={"p0": file}),
    "a camera path": lambda file: {"render": {"shots": {"a": {"kind": "path", "file": file}}}},
    "a reference": lambda file: orbit(reference=file),
    "identities": lambda file: {"people": {"identities": file}},
}


@pytest.mark.parametrize("changed", NAMED.values(), ids=NAMED)
@pytest.mark.parametrize("kind", ["missing", "folder", "dangling"])
def test_a_named_file_that_is_not_there_is_refused(
    configured: Callable[..., dict[str, Any]],
    home: Path,
    tmp_path: Path,
    changed: Callable[[str], dict[str, Any]],
    kind: str,
) -> None:
    file = tmp_path / "named.npz"
    config = configured(**changed(str(file)))
    if kind == "folder":
        file.mkdir()
    if kind == "dangling":
        file.symlink_to("nowhere")
    with pytest.raises(UserError, match=r"named\.npz"):
        make_plan(config, home)
    if kind == "folder":
        file.rmdir()
    file.unlink(missing_ok=True)
    file.touch()
    make_plan(config, home)


WHOLE = ("videos/a.mp4", "videos/b.mp4", "keypoints/a/0.json", "keypoints/b.npz", "plates/a.png", "identities.tsv")


PLACED = ("videos", "videos/a.mp4", "keypoints", "keypoints/b.npz", "plates", "identities.tsv")


# A folder may hold a camera's pictures or keypoints.
@pytest.mark.parametrize(
    ("rule", "place"), [(r, p) for r in PLACES for p in PLACED if r != "place: a folder" or "/" not in p]
)
def test_what_is_closed_or_no_file_of_a_capture_is_named(rule: str, place: str) -> None:
    """For a user who is not root, too: in a folder that everybody may enter, unlike pytest's own."""
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), Path(name) / place
        folder.chmod(0o755)
        for number, file in enumerate(WHOLE):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(b"\n" * number)
        assert not open_dataset(folder).notes
        if path.is_dir() and rule == "place: closed":
            path.chmod(0)
        else:
            path.rename(folder / ".away")
            Variant(rule, "", PLACES[rule]).lay(path)
        try:
            with as_nobody():
                said = "".join(open_dataset(folder).notes)
        except UserError as refusal:
            said = str(refusal)
        finally:
            if path.exists():
                path.chmod(0o755)
    assert place in said
    assert "\n" not in said
