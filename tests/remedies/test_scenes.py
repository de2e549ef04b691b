# SPDX-License-Identifier: Apache-2.0
"""Sentences about a scene, its rooms, people and made films: done as they advise, the step ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import pytest
import studiorecon
from studiorecon.background.preparation import Photo, mask_people, read_photos
from studiorecon.background.refinement import Refinement, refinement_cameras
from studiorecon.body.model import BodyModel
from studiorecon.calibration.from_people import _read_sightings
from studiorecon.calibration.network import metres_per_unit
from studiorecon.calibration.room_pictures import read_room_pictures
from studiorecon.camera_files.calibration import read_lenses
from studiorecon.camera_files.colmap import write_model
from studiorecon.camera_files.colmap_models import posed_pictures
from studiorecon.clocks.offsets import open_films
from studiorecon.deliver import gltf
from studiorecon.depth.first import run as depth_of_first
from studiorecon.footage.exr import write_depth
from studiorecon.footage.source import open_source
from studiorecon.footage.video import write_lossless
from studiorecon.geometry.lens import rayless_share
from studiorecon.humans import train
from studiorecon.humans.photo import best_photo
from studiorecon.humans.stranger import run as cut_out
from studiorecon.images.flow import dis_flow
from studiorecon.images.plate import write_plate
from studiorecon.keypoints.motion import film_motion
from studiorecon.masks.user_masks import label_given_masks, read_given
from studiorecon.render.replacement import replace_people
from studiorecon.scene import user_files
from studiorecon.scene.capture import write_footage
from studiorecon.scene.clocks import Clocks
from studiorecon.scene.factors import NONE
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import write_people
from studiorecon.splatting.cpu import rasterise
from studiorecon.views.fitted import fit_picture
from studiorecon.window import people, runs

from tests.defaults import loaded
from tests.humans.test_stranger import NETWORKS
from tests.made.footage import calibrated, footage
from tests.made.remedies import follow_row
from tests.made.scene import avatar, ring, room
from tests.package.test_results import results
from tests.remedies.test_networks import given, plan
from tests.remedies.test_pictures import film, text

Call = Callable[[Path], Any]
ROOT = Path(__file__).resolve().parents[2]
CAMERAS = ring([0, 40], "cam")
WH = CAMERAS[0].wh
FLAT = np.full(CAMERAS[0].hw, 2.0, np.float32)
GREY = np.full((*CAMERAS[0].hw, 3), 90, np.uint8)
WHOLE, BROKEN = film(), text(b"no film" * 99)
BODY = BodyModel.load(ROOT / "resources/body.npz")
PERSON = avatar(BODY, np.random.default_rng(0), "p0")
FILES, MASKS, PREPARED = "scene/user_files.py", "masks/user_masks.py", "background/preparation.py"


def spoilt(damage: Callable[[Path], object], again: Callable[[Path], object], read: Callable[[Path], object]) -> Call:
    """A finished scene with a file damaged, and read after what was advised."""

    def call(folder: Path) -> None:
        made = results(folder / "x", ROOT, 1)
        damage(made)
        again(made)
        read(made)

    return call


def plates(rgb_known: bool) -> Call:
    def call(f: Path) -> None:
        write_plate(f / "plate.png", GREY, np.full(FLAT.shape, rgb_known))
        write_depth(f / "depth.exr", FLAT, FLAT / 2)
        read_photos(CAMERAS[:1], [f / "plate.png"], [f / "depth.exr"], NONE)

    return call


def first_frame(people_px: int) -> Call:
    def call(f: Path) -> None:
        mask = np.zeros(FLAT.shape, np.uint8)
        mask[:, :people_px] = 1
        write_lossless(f / "a.mkv", [GREY], 10.0)
        write_lossless(f / "m.mkv", [mask], 10.0)
        photo = Photo(CAMERAS[0], GREY / np.float32(255), mask > 0, FLAT, FLAT)
        mask_people([photo], [f / "a.mkv"], [f / "m.mkv"], 3, NONE)

    return call


def photos(*columns: int) -> Call:
    """The best photo of person 1 in a mask film whose person begins at these columns."""

    def call(f: Path) -> None:
        pictures = [np.zeros(FLAT.shape, np.uint8) for _ in columns]
        for picture, column in zip(pictures, columns):
            picture[20:60, column : column + 20] = 1
        write_lossless(f / "m.mkv", pictures, 10.0)
        best_photo([f / "m.mkv"], 1)

    return call


def stranger(*alpha: int) -> Call:
    """A photo of a wall, cut out where it has rows of alpha; without, as it is."""

    def call(f: Path) -> None:
        rows = np.repeat(np.array(alpha, np.uint8), len(GREY) // max(len(alpha), 1))
        picture = np.dstack([GREY, np.tile(rows[:, None], WH[0])]) if alpha else GREY
        cv2.imwrite(str(f / "a.png"), picture)
        cut_out("stranger_a", f / "a.png", DETECTOR, f / "cut.png")

    return call


def two_alike(f: Path) -> None:
    with patch("studiorecon.humans.stranger.DetectorFiles.detector") as found:
        found.return_value.detect_new_people.return_value = [patch_of(50), patch_of(45)]
        cv2.imwrite(str(f / "a.png"), GREY)
        cut_out("stranger_a", f / "a.png", DETECTOR, f / "cut.png")


def patch_of(side: float) -> Any:
    return type("Seen", (), {"region": type("Region", (), {"side": side})})


def user_masks(count: int, wh: tuple[int, int] = (64, 48), frames: int = 4) -> Call:
    def call(f: Path) -> None:
        write_footage(f / "a.json", replace(footage("a", frames, wh=(64, 48)), source_wh=(64, 48)))
        write_lossless(f / "m.mkv", [np.zeros(wh[::-1], np.uint8)] * count, 10.0)
        read_given(f / "m.mkv", f / "a.json", calibrated(f, (64, 48)), frames)

    return call


def labelled(column: int) -> Call:
    """A mask whose person begins at a column, of a scene with a body in columns 10 to 30."""
    mask, depth = (np.zeros(FLAT.shape, kind) for kind in (np.uint8, np.float32))
    mask[20:60, column : column + 20], depth[20:60, 10:30] = 1, 2.0
    return lambda _: label_given_masks([mask], [depth[None]], 1, 0.2, CAMERAS[0])


def person_trained(**temporal: Any) -> Call:
    def call(f: Path) -> None:
        write_people(f / "people.tsv", [("p0", 6, "cam0", 1.0, "keypoints")])
        usual = loaded(train.Settings)
        dense, moving = replace(usual.densify, use="gradient"), replace(usual.temporal, **temporal)
        train._person_index(replace(usual, densify=dense, temporal=moving), "p0", f / "people.tsv")

    return call


def first_depth(value: float, zoom: float = 1.0) -> Call:
    def call(f: Path) -> None:
        write_model(f / "model", CAMERAS)
        lens = np.diag([zoom, zoom, 1.0])
        write_model(f / "network", [replace(c, intrinsics=c.intrinsics * (lens + (lens == 0))) for c in CAMERAS])
        write_depth(f / "first.exr", value * FLAT, FLAT / 2)
        depth_of_first("cam0", f / "model/images.txt", f / "first.exr", f / "network/images.txt", f / "out.exr")

    return call


def drawn(most: int) -> Call:
    def call(_: Path) -> None:
        with patch.object(rasterise, "PAIRS_MAX", most):
            rasterise.Rasteriser(near_m=0.1).forward(room(np.random.default_rng(0), 0.4), CAMERAS[0], np.zeros(3))

    return call


def document(kilobytes: int) -> Call:
    def call(f: Path) -> None:
        buffer = gltf.Buffer()
        buffer.data += bytes(1024 * kilobytes)
        with patch.object(gltf, "_MAX_BYTES", 4096):
            gltf.write_document(f / "a.glb", {}, buffer)

    return call


def within(call: Call) -> Call:
    def there(f: Path) -> None:
        before = Path.cwd()
        os.chdir(f)
        try:
            call(f)
        finally:
            os.chdir(before)

    return there


def camera_films(made: bool) -> Call:
    def call(f: Path) -> None:
        if made:
            results(f / "results/x", ROOT, 0)
            write_lossless(f / "results/x/capture/cam0.mkv", [GREY] * 3, 10.0)
        people.camera_film("x", "cam0")

    return within(call)


def second_run(wait: bool) -> Call:
    def call(_: Path) -> None:
        try:
            runs.start_run("takes", "", [sys.executable, "-c", f"import time; time.sleep({0.01 if wait else 3})"])
            while wait and runs.current_run():
                runs.time.sleep(0.01)
            runs.start_run("takes", "", [sys.executable, "-c", ""])
        finally:
            runs.stop_run()

    return within(call)


def arrays(kilobytes: int, read: Callable[..., Any]) -> Call:
    def call(f: Path) -> None:
        held = np.zeros((kilobytes, 1024), np.uint8)
        np.savez(f / "a.npz", a=held) if read is user_files.read_npz else np.save(f / "a.npy", held)
        with patch.object(user_files, "MAX_ARRAY_BYTES", 4096):
            user_files.read_npz(f / "a.npz", 4096) if read is user_files.read_npz else read(f / "a.npy")

    return call


def filmed(write: Callable[[Path], object]) -> Call:
    """What a film of one camera shows of the room and of motion."""

    def call(f: Path) -> None:
        WHOLE(f / "a.mp4")
        source = open_source(f / "a.mp4", 30.0)
        write(f / "a.mp4")
        film_motion(source, 0, 5)
        read_room_pictures(["a"], [f / "a.mp4"], {"a": (64, 48)})

    return call


def colmap(f: Path) -> None:
    write_model(f, CAMERAS)
    posed_pictures([f / "cameras.txt", f / "images.txt"])


def out_of_memory(_: Path) -> None:
    with user_files.user_file_context("a.pkl", "a calibration"):
        raise MemoryError


def replaced(path: str, content: bytes) -> Callable[[Path], object]:
    return lambda made: (made / path).write_bytes(content)


def halved(path: str) -> Callable[[Path], object]:
    return lambda made: (made / path).write_bytes((made / path).read_bytes()[: (made / path).stat().st_size // 2])


def remade(path: str) -> Callable[[Path], object]:
    """The file deleted, and the step that made it run again."""

    def again(made: Path) -> None:
        (made / path).unlink()
        results(made, ROOT, 1)

    return again


def nothing(_: Path) -> None:
    pass


def loads(made: Path) -> None:
    studiorecon.load(made)


def again(damage: Callable[[Path], object], path: str) -> tuple[Call, Call]:
    return spoilt(damage, nothing, loads), spoilt(damage, remade(path), loads)


def wrong_value(made: Path) -> None:
    values = read_json(made / "capture/manifest.json")
    write_json(made / "capture/manifest.json", values | {"fps": -1.0})


def fitted(side: int) -> Call:
    picture = np.full((side * 9 // 16, side, 3), 90, np.uint8)
    return lambda _: fit_picture(picture, CAMERAS[0], [(36, 64)], 1)


def flow(side: int) -> Call:
    return lambda _: dis_flow(*np.zeros((2, side, side), np.uint8), "medium")


def lens_of(centre_px: float, k1: float = 0.5) -> Call:
    def call(f: Path) -> None:
        own = next(iter(read_lenses(calibrated(f, (64, 48), 0.0)).values()))
        away = own.intrinsics + np.array([[0, 0, centre_px], [0, 0, 0], [0, 0, 0]])
        rayless_share(replace(own, intrinsics=away, distortion=np.array([k1, 0, 0, 0, 0])), (64, 48))

    return call


def bodies(*names: str) -> Call:
    return lambda _: replace_people([PERSON], dict.fromkeys(names, "nobody"), "mine")


def films(*write: Callable[[Path], object]) -> Call:
    def call(f: Path) -> None:
        for number, one in enumerate(write):
            one(f / f"{number}.mp4")
        open_films([f / f"{number}.mp4" for number in range(len(write))], 30.0)

    return call


def of_body(identity: str) -> Call:
    return lambda _: BODY.require_same(identity, "p0")


DETECTOR = [ROOT / "resources/detector" / name for name in NETWORKS]
# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
ROWS: list[tuple[Any, ...]] = [
    ("scene/step_files.py step_file_context", *again(wrong_value, "capture/manifest.json")),
    ("scene/gaussians_ply.py read_ply", *again(halved("background/scene.ply"), "background/scene.ply")),
    ("results.py _people", *again(lambda made: (made / "humans/p0.npz").unlink(), "humans/p0.ply")),
    ("body/model.py BodyModel.require_same", of_body("another"), of_body(BODY.identity)),
    ("depth/first.py run", first_depth(0.0), first_depth(1.0), plan(depth={"reference": "planes"})),
    ("rig/first_depth.py first_moment", first_depth(1.0, 1.3), first_depth(1.0), plan(depth={"reference": "planes"})),
    ("calibration/from_people.py _read_sightings",
     lambda _: _read_sightings([], {}, Clocks(30.0, 0.0, 9, ()), ["a"]), plan(calibration={"source": "files"})),
    ("views/fitted.py fit_picture", fitted(80), fitted(64)),
    ("window/people.py camera_film", camera_films(False), camera_films(True)),
    ("window/runs.py start_run", second_run(wait=False), second_run(wait=True)),
    ("clocks/offsets.py open_films 2", films(BROKEN, BROKEN), films(WHOLE, WHOLE)),
    ("deliver/gltf.py write_document", document(8), document(1)),
    ("images/flow.py dis_flow 2", flow(4), flow(64)),
    (f"{FILES} read_bytes", lambda f: (text(b"12345")(f / "a"), user_files.read_bytes(f / "a", 4)),
     lambda f: (text(b"1234")(f / "a"), user_files.read_bytes(f / "a", 4))),
    (f"{FILES} read_npz 2", arrays(9, user_files.read_npz), arrays(1, user_files.read_npz)),
    (f"{FILES} read_npy", arrays(9, user_files.read_npy), arrays(1, user_files.read_npy)),
    (f"{FILES} user_file_context 3", out_of_memory, nothing),
    ("keypoints/motion.py film_motion", filmed(BROKEN), filmed(WHOLE)),
    ("calibration/room_pictures.py read_room_pictures", filmed(BROKEN), filmed(WHOLE)),
    ("camera_files/colmap_models.py _read 1", given(colmap, pycolmap=None), colmap),
    (f"{PREPARED} mask_people", first_frame(WH[0]), plan(background={"room_targets": "plates"}), first_frame(20)),
    (f"{PREPARED} read_photos", plates(False), plates(True)),
    ("background/refinement.py refinement_cameras",
     lambda _: refinement_cameras(CAMERAS, CAMERAS[:1], loaded(Refinement)),
     lambda _: refinement_cameras(CAMERAS, CAMERAS, loaded(Refinement)),
     plan(survey={"force": {"view_synthesis": "on"}}), plan(background={"refinement": {"views": 0}})),
    ("calibration/network.py metres_per_unit 1", lambda _: metres_per_unit(np.zeros(0), 0.5, False, "Pi3"),
     lambda _: metres_per_unit(np.ones(3), 0.5, False, "Pi3"), lambda _: metres_per_unit(np.zeros(0), 0.5, True, "Pi3"),
     plan(calibration={"source": "pi3x"}, licences="any")),
    ("calibration/network.py metres_per_unit 2", lambda _: metres_per_unit(np.array([1.0, 9.0]), 0.5, False, "Pi3"),
     plan(calibration={"source": "files"})),
    ("geometry/lens.py rayless_share 1", lens_of(5000.0), lens_of(0.0)),
    ("geometry/lens.py rayless_share 2", lens_of(0.0, 50.0), lens_of(0.0)),
    ("humans/photo.py best_photo", photos(0), photos(40)),
    ("humans/stranger.py run 1", stranger(0, 0), stranger(0, 255)),
    ("humans/stranger.py run 2", stranger(), stranger(0, 255)),
    ("humans/stranger.py run 3", two_alike, stranger(0, 255)),
    ("humans/train.py _person_index 1", person_trained(use="always", points=8), person_trained(use="always", points=0),
     person_trained(use="never", points=8)),
    (f"{MASKS} read_given", user_masks(3), user_masks(4)),
    (f"{MASKS} _source_pixels", user_masks(4, (64, 64)), user_masks(4, (128, 96))),
    (f"{MASKS} label_given_masks", labelled(60), labelled(10)),
    ("render/replacement.py replace_people", bodies("p7"), bodies("p0")),
    ("splatting/cpu/rasterise.py Rasteriser.draw", drawn(10), drawn(10**6)),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {row[0]}" for n, row in enumerate(ROWS)])
def test_a_scene_made_as_advised_is_finished(row: int, tmp_path: Path) -> None:
    follow_row(ROWS[row], tmp_path)
