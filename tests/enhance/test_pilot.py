# SPDX-License-Identifier: Apache-2.0
"""Whether a film calls for enhancement and injection: told before it is made, on what training cameras show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.configuration import settings as settings_module
from studiorecon.enhance import shot as enhance_shot
from studiorecon.enhance.photos import Training
from studiorecon.enhance.trial import decide_injection, flicker_increase, transfer_strength
from studiorecon.footage.video import read_stack, write_lossless
from studiorecon.geometry.statistics import NOTHING
from studiorecon.images.transfer import Transfer
from studiorecon.models.protocols import Moment
from studiorecon.render import shot as render_shot
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.path import PathStep

from tests.made.enhance_limits import SEARCH
from tests.made.scene import enhance_options, render_options, ring, write_scene
from tests.made.steps import call

HW = (48, 64)
TRANSFER = Transfer(feather_px=0.0, smooth_px=0.0)


class Frames:
    def __init__(self, pictures: Sequence[np.ndarray]) -> None:
        self.pictures = pictures

    def at(self, index: int) -> np.ndarray:
        return self.pictures[index]


def side_by_side(count: int) -> list[Camera]:
    """Cameras that look the same way from one place: each sees what the others see."""
    return [replace(ring([0], "cam")[0], name=f"cam{k}", wh=(HW[1], HW[0])) for k in range(count)]


def training(missing: Sequence[np.ndarray], shared: bool = True) -> Training:
    """Cameras whose renders, mid grey, miss so many levels (H, W, 3) of the photos, two frames alike."""
    render = np.full((*HW, 3), 120, np.uint8)
    photos = [Frames([np.clip(render + one, 0, 255).astype(np.uint8)] * 2) for one in missing]
    depth = np.full(HW, 3000 if shared else 0, np.uint16)
    count = len(missing)
    return Training(side_by_side(count), photos, [Frames([render] * 2)] * count, [Frames([depth] * 2)] * count, 2)


def test_what_all_photos_show_and_renders_miss_is_worth_adding() -> None:
    pattern = 20 * np.sign(np.sin(np.arange(HW[1]) / 4))[None, :, None].repeat(HW[0], 0).repeat(3, 2)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        strength, decision = transfer_strength(
            training([pattern + rng.normal(0, 4, pattern.shape) for _ in range(4)]), 2, TRANSFER, 0.1
        )
        assert decision.verdict == "on"
        assert strength > 0.8
        assert decision.value == pytest.approx(10 * np.log10(416 / 21.3), abs=1.0), (
            "what is left is noise, and a third more"
        )


def test_noise_of_every_photo_of_its_own_is_not() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        _, decision = transfer_strength(training([rng.normal(0, 12, (*HW, 3)) for _ in range(4)]), 2, TRANSFER, 0.1)
        assert decision.verdict == "off", decision.reason


def test_cameras_that_share_nothing_cannot_tell() -> None:
    strength, decision = transfer_strength(training([np.full((*HW, 3), 20)] * 3, shared=False), 2, TRANSFER, 0.1)
    assert (strength, decision.verdict) == (0.0, "undetermined")
    assert "seen by a second training camera" in decision.reason


class Noisy:
    """An enhancer that draws anew in every picture, as networks do."""

    def __init__(self, levels: float) -> None:
        self.levels, self.rng = levels, np.random.default_rng(0)

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
        return image + self.rng.normal(0, self.levels / 255, image.shape).astype(np.float32)


def film(folder: Path, count: int, film_noise: float) -> tuple[list[PathStep], Path, Path]:
    """A still view of a textured wall as a film and its depth."""
    rng = np.random.default_rng(1)
    wall = np.kron(rng.uniform(60, 190, (HW[0] // 4, HW[1] // 4, 3)), np.ones((4, 4, 1)))
    pictures = [np.clip(wall + rng.normal(0, film_noise, wall.shape), 0, 255).astype(np.uint8) for _ in range(count)]
    write_lossless(folder / "film.mkv", pictures, 30.0)
    write_lossless(folder / "depth.mkv", [np.full(HW, 3000, np.uint16)] * count, 30.0)
    (camera,) = side_by_side(1)
    return [PathStep(camera, float(t), "c") for t in range(count)], folder / "film.mkv", folder / "depth.mkv"


@pytest.mark.parametrize(("levels", "film_noise", "verdict"), [(4.0, 0.0, "on"), (0.0, 0.0, "off"), (0.5, 6.0, "off")])
def test_flicker_that_enhancement_adds_differs_from_what_was_there(
    tmp_path: Path, levels: float, film_noise: float, verdict: str
) -> None:
    steps, render, depth = film(tmp_path, 12, film_noise)
    change = flicker_increase(steps, render, depth, lambda _: np.zeros((*HW, 3), np.uint8), Noisy(levels), SEARCH)
    assert decide_injection(change, 0.2).verdict == verdict


def test_a_film_of_two_pictures_says_nothing(tmp_path: Path) -> None:
    steps, render, depth = film(tmp_path, 2, 0.0)
    change = flicker_increase(steps, render, depth, lambda _: np.zeros((*HW, 3), np.uint8), Noisy(9.0), SEARCH)
    assert change is NOTHING
    assert decide_injection(change, 0.2).verdict == "undetermined"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, root: Path, default_settings: Callable) -> Path:
    """Footage of a scene with renders that are right, and renders that are too dark everywhere (``dark``)."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root, people=0)
    section = default_settings("render") | {"shots": {"heldout": {"kind": "heldout"}}}
    settings = settings_module.load(render_shot.Settings, section, "render")
    right = read_ply(folder / "background/scene.ply")
    for name, missing in (("dark", 0.1), ("right", 0.0)):
        write_ply(folder / "background/scene.ply", replace(right, sh=right.sh - np.float32(missing / 0.28209479)))
        for shot in ("train", "heldout"):
            call(render_shot.run, settings, **render_options(folder, shot, people=0))
        (folder / "render").rename(folder / name)
    return folder


def shot_of(scene: Path, which: str) -> dict:
    """The options of ``enhance.shot`` on one of the two sets of renders."""
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))
    options["train"] = [scene / which / path.name for path in options["train"]]
    return {
        key: scene / which / value.name if isinstance(value, Path) and value.parent.name == "render" else value
        for key, value in options.items()
    }


@pytest.mark.parametrize(("which", "verdict"), [("dark", "on"), ("right", "off")])
def test_a_film_is_enhanced_where_photos_show_more(
    scene: Path, default_settings: Callable, which: str, verdict: str
) -> None:
    section = default_settings("survey") | default_settings("enhance")
    settings, options = settings_module.load(enhance_shot.Settings, section, "enhance"), shot_of(scene, which)
    call(enhance_shot.run, settings, **options)
    made = read_decisions(options["decisions"])
    assert made["enhancement"].verdict == verdict, made["enhancement"].reason
    assert made["injection"].verdict == "off", made["injection"].reason
    render, film_ = read_stack(options["render"]).astype(int), read_stack(options["video"]).astype(int)
    assert (np.abs(film_ - render).max() > 10) == (verdict == "on")
    # Overruled beforehand; where photos show nothing more, only a strength of the user's own adds anything.
    other = "off" if verdict == "on" else "on"
    overruled = replace(settings, force={"enhancement": other, "injection": "on"}, strength=0.5)
    call(enhance_shot.run, overruled, **options)
    made = read_decisions(options["decisions"])
    assert [(made[e].verdict, made[e].forced) for e in ("enhancement", "injection")] == [(other, True), ("on", True)]


def test_what_is_forced_on_and_adds_nothing_is_off_and_says_so(
    scene: Path, default_settings: Callable, capsys: pytest.CaptureFixture[str]
) -> None:
    """The verdict is what was done: renders that stay as they are were not enhanced."""
    section = default_settings("survey") | default_settings("enhance")
    settings, options = settings_module.load(enhance_shot.Settings, section, "enhance"), shot_of(scene, "dark")
    for changes in ({"enhancer": "none"}, {"strength": 0.0}):
        call(enhance_shot.run, replace(settings, force={"enhancement": "on"}, **changes), **options)
        made = read_decisions(options["decisions"])["enhancement"]
        assert (made.verdict, made.forced) == ("off", True)
        assert "nothing to add" in made.reason
        assert "enhancement is forced on" in capsys.readouterr().out
        assert (read_stack(options["render"]) == read_stack(options["video"])).all()
