# SPDX-License-Identifier: Apache-2.0
"""enhance: the residual transfer, the recursion around it, and the files a shot leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.configuration import settings as settings_module
from studiorecon.enhance import shot as enhance_shot
from studiorecon.enhance.backends import ResidualTransfer, Unchanged
from studiorecon.enhance.photos import Training
from studiorecon.errors import UserError
from studiorecon.footage.video import Playback, read_frame, read_frames_from, read_stack, write_lossless
from studiorecon.images.metrics import psnr
from studiorecon.images.transfer import ResidualSource, Transfer, best_strength, residual_source, transfer_residual
from studiorecon.images.warp import sample
from studiorecon.models.protocols import Moment
from studiorecon.recursive.sequence import adapt_injection, enhance_sequence, loop_gain
from studiorecon.render import shot as render_shot
from studiorecon.scene.camera import Camera
from studiorecon.scene.decisions import read_decisions
from studiorecon.scene.factors import Factors, write_factors
from studiorecon.scene.gaussians_ply import read_ply, write_ply
from studiorecon.scene.path import PathStep, read_path

from tests.made.enhance_limits import PAPER, SEARCH
from tests.made.scene import FRAMES, GAINS, enhance_options, refilmed, render_options, ring, write_scene
from tests.made.steps import call

TRANSFER = Transfer(depth_tolerance=0.03, angle_power=4.0, feather_px=4.0, smooth_px=0.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory, root: Path, default_settings: Callable) -> Path:
    """Footage of a scene, and shots of a background whose colours are 10 % too dark: the residual is the same
    everywhere."""
    folder = tmp_path_factory.mktemp("scene")
    write_scene(folder, root, people=0)
    right = read_ply(folder / "background/scene.ply")
    write_ply(folder / "background/scene.ply", replace(right, sh=right.sh - np.float32(0.1 / 0.28209479)))
    section = default_settings("render")
    section["shots"] = {"heldout": {"kind": "heldout"}}
    settings = settings_module.load(render_shot.Settings, section, "render")
    for shot in ("train", "heldout"):
        call(render_shot.run, settings, **render_options(folder, shot, people=0))
    return folder


@pytest.fixture
def settings(default_settings: Callable) -> enhance_shot.Settings:
    return settings_module.load(enhance_shot.Settings, default_settings("enhance"), "enhance")


def score(folder: Path, video: Path) -> float:
    steps, _ = read_path(folder / "render/heldout.json")
    pairs = zip(steps, read_stack(video))
    return float(
        np.mean(
            [psnr(picture, read_frame(folder / f"capture/{s.camera.name}.mkv", int(s.frame))) for s, picture in pairs]
        )
    )


def test_residual_transfer_repairs_what_every_training_camera_sees_wrong(
    scene: Path, settings: enhance_shot.Settings
) -> None:
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))
    call(enhance_shot.run, replace(settings, strength=1.0), **options)
    raw, enhanced = score(scene, scene / "render/heldout.mkv"), score(scene, options["video"])
    assert enhanced > raw + 1.0
    assert read_path(scene / "render/heldout.json")[0][0].segment == "view0"
    assert len(read_stack(options["video"])) == 2 * FRAMES
    assert options["film"].read_bytes()[4:8] == b"ftyp"


def test_a_film_that_was_made_elsewhere_stands_as_it_is(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path
) -> None:
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))
    theirs = 255 - read_stack(options["render"])
    write_lossless(tmp_path / "heldout.mkv", theirs, 24.0)
    call(enhance_shot.run, replace(settings, enhancer="precomputed"), **options, made=[tmp_path / "heldout.mkv"])
    np.testing.assert_array_equal(read_stack(options["video"]), theirs)
    assert options["film"].read_bytes()[4:8] == b"ftyp"


def test_segments_made_beside_one_another_are_the_bytes_of_one_job(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path
) -> None:
    force = {"enhancement": "on", "injection": "on"}
    loose = replace(settings.injection, error_threshold=255.0, moving_strength=0.3, history=3)
    settings = replace(settings, force=force, strength=0.5, injection=loose)
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))

    def made(name: str, **more: object) -> dict[str, Path]:
        files = {"video": tmp_path / f"{name}.mkv", "film": tmp_path / f"{name}.mp4"}
        files["decisions"] = tmp_path / f"{name}.json"
        call(enhance_shot.run, settings, **{**options, **files, **more})
        return files

    whole = made("whole")
    assert (read_stack(whole["video"]) != read_stack(options["render"])).any()
    names = list(dict.fromkeys(step.segment for step in read_path(scene / "render/heldout.json")[0]))
    segments = [made(name, only=[name]) for name in names]
    assert [len(read_stack(files["video"])) for files in segments] == [FRAMES, FRAMES]
    before = {"made": [files["video"] for files in segments], "decided_before": [segments[0]["decisions"]]}
    joined = made("joined", **before)
    for kind, file in whole.items():
        assert file.read_bytes() == joined[kind].read_bytes(), kind


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda film: film[:-1], r"heldout\.mkv .*it has \d+ pictures and .*heldout\.mkv \d+"),
        (lambda film: np.concatenate([film, film[:1]]), r"it has \d+ pictures and .*heldout\.mkv \d+"),
        (lambda film: film[:, :, :-2], r"it has another size than .*heldout\.mkv"),
    ],
    ids=["short", "long", "narrow"],
)
def test_a_film_of_another_length_or_size_is_refused(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path, change: Callable, words: str
) -> None:
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))
    options |= {"video": tmp_path / "out.mkv", "film": tmp_path / "out.mp4"}
    write_lossless(tmp_path / "heldout.mkv", np.ascontiguousarray(change(read_stack(options["render"]))), 24.0)
    with pytest.raises(UserError, match=words):
        call(enhance_shot.run, replace(settings, enhancer="precomputed"), **options, made=[tmp_path / "heldout.mkv"])
    assert not (tmp_path / "out.mkv").exists()


def test_training_renders_of_other_cameras_are_refused(scene: Path, settings: enhance_shot.Settings) -> None:
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))
    film, _, depth = options["train"]
    with pytest.raises(UserError, match=r"of each training camera.*delete it"):
        call(enhance_shot.run, settings, **{**options, "train": [film, scene / "render/heldout.json", depth]})


def test_a_film_that_stays_as_it_is_drawn_needs_no_photos(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path
) -> None:
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam"))
    options |= {"train": [], "video": tmp_path / "out.mkv", "film": tmp_path / "out.mp4"}
    options["decisions"] = tmp_path / "decisions.json"
    plain = replace(settings, enhancer="none", injection=replace(settings.injection, history=0))
    call(enhance_shot.run, plain, **options)
    assert (read_stack(options["video"]) == read_stack(options["render"])).all()
    assert {d.verdict for d in read_decisions(options["decisions"]).values()} == {"off"}


def wall_depth(camera: Camera) -> np.ndarray:
    """Depth (H, W) of the wall x = -3."""
    origin, rays = camera.rays()
    return np.where(rays[..., 0] < 0, (-3.0 - origin[0]) / np.minimum(rays[..., 0], -1e-9), 0).astype(np.float32)


def one_view() -> tuple:
    """A training camera that looks at a wall 3 m away with a residual of 0.2 in red, and a view 20° beside it."""
    camera, view = ring([0, 20], "cam")
    photo = np.zeros((*camera.hw, 3), np.uint8)
    photo[..., 0] = 51
    return camera, view, wall_depth(camera), wall_depth(view), photo


def test_a_render_larger_than_its_photo_counts_by_its_top_left_part() -> None:
    camera, rng = ring([0], "cam")[0], np.random.default_rng(0)
    photo, render = (rng.integers(0, 255, (*camera.hw, 3), dtype=np.uint8) for _ in range(2))
    depth_m = np.full(camera.hw, 2.0)
    larger = np.pad(render, ((0, 4), (0, 2), (0, 0))), np.pad(depth_m, ((0, 4), (0, 2)))
    one, other = (
        residual_source(camera, photo, render, depth_m, TRANSFER),
        residual_source(camera, photo, *larger, TRANSFER),
    )
    np.testing.assert_array_equal(one.residual, other.residual)
    np.testing.assert_array_equal(one.depth_m, other.depth_m)


def plainly_carried_over(
    view: Camera, depth_m: np.ndarray, sources: list[ResidualSource], transfer: Transfer
) -> tuple[np.ndarray, np.ndarray]:
    """The formula of the transfer in whole arrays, without a feather."""
    points = view.unproject(view.pixel_centres(), depth_m.astype(float))
    total, weights, cover = np.zeros((*view.hw, 3)), np.zeros(view.hw), np.zeros(view.hw)
    for one in sources:
        pixels, distance = one.camera.project(points)
        found, inside = sample(one.depth_m, pixels, "nearest")
        seen = (
            (depth_m > 0)
            & inside
            & (distance > 0)
            & (found > 0)
            & (np.abs(found - distance) <= transfer.depth_tolerance * distance)
        )
        here, there = points - view.centre_m, points - one.camera.centre_m
        lengths = np.linalg.norm(here, axis=-1) * np.linalg.norm(there, axis=-1)
        weight = seen * np.clip((here * there).sum(axis=-1) / np.maximum(lengths, 1e-12), 0, 1) ** transfer.angle_power
        total, weights, cover = (
            total + weight[..., None] * sample(one.residual, pixels)[0],
            weights + weight,
            np.maximum(cover, weight),
        )
    return total / np.maximum(weights, 1e-9)[..., None], cover


def test_the_transfer_is_its_formula() -> None:
    camera, view, depth, view_depth, photo = one_view()
    other = ring([0, 40], "cam")[1]
    transfer = replace(TRANSFER, feather_px=0.0)
    rng = np.random.default_rng(0)
    noisy = [rng.integers(0, 255, photo.shape, dtype=np.uint8) for _ in range(2)]
    view_depth = view_depth.copy()
    view_depth[3, 3] = np.nan
    sources = [
        residual_source(camera, noisy[0], 0 * photo, depth, transfer),
        ResidualSource(other, np.float32(noisy[1] / 255), wall_depth(other)),
    ]
    residual, cover = transfer_residual(view, view_depth, sources, transfer)
    expected, expected_cover = plainly_carried_over(view, np.nan_to_num(view_depth), sources, transfer)
    assert (expected_cover > 0).mean() > 0.3
    np.testing.assert_allclose(cover, expected_cover, atol=1e-5)
    # OpenCV reads at 1/32 of a pixel; the transfer is exact.
    np.testing.assert_allclose(residual[cover > 0], expected[cover > 0], atol=0.05)
    assert np.abs(residual - expected)[cover > 0].mean() < 5e-3
    assert cover[3, 3] == 0


def test_corrections_fade_in_towards_seams() -> None:
    camera, view, depth, view_depth, photo = one_view()
    wide = replace(TRANSFER, feather_px=12.0)
    _, cover = transfer_residual(view, view_depth, [residual_source(camera, photo, 0 * photo, depth, wide)], wide)
    steps = np.abs(np.diff(cover, axis=1))
    assert steps.max() < 0.2, "no correction starts at full strength"


def test_the_recursion_ends_at_the_residual_and_not_beyond() -> None:
    """History already carries the correction; adding it again in full would end at 1 / (1 - w) times the residual."""
    camera, view, depth, view_depth, photo = one_view()
    enhancer = ResidualTransfer(
        lambda frame: [residual_source(camera, photo, 0 * photo, depth, TRANSFER)], 1.0, TRANSFER
    )
    section = replace(PAPER, error_threshold=60.0)
    picture = np.full((*view.hw, 3), 60, np.uint8)
    steps = [PathStep(view, 0.0, "00")] * 12
    depths = [np.rint(view_depth * 1000).astype(np.uint16)] * 12
    outputs = list(enhance_sequence(steps, [picture] * 12, depths, lambda step: photo, enhancer, section, SEARCH))
    _, cover = transfer_residual(
        view, depths[0] / 1000, [residual_source(camera, photo, 0 * photo, depth, TRANSFER)], TRANSFER
    )
    added = outputs[-1][..., 0].astype(float) - 60
    np.testing.assert_allclose(added[cover > 0.95], 51 * cover[cover > 0.95], atol=2)


def test_a_film_that_pans_keeps_its_confidence() -> None:
    """U06: fresh noise on a panning texture is steadied by three earlier pictures."""
    view, rng = ring([0], "view")[0], np.random.default_rng(3)
    height, width = view.hw
    texture = cv2.GaussianBlur(rng.random((height, width + 40, 3)).astype(np.float32), (0, 0), 2.0)
    texture = (texture - texture.min()) / np.ptp(texture)
    clean = [texture[:, 2 * k : 2 * k + width] for k in range(12)]
    noisy = [np.rint(255 * np.clip(c + rng.normal(0, 4 / 255, c.shape), 0, 1)).astype(np.uint8) for c in clean]
    steps, depths = [PathStep(view, float(k), "a") for k in range(12)], [np.full(view.hw, 2000, np.uint16)] * 12
    outputs = list(enhance_sequence(steps, noisy, depths, lambda step: noisy[0], Unchanged(), PAPER, SEARCH))
    inner = np.s_[:, 30:-30]
    before, after = (np.std([(p[k] / 255 - clean[k])[inner] for k in range(4, 12)]) for p in (noisy, outputs))
    assert after < 0.93 * before


def test_pixels_that_an_enhancer_breaks_are_left_as_rendered_and_counted(capsys: pytest.CaptureFixture) -> None:
    class Breaking:
        def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
            broken = image.copy()
            if moment.frame >= 0 and not (image == image[0, 0]).all():
                broken[5, 5:8, 0] = np.nan
            return broken

    view, rng = ring([0], "view")[0], np.random.default_rng(3)
    picture, depth = rng.integers(40, 200, (*view.hw, 3), dtype=np.uint8), np.full(view.hw, 2000, np.uint16)
    steps = [PathStep(view, float(k), "a") for k in range(3)]
    outputs = list(enhance_sequence(steps, [picture] * 3, [depth] * 3, lambda step: picture, Breaking(), PAPER, SEARCH))
    for output in outputs:
        np.testing.assert_array_equal(output, picture)
    assert "3 pixels not finite" in "".join(capsys.readouterr())


def test_history_starts_anew_with_every_segment() -> None:
    view = ring([0], "view")[0]
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, (*view.hw, 3), dtype=np.uint8) for _ in range(2)]
    steps = [PathStep(view, 0.0, "a"), PathStep(view, 1.0, "b")]
    depths = [np.full(view.hw, 2000, np.uint16)] * 2
    loose = replace(PAPER, error_threshold=255.0)
    together = list(enhance_sequence(steps, pictures, depths, lambda step: pictures[0], Unchanged(), loose, SEARCH))
    np.testing.assert_array_equal(together[1], pictures[1])


def test_what_a_network_makes_up_on_a_flat_field_does_not_refuse_it() -> None:
    """Naive, asked about grey: a network is refused that leaves every real render as bright as it was."""

    class Network:
        def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
            flat = image.std() < 0.01
            return np.clip(image * np.float32(1.4), 0, 1) if flat else image

    view = ring([0], "view")[0]
    moment = Moment(view, 0.0, np.full(view.hw, 2, np.float32), np.zeros(view.hw, np.float32))
    render = np.random.default_rng(0).random((*view.hw, 3)).astype(np.float32)
    assert loop_gain(Network(), render, render, moment) == pytest.approx(1.0, abs=1e-6)
    # Where a picture is white or black already, less of a change was put in, and less is expected.
    white = np.where(render > 0.5, np.float32(1), np.float32(0))
    assert loop_gain(Network(), white, white, moment) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("reading", ["paper", "config"])
def test_injection_steadies_an_enhancer_that_adds_fresh_noise_to_every_picture(
    reading: str, settings: enhance_shot.Settings
) -> None:
    """Theory of the paper's for confidence 1: an autoregression with 0.3 · (4, 2, 1) / 7, whose steps are 0.93 of the
    noise's own."""

    class Flickering:
        def __init__(self) -> None:
            self.rng = np.random.default_rng(0)

        def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
            return np.clip(image + self.rng.normal(0, 6 / 255, image.shape).astype(np.float32), 0, 1)

    view = ring([0], "view")[0]
    picture = np.clip(np.random.default_rng(1).normal(120, 30, (*view.hw, 3)), 0, 255).astype(np.uint8)
    depth = np.full(view.hw, 2000, np.uint16)

    def flicker(history: int) -> float:
        injection = replace(PAPER if reading == "paper" else settings.injection, history=history)
        steps = [PathStep(view, float(i), "a") for i in range(20)]
        outputs = list(
            enhance_sequence(steps, [picture] * 20, [depth] * 20, lambda step: picture, Flickering(), injection, SEARCH)
        )
        return float(np.abs(np.diff(np.stack(outputs[4:]).astype(float), axis=0)).mean())

    tamed = flicker(3) / flicker(0)
    assert 0.90 < tamed < 0.95 if reading == "paper" else tamed < 0.85


def test_a_moving_camera_has_a_strength_of_its_own(settings: enhance_shot.Settings) -> None:
    first, second = ring([0, 5], "view")
    wide = replace(first, intrinsics=first.intrinsics * np.array([[0.9], [0.9], [1.0]]))
    given = settings.injection
    assert (
        adapt_injection(
            given,
            [
                PathStep(first, 0.0, "a"),
                PathStep(first, 1.0, "a"),
                PathStep(second, 0.0, "b"),
                PathStep(second, 1.0, "b"),
            ],
        )
        == given
    )
    for other in (second, wide):
        moving = adapt_injection(given, [PathStep(first, 0.0, "a"), PathStep(other, 1.0, "a")])
        assert moving == replace(given, strength=given.moving_strength)
        assert moving.strength < given.strength


def test_strength_is_the_least_squares_factor_and_undetermined_without_overlap(settings: enhance_shot.Settings) -> None:
    rng = np.random.default_rng(0)
    predicted, cover = rng.normal(0, 0.1, (20, 30, 3)), np.ones((20, 30))
    assert best_strength([(predicted, cover)], [0.6 * predicted])[0] == pytest.approx(0.6)
    assert best_strength([(predicted, cover)], [-predicted])[0] == 0.0
    assert best_strength([(predicted, 0 * cover)], [predicted]) == (0.0, 0.0)
    assert best_strength([(predicted, cover)], [rng.normal(0, 0.1, predicted.shape)])[0] < 0.1


def test_playback_goes_back_by_reading_again_and_stays_inside_its_part(tmp_path: Path) -> None:
    frames = [np.full((16, 16), value, np.uint8) for value in range(10)]
    write_lossless(tmp_path / "a.mkv", frames, 10.0)
    part = Playback(tmp_path / "a.mkv", 3, 4)
    assert [int(part.at(i)[0, 0]) for i in (0, 2, 2, 1, 3)] == [3, 5, 5, 4, 6]
    with pytest.raises(IndexError, match="4 frames"):
        part.at(4)


@pytest.mark.parametrize("rate", [10.0, 29.97, 60.0])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_jumping_into_a_video_gives_the_frames_that_reading_gives(tmp_path: Path, rate: float, kind: type) -> None:
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 255, (24, 32), dtype=np.uint8).astype(kind) for _ in range(40)]
    write_lossless(tmp_path / "a.mkv", frames, rate)
    for start, stop in ((0, 40), (1, 5), (13, 14), (25, 40), (39, 40)):
        np.testing.assert_array_equal(list(read_frames_from(tmp_path / "a.mkv", start, stop)), frames[start:stop])
    with pytest.raises(UserError, match="no frame 40"):
        list(read_frames_from(tmp_path / "a.mkv", 38, 42))


def test_the_reference_is_the_training_photo_with_the_smallest_angle() -> None:
    cameras = ring([0, 90, 180, 270], "cam")

    class Photo:
        def __init__(self, value: int) -> None:
            self.value = value

        def at(self, index: int) -> np.ndarray:
            return np.array([self.value, index])

    training = Training(cameras, [Photo(i) for i in range(4)], [], [], 10)
    assert training.reference(ring([60], "view")[0], training.nearest_frame(3.4)).tolist() == [1, 3]
    assert training.reference(ring([350], "view")[0], training.nearest_frame(99.0)).tolist() == [0, 9]


def test_a_stand_in_is_not_corrected_by_photos_of_the_person_replaced(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path
) -> None:
    """Where the truth film says invented, the picture stays the render; elsewhere photos correct it as ever."""
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam")) | {
        "video": tmp_path / "a.mkv",
        "film": tmp_path / "a.mp4",
    }
    renders, measured = read_stack(options["render"]), read_stack(scene / "render/heldout.truth.mkv")
    person = np.zeros(measured.shape[1:], bool)
    person[20:60, 40:90] = True
    write_lossless(
        tmp_path / "truth.mkv", np.where(person, 0, 255)[None].repeat(len(measured), 0).astype(np.uint8), 15.0
    )
    still = replace(settings, strength=1.0, injection=replace(settings.injection, history=0))
    call(enhance_shot.run, still, **options)
    plain = read_stack(tmp_path / "a.mkv").astype(int)
    call(enhance_shot.run, still, **options, truth=[tmp_path / "truth.mkv"])
    kept = read_stack(tmp_path / "a.mkv").astype(int)
    assert np.abs(plain - renders)[:, person].max() > 3, "photos would have changed the person"
    assert np.abs(kept - renders)[:, person].max() <= 1
    assert np.abs(kept - renders)[:, ~person].max() > 3


def test_an_edited_picture_is_the_reference_of_the_whole_film(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    class Looking(Unchanged):
        def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Moment) -> np.ndarray:
            seen.append(reference)
            return image

    monkeypatch.setattr(enhance_shot, "load_enhancer", lambda *_: Looking())
    cv2.imwrite(str(tmp_path / "edited.png"), np.full((80, 128, 3), (10, 20, 200), np.uint8))
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam")) | {
        "video": tmp_path / "a.mkv",
        "film": tmp_path / "a.mp4",
    }
    looking = replace(settings, enhancer="none", force={"injection": "on"})
    call(enhance_shot.run, looking, **options, edited=[tmp_path / "edited.png"])
    assert seen
    assert all(np.allclose(one, np.array([200, 20, 10]) / 255, atol=1e-3) for one in seen)
    with pytest.raises(UserError, match=r"nowhere\.png is missing"):
        call(enhance_shot.run, looking, **options, edited=[tmp_path / "nowhere.png"])


def test_residuals_carry_no_steps_of_exposure_into_the_film(
    scene: Path, settings: enhance_shot.Settings, tmp_path: Path
) -> None:
    options = enhance_options(scene, "heldout", ring([0, 90, 180, 270], "cam")) | {
        "video": tmp_path / "a.mkv",
        "film": tmp_path / "a.mp4",
    }
    still = replace(settings, strength=1.0, injection=replace(settings.injection, history=0))
    videos = refilmed(options["videos"], tmp_path / "filmed", GAINS)
    write_factors(tmp_path / "gains.json", {f"cam{k}": own for k, own in enumerate(GAINS)})
    films = {}
    for name, changes in (
        ("plain", {}),
        ("divided", {"videos": videos, "exposure": [tmp_path / "gains.json"]}),
        ("left", {"videos": videos}),
    ):
        call(enhance_shot.run, still, **(options | changes))
        films[name] = read_stack(tmp_path / "a.mkv").astype(float)
    assert np.abs(films["divided"] - films["plain"]).mean() < 1
    assert np.abs(films["left"] - films["plain"]).mean() > 4


def test_the_reference_of_a_network_has_the_exposure_of_the_film() -> None:
    class Photo:
        def at(self, frame: int) -> np.ndarray:
            return np.full((2, 2, 3), 110, np.uint8)

    exposure = Factors({"cam1": np.full((1, 3), 1.1)})
    training = Training(ring([0, 90, 180, 270], "cam"), [Photo()] * 4, [], [], 10, exposure)
    assert training.reference(ring([60], "view")[0], 0).max() == 100
    assert training.reference(ring([350], "view")[0], 0).max() == 110
