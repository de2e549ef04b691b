# SPDX-License-Identifier: Apache-2.0
"""What is said of a capture's folder and of capture.yaml is done here, and then the folder is opened."""

from __future__ import annotations

import os
import shlex
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.plan import dates
from studiorecon.plan.discovery import open_dataset

from tests.faults.campaign import as_nobody
from tests.made.remedies import follow

FILMS = ("videos/01.mp4", "videos/02.mp4", "videos/no.mp4")
GOPRO = ("videos/GX010101.MP4", "videos/GX020101.MP4", "videos/GX030101.MP4")
KEYPOINTS = tuple(film.replace("videos", "keypoints").replace("MP4", "npz") for film in GOPRO)
TWO_TAKES = ("videos/a/C1.MP4", "videos/a/C2.MP4", "videos/b/C1.MP4")
CAPTURE, VALUES, FILES = "scene/capture_yaml.py", "scene/user_values.py", "scene/user_files.py"


@dataclass(frozen=True)
class Folder:
    """capture.yaml and the files beside it; a name that ends in / is a folder, one with -> a link."""

    text: str = ""
    files: tuple[str, ...] = FILMS

    def opened(self, folder: Path) -> None:
        folder.mkdir()
        for number, name in enumerate(self.files):
            path, _, target = name.partition("->")
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            if target:
                (folder / path).symlink_to(target)
            elif path.endswith("/"):
                (folder / path).mkdir()
            else:
                (folder / path).write_bytes(bytes(number + 1))  # of different sizes: no film is another's copy
        if self.text:
            (folder / "capture.yaml").write_bytes(self.text.encode("latin-1") + b"\n")
        open_dataset(folder)


def lines(place: str, brought: str, advised: str) -> tuple[str, Folder, Folder]:
    return place, Folder(brought), Folder(advised)


# Where it is said, what is brought, and the same once that was done.
ROWS: dict[str, tuple[str, Folder, Folder]] = {
    "a leading zero": lines(f"{VALUES} whole", "frames: {first: 010}", "frames: {first: 10}"),
    "sexagesimal": lines(f"{VALUES} number 1", "starts: {'02': 12:30}", "starts: {'02': 750}"),
    "a key twice": lines(f"{FILES} read_yaml 1", "people: 1\npeople: 0", "people: 1"),
    "no YAML": lines(f"{FILES} read_yaml 1", ": : :", "people: 1"),
    "nested": lines(f"{FILES} read_yaml 2", "held_out: " + "[" * 4000, "held_out: [no]"),
    "Latin 1": lines(f"{FILES} read_text 2", "held_out: [no] # caf\xe9", "held_out: [no] # caf\xc3\xa9"),
    "UTF-16": lines(f"{FILES} read_text 1", "\xff\xfep\0", "people: 1"),
    "zeros": lines(f"{FILES} read_text 3", "people: 1\n\0\0", "people: 1"),
    "quoted number": lines(f"{VALUES} number 1", "focal_px: '1200'", "focal_px: 1200"),
    "underscores": lines(f"{VALUES} number 1", "focal_px: 1_200", "focal_px: 1200"),
    "a word for a number": lines(f"{VALUES} number 1", "starts: {02: early}", "starts: {02: 13}"),
    "focal length in millimetres": lines(f"{VALUES} number 2", "focal_px: 24", "focal_px: 1200"),
    "height in centimetres": lines(f"{VALUES} number 2", "height_m: 178", "height_m: 1.78"),
    "height not finite": lines(f"{VALUES} number 2", "height_m: .nan", "height_m: 1.78"),
    "offset beyond pictures": lines(f"{VALUES} number 2", "pixel_maps: {01: {scale: 1, offset: [90000, 0]}}",
                                    "pixel_maps: {01: {scale: 1, offset: [9, 0]}}"),
    "scale beyond pictures": lines(f"{VALUES} number 2", "pixel_maps: {01: {scale: 400, offset: [0, 0]}}",
                                   "pixel_maps: {01: {scale: 4, offset: [0, 0]}}"),
    "below zero": lines(f"{VALUES} whole", "frames: {first: -3}", "frames: {first: 0}"),
    "truth of YAML 1.1": lines(f"{VALUES} whole", "people: off", "people: 0"),
    "no mapping": lines(f"{VALUES} as_mapping", "frames: 5", "frames: {first: 5}"),
    "a number for all starts": lines(f"{VALUES} as_mapping", "starts: 13", "starts: {02: 13}"),
    "no list": lines(f"{VALUES} as_list", "held_out: no", "held_out: [no]"),
    "no text": lines(f"{VALUES} name", "keypoint_layout: true", "keypoint_layout: coco17"),
    "a long name": lines(f"{VALUES} path", f"calibration: {'a' * 300}", "people: 1"),
    "key in two spellings": lines(f"{FILES} read_yaml 1", "starts: {02: 1, '02': 3}", "starts: {02: 3}"),
    "misspelt key": lines(f"{CAPTURE} read_description 3", "heldout: [no]", "held_out: [no]"),
    "capital key": lines(f"{CAPTURE} read_description 3", "Focal_px: 900", "focal_px: 900"),
    "no lines": lines(f"{CAPTURE} read_description 2", "- held_out", "held_out: [no]"),
    "no such camera": lines(f"{CAPTURE} _check_named", "starts: {03: 13}", "starts: {02: 13}"),
    "zero left out": lines(f"{CAPTURE} _check_named", "starts: {2: 13}", "starts: {02: 13}"),
    "camera twice": lines(f"{CAPTURE} names_under", "held_out: [no, no]", "held_out: [no]"),
    "no file named": lines(f"{CAPTURE} paths_under", "calibration: []", "people: 1"),
    "other keys of frames": lines(f"{CAPTURE} frames_used 1", "frames: {last: 5}", "frames: {first: 0, count: 60}"),
    "one frame": lines(f"{CAPTURE} frames_used 2", "frames: {count: 1}", "frames: {count: 2}"),
    "a distance of nothing": lines(f"{CAPTURE} measured_lengths 1", "distance_m: 3.21", "distance_m: [01, 02, 3.21]"),
    "distance to itself": lines(f"{CAPTURE} measured_lengths 2", "distance_m: [01, 01, 3]", "distance_m: [01, 02, 3]"),
    "no offset": lines(f"{CAPTURE} _pixel_map", "pixel_maps: {01: {scale: 1}}",
                       "pixel_maps: {01: {scale: 0.99, offset: [0.0, 7.2]}}"),
    "three offsets": lines(f"{CAPTURE} _pixel_map", "pixel_maps: {01: {scale: 1, offset: [0, 0, 0]}}",
                           "pixel_maps: {01: {scale: 0.99, offset: [0.0, 7.2]}}"),
    "no such layout": lines("plan/discovery.py _layout", "keypoint_layout: coco-17", "keypoint_layout: coco17"),
    "no such calibration": ("plan/discovery.py _find_calibration", Folder("calibration: a.toml"),
                            Folder("calibration: a.toml", (*FILMS, "a.toml"))),
    "no such keypoints": ("plan/pairing.py files_by_camera 1", Folder("keypoints: here"),
                          Folder("keypoints: here", (*FILMS, "here/01.json"))),
    "keypoints of nobody": ("plan/pairing.py files_by_camera 2", Folder("keypoints: here", (*FILMS, "here/x.json")),
                            Folder("keypoints: here", (*FILMS, "here/no.json"))),
    "identities of nobody": (f"{FILES} file_size 2", Folder("identities: here.tsv"),
                             Folder("identities: here.tsv", (*FILMS, "here.tsv"))),
    "a folder for a table": (f"{FILES} file_size 1", Folder("identities: here", (*FILMS, "here/a.tsv")),
                             Folder("identities: here/a.tsv", (*FILMS, "here/a.tsv"))),
    "a link to nowhere": (f"{FILES} not_permitted 1", Folder(files=(*FILMS, "identities.tsv->gone")),
                          Folder(files=(*FILMS, "identities.tsv"))),
    "a device": (f"{FILES} file_size 3", Folder(files=(*FILMS, "identities.tsv->/dev/null")),
                 Folder(files=(*FILMS, "identities.tsv"))),
    "nobody to train on": lines("plan/discovery.py _chosen_footage 2", "held_out: [01, 02]", "held_out: [01]"),
    "a single film": ("plan/discovery.py _chosen_footage 2", Folder(files=FILMS[:1]), Folder(files=FILMS[:2])),
    "one film twice": ("plan/discovery.py _chosen_footage 1", Folder(files=(*FILMS, "videos/x.mp4->no.mp4")),
                       Folder("train: [01, 02, no]", (*FILMS, "videos/x.mp4->no.mp4"))),
    "one film in two cameras": ("plan/discovery.py _chosen_footage 1", Folder(files=(*FILMS, "videos/x.mp4->no.mp4")),
                                Folder(files=(*FILMS, "videos/x.mp4"))),
    "no films": ("plan/films.py find_recordings", Folder(files=("a/b/c.txt",)), Folder()),
    "a film in a cloud": ("plan/films.py _films", Folder(files=(*FILMS, "videos/.09.mp4.icloud")),
                          Folder(files=(*FILMS, "videos/09.mp4"))),
    "a cloud's film deleted": ("plan/films.py _films", Folder(files=(*FILMS, "videos/.09.mp4.icloud")), Folder()),
    "several films in folders": ("plan/films.py _film_per_folder", Folder(files=TWO_TAKES),
                                 Folder("chapters: {a: [videos/a/C1.MP4, videos/a/C2.MP4]}", TWO_TAKES)),
    "several films, one kept": ("plan/films.py _film_per_folder", Folder(files=TWO_TAKES), Folder(files=TWO_TAKES[1:])),
    "chapters of no film": lines("plan/discovery.py _opened 2", "chapters: {x: [videos/03.mp4]}",
                                 "chapters: {x: [videos/02.mp4]}"),
    "chapter of no film": lines("plan/films.py _recordings 1", "chapters: {x: [videos/02.mp4, videos/03.mp4]}",
                                "chapters: {x: [videos/02.mp4]}"),
    "chapter twice": lines("plan/films.py _recordings 2", "chapters: {x: [videos/02.mp4, videos/02.mp4]}",
                           "chapters: {x: [videos/02.mp4]}"),
    "two films of a name": ("plan/films.py _recordings 3", Folder(files=(*FILMS, "videos/01.mov")), Folder()),
    "a missing chapter": ("plan/films.py _joined", Folder(files=(*FILMS, GOPRO[0], GOPRO[2])),
                          Folder(files=(*FILMS, *GOPRO))),
    "a later chapter": ("plan/films.py _joined", Folder(files=(*FILMS, GOPRO[0], GOPRO[2])),
                        Folder(files=(*FILMS, GOPRO[0]))),
    "keypoints of some chapters": ("plan/keypoint_files.py keypoints_of_chapters",
                                   Folder(files=(*FILMS, *GOPRO, *KEYPOINTS[:2])),
                                   Folder(files=(*FILMS, *GOPRO, *KEYPOINTS))),
    "keypoints of all chapters": ("plan/keypoint_files.py keypoints_of_chapters",
                                  Folder(files=(*FILMS, *GOPRO, *KEYPOINTS[:2])),
                                  Folder(files=(*FILMS, *GOPRO, KEYPOINTS[0]))),
    "two calibrations": ("plan/discovery.py find_calibration", Folder(files=(*FILMS, "a.xcp", "b.xcp")),
                         Folder("calibration: a.xcp", (*FILMS, "a.xcp", "b.xcp"))),
    "two forms of a letter": ("plan/discovery.py _opened 1", Folder(files=(*FILMS, "videos/\u00fc.mp4",
                              "videos/u\u0308.mp4")), Folder(files=(*FILMS, "videos/\u00fc.mp4", "videos/u2.mp4"))),
    "a camera twice": lines(f"{CAPTURE} by_camera", "starts: {'no': 3, 'NO': 4}", "starts: {'no': 3}"),
    "two descriptions": (f"{CAPTURE} description_path", Folder("people: 1", (*FILMS, "capture.yml")),
                         Folder("people: 1")),
    "a camera called as a table": ("plan/discovery.py _opened 3", Folder(files=(*FILMS, "videos/manifest.mp4")),
                                   Folder(files=(*FILMS, "videos/front.mp4"))),
    "a name that repeats itself": ("scene/names.py check_name 2", Folder(files=(*FILMS, f"videos/{20 * 'ab'}.mp4")),
                                   Folder(files=(*FILMS, "videos/ab.mp4"))),
    "a name with two blanks": ("scene/names.py check_name 1", Folder(files=(*FILMS, "videos/a  b.mp4")),
                               Folder(files=(*FILMS, "videos/a b.mp4"))),
}  # fmt: skip


@pytest.mark.parametrize("row", ROWS)
def test_a_folder_changed_as_advised_is_opened(row: str, tmp_path: Path) -> None:
    place, brought, advised = ROWS[row]
    follow(place, lambda: brought.opened(tmp_path / "brought"), lambda: advised.opened(tmp_path / "advised"))


def made(folder: Path) -> Path:
    Folder().opened(folder)
    return folder


def touched(folder: Path, seconds: float) -> None:
    os.utime(made(folder) / FILMS[0], (seconds, seconds))
    dates.refuse_future(folder, folder, 2e9)


# The same for steps that take other arguments.
CALLS: dict[str, Callable[[Path], object]] = {
    "plan/discovery.py open_dataset": lambda f: open_dataset(f / "gone"),
    f"{CAPTURE} read_description 1": lambda f: open_dataset(made(f / "a"), f / "gone.yaml"),
    "scene/names.py check_path": lambda f: made(f / "a{b}"),
    "plan/dates.py refuse_future": lambda f: touched(f / "a", 3e9),
}
ADVISED: dict[str, Callable[[Path], object]] = {
    "plan/discovery.py open_dataset": lambda f: open_dataset(made(f / "there")),
    f"{CAPTURE} read_description 1": lambda f: open_dataset(made(f / "b"), None),
    "scene/names.py check_path": lambda f: made(f / "ab"),
    "plan/dates.py refuse_future": lambda f: touched(f / "b", 1e9),
}


@pytest.mark.parametrize("place", CALLS)
def test_a_folder_named_as_advised_is_opened(place: str, tmp_path: Path) -> None:
    follow(place, lambda: CALLS[place](tmp_path), lambda: ADVISED[place](tmp_path))


def test_the_command_that_a_closed_file_s_sentence_names_opens_it() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder, said = Path(name), list[str]()
        folder.chmod(0o755)
        for number, film in enumerate(FILMS):
            (folder / film).parent.mkdir(exist_ok=True)
            (folder / film).write_bytes(bytes(number + 1))
        closed = folder / FILMS[1]
        if os.geteuid() == 0:
            os.chown(closed, 65534, 65534)
        closed.chmod(0)

        def opened() -> None:
            with as_nobody():
                try:
                    open_dataset(folder)
                except UserError as refusal:
                    said.append(str(refusal))
                    raise

        def permitted() -> None:
            subprocess.run(shlex.split(said[0].rpartition("permit it: ")[2]), check=True)
            opened()

        follow(f"{FILES} not_permitted 2", opened, permitted)
