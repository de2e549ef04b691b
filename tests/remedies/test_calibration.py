# SPDX-License-Identifier: Apache-2.0
"""What a refused calibration's sentence says helps: whoever does it has the cameras."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from studiorecon.calibration.choose import choose_lenses
from studiorecon.calibration.files import Settings, read_calibration
from studiorecon.geometry.triangulation import Limits
from studiorecon.keypoints.detections import to_pinhole
from studiorecon.rig.correspondences import make_observations
from studiorecon.rig.human_size import check_human_size
from studiorecon.rig.starts import calibration_starts, compare
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Detections

from tests.defaults import loaded
from tests.made.cameras import detect, look_at, walk
from tests.made.remedies import follow

WH = (1280, 704)
NAMES = ("a", "b", "c", "d")
PLACES = ((4.0, 0.0, 1.5), (0.5, 4.2, 2.0), (-3.5, -1.0, 1.2), (0.0, -4.0, 1.8))
FRAMES = 24
RIG = [look_at(n, np.array(p), [0, 0, 1], WH) for n, p in zip(NAMES, PLACES)]
PEOPLE = [walk([-0.6, -0.5, 0], [0.03, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.03, 0], FRAMES, 2.0)]
SEEN = detect(RIG, PEOPLE, 1.0, np.random.default_rng(0))
LIMITS = Limits(outlier_units=9.0)


def table(camera: Camera, **changed: Any) -> dict[str, Any]:
    """A camera as Pose2Sim's file has it: pixels' centres at 0."""
    matrix = camera.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    pose = camera.camera_from_world
    rotation = cv2.Rodrigues(pose[:3, :3])[0].ravel()
    about = {"name": camera.name, "size": list(WH), "matrix": matrix.tolist(), "distortions": [0.0] * 4}
    return {**about, "rotation": rotation.tolist(), "translation": pose[:3, 3].tolist(), **changed}


@dataclass(frozen=True)
class Capture:
    """What the user brings: the first camera's entries in the file that differ, those of all, and the rest."""

    first: dict[str, Any] = field(default_factory=dict)
    all: dict[str, Any] = field(default_factory=dict)
    cameras: tuple[Camera, ...] = tuple(RIG)
    films: tuple[str, ...] = NAMES
    wh: tuple[int, int] = WH
    pixel_maps: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    people: bool = True

    def lenses(self, folder: Path) -> list[Any]:
        tables = [table(c, **{**self.all, **(self.first if not i else {})}) for i, c in enumerate(self.cameras)]
        lines = []
        for i, entries in enumerate(tables):
            lines += [f"[cam{i}]", *(f"{k} = {written(v)}" for k, v in entries.items() if v is not None)]
        file = folder / "calib.toml"
        file.write_text("\n".join(lines))
        settings = replace(loaded(Settings), **self.settings)
        found = read_calibration([file], settings.format)
        seen = [self.detected(film) for film in self.films]
        return choose_lenses(
            found, file.name, self.films, [self.wh] * len(seen), seen, self.pixel_maps, settings
        ).lenses

    def detected(self, film: str) -> Detections:
        one = SEEN[NAMES.index(film)] if film in NAMES else SEEN[0]
        return replace(one if self.people else one.only(np.zeros(len(one.frame), bool)), camera=film)

    def scored(self, folder: Path) -> None:
        """Raises UserError for people of another size, or with the setting that fits them."""
        lenses = self.lenses(folder)
        both = [to_pinhole(self.detected(lens.name), lens, self.wh) for lens in lenses]
        cameras, seen = [c for c, _ in both], [d for _, d in both]
        compare(calibration_starts(cameras, seen), np.arange(FRAMES), 0.25).refuse_others(np.arange(FRAMES), 0.25)
        assert (
            check_human_size(cameras, make_observations(seen, cameras, np.arange(FRAMES), 0.25)[0], LIMITS) is not None
        )


def written(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)


def moved(factor: float, far: tuple[str, ...] = NAMES) -> tuple[Camera, ...]:
    """The rig with lengths of some cameras multiplied."""
    longer = np.ones((4, 4))
    longer[:3, 3] = factor
    return tuple(replace(c, camera_from_world=c.camera_from_world * longer) if c.name in far else c for c in RIG)


def turned(camera: Camera, number: int) -> Camera:
    """The camera, every other one turned by half a turn about its axis."""
    roll = np.diag([-1.0, -1, 1, 1] if number % 2 else np.ones(4))
    return replace(camera, camera_from_world=roll @ camera.camera_from_world)


INVERSE = tuple(replace(c, camera_from_world=np.linalg.inv(c.camera_from_world)) for c in RIG)
OPENGL = tuple(replace(c, camera_from_world=np.diag([1.0, -1, -1, 1]) @ c.camera_from_world) for c in RIG)
OTHER = (1280, 960)
MATRIX = np.array(table(RIG[0])["matrix"])
RAW, LENSES = "camera_files/raw_camera.py", "camera_files/lens_kinds.py"
UPSIDE_DOWN = tuple(turned(c, i) for i, c in enumerate(RIG))
SIDEWAYS = {"settings": {"up": "z"}}

# What is brought, where it is said, and the same once that was done.
ROWS = {
    "scale": (Capture(cameras=moved(0.2)), "rig/human_size.py size_refusal", {"settings": {"scale": 5.0}}),
    "unit cm": (Capture(cameras=moved(100.0), settings={"unit": "mm"}), "rig/human_size.py size_refusal",
        {"settings": {"unit": "cm"}}),
    "unit mm": (Capture(cameras=moved(1000.0), settings={"unit": "m"}), "rig/human_size.py size_refusal",
        {"settings": {"unit": "mm"}}),
    "poses": (Capture(cameras=INVERSE, **SIDEWAYS), "rig/starts.py Comparison.refuse_others",
        {"settings": {"poses": "world_from_camera", "up": "z"}}),
    "axes": (Capture(cameras=OPENGL, **SIDEWAYS), "rig/starts.py Comparison.refuse_others",
        {"settings": {"poses": "opengl", "up": "z"}}),
    "pixel_maps": (Capture(all={"size": list(OTHER)}), "geometry/lens.py calibration_from_video_pixels",
        {"pixel_maps": dict.fromkeys(NAMES, (1.0, 0.0, 0.0))}),
    "rename": (Capture(films=("w", "x", "y", "z"), people=False), "calibration/names.py mismatch_error 2",
        {"films": NAMES, "people": True}),
    "one more film": (Capture(cameras=tuple(RIG[:3])), "calibration/names.py mismatch_error 1",
        {"films": ("a", "b", "c")}),
    "radial": (Capture(settings={"radial": {"cam1": 0.01}}), "calibration/files.py paired_lenses",
        {"settings": {"radial": {"a": 0.001}}}),
    "far": (Capture(cameras=moved(1000.0, ("d",))), "calibration/world.py refuse_wrong_places 2",
        {"films": ("a", "b", "c")}),
    "a copied pose": (Capture(cameras=(*RIG[:3], replace(RIG[2], name="d"))),
        "calibration/world.py refuse_wrong_places 1",
                      {"films": ("a", "b", "c")}),
    "a missing pose": (Capture(cameras=(*RIG[:3], replace(RIG[2], name="d"))),
        "calibration/world.py refuse_wrong_places 1",
                       {"cameras": tuple(RIG)}),
    "upside down": (Capture(cameras=UPSIDE_DOWN), "calibration/world.py camera_up",
                    {"settings": {"up": "z"}}),
    "wrong maps": (Capture(pixel_maps={"a": (1.0, 5000.0, 0.0)}), "geometry/lens.py _check_overlap",
        {"pixel_maps": {}}),
    "format": (Capture(settings={"format": "qualisys"}), "scene/user_files.py read_xml 2",
        {"settings": {"format": "auto"}}),
    **{place: (Capture(first=broken), place, {"first": done}) for place, broken, done in (
        ("calibration/formats/pose2sim.py camera_of_table", {"rotation": None}, {}),
        (f"{RAW} raw_camera 1", {"size": [1280]}, {}),
        (f"{LENSES} lens_model 1", {"fisheye": "perhaps"}, {"fisheye": False}),
        (f"{LENSES} lens_model 2", {"fisheye": True, "model": "opencv"}, {"model": "opencv"}),
        (f"{LENSES} canonical_lens_model", {"model": "omni"}, {"model": "OPENCV"}),
        (f"{LENSES} canonical_lens_model ", {"model": "omni"}, {"model": "OPENCV_FISHEYE"}),
        (f"{LENSES} coefficients 1", {"distortions": [0.0] * 8 + [0.1] * 4}, {"distortions": [0.0] * 12}),
        (f"{LENSES} coefficients 2", {"distortions": [0.0] * 6}, {"distortions": [0.0] * 5}),
        (f"{RAW} check_camera 1", {"size": [-1280, 704]}, {}),
        (f"{RAW} check_camera 2", {"matrix": [[4.2, 0, 640], [0, 4.2, 352], [0, 0, 1]]}, {}),
        (f"{RAW} check_camera 3", {"matrix": [[900, 0, 9640], [0, 900, 352], [0, 0, 1]]}, {}),
        (f"{RAW} check_camera 4", {"distortions": [1e9, 0.0, 0.0, 0.0]}, {}),
        (f"{RAW} check_camera 5", {"translation": [1e30, 0.0, 0.0]}, {}),
        (f"{RAW} _pinhole 1", {"matrix": [[-900, 0, 640], [0, 900, 352], [0, 0, 1]]}, {}),
        (f"{RAW} _pinhole 2", {"matrix": MATRIX.T.tolist()}, {}),
        (f"{RAW} _pinhole 3", {"matrix": [[900, 300, 640], [0, 900, 352], [0, 0, 1]]}, {}),
        (f"{RAW} raw_camera 2", {"matrix": [900.0, 640.0, 352.0]}, {}),
        (f"{RAW} rigid_camera_from_world 1", {"translation": [1.0, 2.0]}, {}),
        (f"{RAW} rigid_camera_from_world 1 ", {"rotation": [1.0, 2.0]}, {}),
        (f"{RAW} rigid_camera_from_world 2", {"rotation": [90.0, 0.0, 0.0]}, {}),
        (f"{RAW} rigid_camera_from_world 3", {"rotation": np.zeros((3, 3)).tolist()}, {}),
        (f"{RAW} rigid_camera_from_world 4", {"rotation": np.diag([1.0, 1, -1]).tolist()}, {}),
        (f"{RAW} rigid_camera_from_world 5", {"rotation": np.diag([1.0, 2, 1]).tolist()}, {}),
        ("scene/user_values.py numbers 2", {"translation": ["a", "b", "c"]}, {}),
        ("scene/user_values.py numbers 3", {"translation": [float("nan"), 0.0, 0.0]}, {}),
    )},
}  # fmt: skip


@pytest.mark.parametrize("row", ROWS)
def test_who_does_what_the_sentence_says_has_the_cameras(row: str, tmp_path: Path) -> None:
    broken, place, done = ROWS[row]
    place = place.strip()
    mended = replace(broken, **done)
    follow(place, lambda: broken.scored(tmp_path), lambda: mended.scored(tmp_path))
    lenses = mended.lenses(tmp_path)
    centres = np.array([-lens.camera_from_world[:3, :3].T @ lens.camera_from_world[:3, 3] for lens in lenses])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    truth = np.array(PLACES[: len(lenses)])
    np.testing.assert_allclose(apart, np.linalg.norm(truth[:, None] - truth[None], axis=-1), atol=1e-6)


@pytest.mark.parametrize("per_metre", [1.0, 100.0, 1000.0])
def test_a_file_without_unit_is_read_in_the_one_that_makes_people_human(per_metre: float, tmp_path: Path) -> None:
    brought = Capture(cameras=moved(per_metre))
    brought.scored(tmp_path)
    centres = [
        -np.linalg.inv(lens.camera_from_world[:3, :3]) @ lens.camera_from_world[:3, 3]
        for lens in brought.lenses(tmp_path)
    ]
    assert np.linalg.norm(centres[1] - centres[0]) == pytest.approx(np.linalg.norm(np.subtract(PLACES[1], PLACES[0])))
