# SPDX-License-Identifier: Apache-2.0
"""report: averages, bodies, cost, truth regions, comparison of folders, and the page."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon import __main__ as command
from studiorecon.body.model import BodyModel
from studiorecon.camera_files.colmap import read_model
from studiorecon.configuration import settings as settings_module
from studiorecon.errors import UserError
from studiorecon.footage.exr import write_depth
from studiorecon.footage.video import read_frame, write_lossless, write_watchable
from studiorecon.models.adapters.lpips import read_lpips
from studiorecon.report import evaluate, score
from studiorecon.report.metrics import films
from studiorecon.report.metrics.bodies import align_by_similarity, compare_bodies, match_people
from studiorecon.report.metrics.estimated import EstimatedFiles, estimated_regions
from studiorecon.report.metrics.measures import Flicker, measure_sequence, summary
from studiorecon.report.metrics.truth import TrueView, truth_regions
from studiorecon.report.sections import paper
from studiorecon.report.sections import tables as sections
from studiorecon.report.sections.cost import cost, read_benchmark
from studiorecon.report.sections.pictures import depth_picture, difference, mask_picture, truth_picture
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.files import read_json
from studiorecon.scene.path import PathStep, write_path
from studiorecon.scene.people import Person

from tests.made.report import poses_of_nobody, report_scene
from tests.made.scene import FPS, FRAMES, WH, ring
from tests.made.steps import call
from tests.made.vgg import random_weights

MISSING = "not measured"


def test_frames_are_averaged_per_camera_and_cameras_equally() -> None:
    """40, 15, 15 dB is 23.3 dB; pooling squared errors would give 16.75."""
    result = summary({"a": [40.0, 15.0, 15.0], "b": [20.0, None, None]}, "")
    assert result["cameras"]["a"]["value"] == pytest.approx(70 / 3)
    assert result["value"] == pytest.approx((70 / 3 + 20) / 2)
    assert (result["cameras"]["b"]["used"], result["cameras"]["b"]["skipped"]) == (1, 2)
    assert result["cameras"]["a"]["frames"] == [40.0, 15.0, 15.0]


def test_nothing_measured_is_null_with_a_reason_and_never_zero() -> None:
    result = summary({"a": [None, None]}, "too small")
    assert result["value"] is None
    assert result["reason"] == "too small"
    assert sections.format_value(None, 2, "dB") == MISSING


def test_flicker_of_a_still_picture_is_zero_and_of_noise_its_own_size() -> None:
    rng = np.random.default_rng(0)
    photo = cv2.GaussianBlur(rng.integers(0, 255, (64, 96, 3), dtype=np.uint8), (0, 0), 2)
    flicker = Flicker("medium")
    noisy = [np.clip(photo + rng.normal(0, 5, photo.shape), 0, 255).astype(np.uint8) for _ in range(3)]
    seen = {"seen": np.ones((64, 96), bool), "unseen": np.zeros((64, 96), bool)}
    values = [flicker.measure(photo, {"still": photo, "noisy": picture}, seen) for picture in noisy]
    assert values[0]["still"]["temporal_l1"] is None
    assert values[2]["still"]["temporal_l1"] == pytest.approx(0, abs=1e-6)
    noise = values[2]["noisy"]
    assert noise["temporal_l1"] * 255 == pytest.approx(5 * 2 / np.sqrt(np.pi), rel=0.1)
    assert noise["warp_rms"] * 255 == pytest.approx(5 * np.sqrt(2), rel=0.1)
    assert noise["flicker_excess"] == pytest.approx(noise["temporal_l1"], abs=1e-6), "the photos do not flicker"
    assert noise["temporal_l1_seen"] == noise["temporal_l1"]
    assert noise["temporal_l1_unseen"] is None


def test_what_was_not_enhanced_has_the_same_numbers_as_if_measured_alone() -> None:
    """Enhanced pictures equal the raw ones in frames 0, 1 and 3; the changes into and out of frame 2 differ."""
    rng = np.random.default_rng(0)
    photos = [cv2.GaussianBlur(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8), (0, 0), 2) for _ in range(5)]
    raw = [np.clip(photo + rng.normal(0, 9, photo.shape), 0, 255).astype(np.uint8) for photo in photos]
    enhanced = [photos[t] if t == 2 else picture.copy() for t, picture in enumerate(raw)]
    masks = {"seen": np.ones((48, 64), bool)}
    both = measure_sequence(
        ((photo, {"raw": raw[t], "enhanced": enhanced[t]}, masks) for t, photo in enumerate(photos)), "fast"
    )
    for name, pictures in {"raw": raw, "enhanced": enhanced}.items():
        alone = measure_sequence(((photo, {name: picture}, masks) for photo, picture in zip(photos, pictures)), "fast")
        assert both[name] == alone[name]
        assert both["photo"] == alone["photo"]
    assert both["raw"][1] == both["enhanced"][1]
    assert [both["raw"][t] != both["enhanced"][t] for t in range(5)] == [False, False, True, True, False]


def walking(rng: np.random.Generator, frames: int = 20) -> np.ndarray:
    return rng.normal(0, 0.4, (1, 24, 3)) + np.linspace(0, 1, frames)[:, None, None] * [1.0, 0, 0]


def test_bodies_are_matched_by_where_they_are_and_ghosts_are_named() -> None:
    rng = np.random.default_rng(0)
    true = {"p0": walking(rng), "p1": walking(rng) + np.array([0, 3, 0]), "p2": walking(rng) + np.array([9, 9, 0])}
    valid = np.ones(20, bool)
    fitted = {
        "p0": (true["p1"] + [0, 0, 0.03], valid),
        "p1": (true["p0"] + 0.0, valid),
        "p2": (true["p0"] + [0, 0, 5.0], valid),
    }
    assert match_people(fitted, true) == {"p0": "p1", "p1": "p0"}
    result = compare_bodies(fitted, true)
    assert result["people"]["p0"]["mpjpe_world_mm"] == pytest.approx(30)
    assert result["people"]["p0"]["mpjpe_pelvis_mm"] == pytest.approx(0, abs=1e-9)
    assert result["mpjpe_world_mm"] == pytest.approx(15)
    assert (result["missed"], result["invented"]) == (["p2"], ["p2"])


def test_only_measured_frames_count_in_joint_errors() -> None:
    true = {"p0": walking(np.random.default_rng(0))}
    valid = np.arange(20) < 10
    fitted = {"p0": (np.where(valid[:, None, None], true["p0"] + [0.01, 0, 0], 50.0), valid)}
    result = compare_bodies(fitted, true)
    assert result["people"]["p0"]["frames"] == 10
    assert result["mpjpe_world_mm"] == pytest.approx(10)
    nobody = compare_bodies({"p0": (true["p0"], np.zeros(20, bool))}, true)
    assert nobody["mpjpe_world_mm"] is None
    assert nobody["reason"]


def test_similarity_alignment_never_mirrors() -> None:
    points = np.random.default_rng(0).normal(size=(24, 3))
    turn = np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        align_by_similarity(points, 1.3 * points @ turn.T + [1, 2, 3]), 1.3 * points @ turn.T + [1, 2, 3], atol=1e-12
    )
    mirrored = points * [-1, 1, 1]
    assert np.linalg.norm(align_by_similarity(points, mirrored) - mirrored) > 0.5


def test_cost_adds_jobs_and_leaves_what_was_not_measured_null(tmp_path: Path) -> None:
    for name, seconds, memory in (
        ("depth/sweep/a", "2.5", "100"),
        ("depth/sweep/b", "4.0", "-"),
        ("depth/room", "0.1", "NA"),
    ):
        path = tmp_path / f"{name}.tsv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"s\th:m:s\tmax_rss\tcpu_time\n{seconds}\t0:00:02\t{memory}\t-\n")
    result = cost(tmp_path)
    depth = result["stages"]["depth"]
    assert depth["seconds"] == pytest.approx(6.6)
    assert depth["rules"]["sweep"]["seconds"] == pytest.approx(6.5)
    assert depth["peak_memory_mb"] == 100
    assert depth["rules"]["room"]["peak_memory_mb"] is None
    assert depth["cpu_seconds"] is None
    assert read_benchmark(tmp_path / "depth/sweep/b.tsv")["peak_memory_mb"] is None
    assert cost(tmp_path / "nothing")["reason"]


def wall_view(camera, masks: Path) -> TrueView:
    """Truth of a camera in front of the wall x = -3."""
    origin, rays = camera.rays()
    depth = np.where(rays[..., 0] < -1e-6, (-3 - origin[0]) / np.minimum(rays[..., 0], -1e-6), 0).astype(np.float32)
    return TrueView(camera, depth, masks)


def test_a_surface_is_seen_while_nobody_stands_before_the_camera_that_sees_it(tmp_path: Path) -> None:
    held, near, behind = ring([10, 0, 180], "c")
    behind_masks = [np.zeros((WH[1], WH[0]), np.uint8)] * 3
    own = [m.copy() for m in behind_masks]
    own[0][10:40, 60:70] = 2
    hidden = [m.copy() for m in behind_masks]
    hidden[1][:] = 1
    for name, masks in (("held", own), ("near", hidden), ("behind", behind_masks)):
        write_lossless(tmp_path / f"{name}.mkv", masks, FPS)
    views = {
        "c0": wall_view(held, tmp_path / "held.mkv"),
        "c1": wall_view(near, tmp_path / "near.mkv"),
        "c2": wall_view(behind, tmp_path / "behind.mkv"),
    }
    found = list(truth_regions(views, held, ["c1", "c2"], 0, 3, 0.05))
    assert found[0]["people"].sum() == 300
    assert not (found[0]["people"] & (found[0]["seen"] | found[0]["unseen"])).any()
    assert found[0]["seen"].mean() > 0.5
    assert found[1]["seen"].sum() == 0, "somebody covers the whole picture of the camera that sees the wall"
    assert found[2]["seen"].sum() >= found[0]["seen"].sum()
    np.testing.assert_array_equal(found[2]["seen"] | found[2]["unseen"], found[2]["background"])
    assert "people_seen" not in found[0], "this truth has no depth of people"


def test_the_run_s_own_depth_and_bodies_say_what_is_seen_as_truth_does(tmp_path: Path, root: Path) -> None:
    held, near, behind = ring([10, 0, 180], "c")
    nobody, hidden = np.zeros((WH[1], WH[0]), np.uint8), np.ones((WH[1], WH[0]), np.uint8)
    for name, masks in (("c0", [nobody] * 3), ("c1", [nobody, hidden, nobody]), ("c2", [nobody] * 3)):
        write_lossless(tmp_path / f"masks/{name}.mkv", masks, FPS)
    views = {camera.name: wall_view(camera, tmp_path / f"masks/{camera.name}.mkv") for camera in (held, near, behind)}
    for name in ("c1", "c2"):
        write_depth(tmp_path / f"depth/{name}.exr", views[name].room_depth_m, np.ones((WH[1], WH[0])))
    # The camera's view begins at the third picture of a film that is larger than it.
    film = np.zeros((5, WH[1] + 2, WH[0] + 4), np.uint16)
    film[2:, : WH[1], : WH[0]] = np.rint(views["c0"].room_depth_m * 1000)
    write_lossless(tmp_path / "heldout.depth.mkv", film, FPS)
    files = EstimatedFiles(
        [tmp_path / "heldout.depth.mkv"],
        [tmp_path / f"depth/{name}.exr" for name in ("c1", "c2")],
        [tmp_path / f"masks/{name}.mkv" for name in ("c1", "c2")],
        [root / "resources/body.npz"],
    )
    arguments = held, [near, behind], 2, 3, 0.05
    for own, exact in zip(
        estimated_regions(files, [], *arguments), truth_regions(views, held, ["c1", "c2"], 0, 3, 0.05)
    ):
        for name in ("people", "background", "seen", "unseen"):
            assert (own[name] != exact[name]).mean() < 0.01, name
    body = BodyModel.load(files.body[0])
    poses, place, betas = np.zeros((3, 72)), np.tile([0.0, 0.0, 0.95], (3, 1)), np.zeros(body.shapes)
    poses[:, 0] = np.pi / 2
    motion = poses, place, betas, body.joints(poses, betas, place)
    person = Person("p0", body.identity, FPS, *motion, np.ones(3, bool), np.full((3, 24), 0.01), True)
    here = next(estimated_regions(files, [person], *arguments))
    assert 0.01 < here["people"].mean() < 0.3
    assert not (here["people"] & (here["seen"] | here["unseen"] | here["background"])).any()


def test_truth_of_another_size_is_read_at_the_right_pixels(tmp_path: Path) -> None:
    camera = ring([0], "c")[0]
    mask = np.zeros((WH[1] * 2, WH[0] * 2), np.uint8)
    mask[40:80, 100:160] = 1
    write_lossless(tmp_path / "m.mkv", [mask], FPS)
    views = {"c0": wall_view(camera.resized((WH[0] * 2, WH[1] * 2)), tmp_path / "m.mkv")}
    people = next(truth_regions(views, camera, [], 0, 1, 0.05))["people"]
    expected = np.zeros((WH[1], WH[0]), bool)
    expected[20:40, 50:80] = True
    np.testing.assert_array_equal(people, expected)


def test_any_renders_can_be_compared_with_any_photos(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    photos = [rng.integers(0, 200, (48, 64, 3), dtype=np.uint8) for _ in range(3)]
    write_lossless(tmp_path / "renders/a.mkv", [p + 10 for p in photos], 10.0)
    (tmp_path / "truth/a").mkdir(parents=True)
    for index, photo in enumerate(photos):
        cv2.imwrite(str(tmp_path / f"truth/a/{index:03d}.png"), photo[..., ::-1])
    arguments = ["report.score", "--renders", str(tmp_path / "renders"), "--truth", str(tmp_path / "truth")]
    assert command.main([*arguments, "--output", str(tmp_path / "m.json")]) == 0
    result = read_json(tmp_path / "m.json")
    assert result["pictures"]["renders"]["psnr"]["value"] == pytest.approx(20 * np.log10(255 / 10), abs=1e-6)
    for name in ("psnr_people", "ssim_seen", "psnr_people_seen"):
        assert result["pictures"]["renders"][name]["value"] is None
        assert result["pictures"]["renders"][name]["reason"]
    assert all(result[part]["reason"] for part in ("bodies", "identities"))
    assert "add --lpips DIR" in result["pictures"]["renders"]["lpips"]["reason"]
    assert set(result["pictures"]["renders"]) <= set(result["definitions"])
    assert "psnr: 28.13" in capsys.readouterr().out


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A folder with random weights in the shape of AlexNet and of LPIPS' heads."""
    import torch

    (tmp_path / "weights").mkdir()
    for name, values in zip(("alexnet.pth", "lpips_alex.pth"), random_weights(torch.float32, net="alex")):
        torch.save(values, tmp_path / "weights" / name)
    return tmp_path / "weights"


def test_with_weights_lpips_is_measured_in_every_frame(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    photos = [rng.integers(0, 200, (64, 72, 3), dtype=np.uint8) for _ in range(3)]
    write_lossless(tmp_path / "truth/a.mkv", photos, 10.0)
    write_lossless(tmp_path / "renders/a.mkv", [photos[0], photos[1] + 10, photos[2] + 40], 10.0)
    folders = ["--renders", str(tmp_path / "renders"), "--truth", str(tmp_path / "truth"), "--lpips", str(weights)]
    assert command.main(["report.score", *folders, "--output", str(tmp_path / "m.json")]) == 0
    result = read_json(tmp_path / "m.json")
    frames = result["pictures"]["renders"]["lpips"]["cameras"]["a"]["frames"]
    network = read_lpips(weights, 1, "alex")
    expected = [
        network(np.float32(photos[k] + gain) / 255, np.float32(photos[k]) / 255)[0]
        for k, gain in enumerate((0, 10, 40))
    ]
    assert frames[0] == 0 < frames[1] < frames[2]
    np.testing.assert_allclose(frames, expected, rtol=1e-4, atol=1e-7)
    assert "AlexNet" in result["definitions"]["lpips"]["definition"]
    assert "torch" in result["definitions"]["lpips"]["library"]
    assert result["provenance"]["settings"]["lpips"] == "alex"
    (weights / "lpips_alex.pth").unlink()
    assert command.main(["report.score", *folders]) == 1
    assert "lpips_alex.pth, which is missing; put it there or leave --lpips out" in capsys.readouterr().err


def test_of_two_films_of_one_shot_the_lossless_one_is_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos = [np.random.default_rng(k).integers(0, 255, (48, 64, 3), np.uint8) for k in range(2)]
    write_lossless(tmp_path / "truth/a.mkv", photos, 10.0)
    write_lossless(tmp_path / "renders/a.mkv", photos, 10.0)
    write_watchable(tmp_path / "renders/a.mp4", photos, 10.0)
    found = score.score(tmp_path / "renders", tmp_path / "truth", None)["pictures"]["renders"]
    assert found["ssim"]["value"] == 1.0
    assert "a.mp4" in capsys.readouterr().out
    shutil.copy(tmp_path / "renders/a.mkv", tmp_path / "renders/a.avi")
    with pytest.raises(UserError, match=r"give one film, such as (\S+a\.avi)") as refused:
        score.score(tmp_path / "renders", tmp_path / "truth", None)
    film = Path(refused.value.args[0].split("such as ")[1].split(",")[0])
    assert score.score(film, tmp_path / "truth/a.mkv", None)["pictures"]["renders"]["ssim"]["value"] == 1.0


def test_pictures_for_readers_mark_what_they_should() -> None:
    photo = np.full((20, 30, 3), 100, np.uint8)
    mask = np.zeros((20, 30), np.uint8)
    mask[:5], mask[5:10] = 1, 255
    tinted = mask_picture(photo, mask)
    assert (tinted[15] == 100).all()
    assert len({tuple(tinted[row, 0]) for row in (0, 7, 15)}) == 3
    depth = np.full((20, 30), 2.0, np.float32)
    depth[:, 15:], depth[0, 0] = 4.0, 0.0
    picture, (near, far) = depth_picture(depth)
    assert (near, far) == (2.0, 4.0)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[5, 5].sum() > picture[5, 25].sum()
    assert difference(photo, photo).sum(axis=-1).max() < 30
    assert truth_picture(np.full((20, 30), 0, np.uint8), photo)[0, 0].argmax() == 0


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory, root: Path, default_settings: Callable) -> Path:
    return report_scene(tmp_path_factory.mktemp("scene"), root, default_settings)


def test_scores_equal_the_planted_error_and_say_what_is_missing(reported: Path) -> None:
    metrics = read_json(reported / "report/metrics.json")
    raw = metrics["pictures"]["raw"]["psnr"]
    assert raw["value"] == pytest.approx(20 * np.log10(255 / 5), abs=0.3)
    assert list(raw["cameras"]) == ["view0", "view1"]
    assert len(raw["cameras"]["view0"]["frames"]) == FRAMES
    assert metrics["pictures"]["enhanced"]["psnr"]["value"] == 100.0
    for name in ("psnr_people", "ssim_background", "psnr_seen"):
        assert metrics["pictures"]["raw"][name]["value"] is None
        assert "rendered depth" in metrics["pictures"]["raw"][name]["reason"]
    assert metrics["pictures"]["raw"]["temporal_l1"]["cameras"]["view0"]["skipped"] == 1
    assert metrics["bodies"]["mpjpe_world_mm"] is None
    assert metrics["pictures"]["raw"]["lpips"]["value"] is None
    assert "report.lpips is none" in metrics["pictures"]["raw"]["lpips"]["reason"]
    assert metrics["training"] is None, "there are held-out cameras"
    assert set(metrics["inputs"]) >= {"render/heldout.mkv", "enhance/heldout.mkv", "view0.mkv"}
    assert metrics["coverage"]["heldout"]["inferred"] == 1.0


def test_a_network_that_saw_the_held_out_cameras_is_declared(
    reported: Path, default_settings: Callable, tmp_path: Path
) -> None:
    """Held-out poses come only from the network here, so the protocol lists the pictures that it saw."""
    told = {}
    for calibrator in ("none", "pi3"):
        call(
            evaluate.run,
            settings_module.load(evaluate.Settings, default_settings("report"), "report"),
            manifest=reported / "capture/manifest.json",
            model=reported / "cameras/images.txt",
            heldout_model=reported / "cameras/heldout/images.txt",
            poses=poses_of_nobody(tmp_path),
            truth_maps=[],
            metrics=tmp_path / "metrics.json",
            calibrator=calibrator,
        )
        told[calibrator] = read_json(tmp_path / "metrics.json")["protocol"]
    assert told["pi3"].startswith(told["none"])
    assert "pi3 estimated the cameras from the first picture of every camera, held-out ones included" in told["pi3"]


def write_folders(folder: Path, shift: int = 10, frames: int = 30, cameras: str = "ab") -> None:
    """``truth`` and ``renders`` of moving noise, the renders brighter by ``shift`` levels and a little noisy, and
    ``masks`` of a block."""
    rng = np.random.default_rng(5)
    for camera in cameras:
        base = cv2.GaussianBlur(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8), (0, 0), 2)
        photos = [np.roll(base, frame, axis=1) for frame in range(frames)]
        noise = [rng.normal(0, 1 + frame % 3, base.shape) for frame in range(frames)]
        write_lossless(folder / f"truth/{camera}.mkv", photos, 10.0)
        renders = [np.clip(p + shift + n, 0, 255).astype(np.uint8) for p, n in zip(photos, noise)]
        write_lossless(folder / f"renders/{camera}.mkv", renders, 10.0)
        mask = np.zeros((48, 64), np.uint8)
        mask[10:40, 20:50] = 1
        write_lossless(folder / f"masks/{camera}.mkv", [mask] * frames, 10.0)


def scored(folder: Path, name: str, masks: bool = False) -> Path:
    score.run(folder / "renders", folder / "truth", folder / "masks" if masks else None, folder / name)
    return folder / name


def test_masks_add_numbers_of_people_and_room_and_every_number_has_raw_values_and_an_interval(tmp_path: Path) -> None:
    write_folders(tmp_path)
    result = read_json(scored(tmp_path, "m.json", masks=True))
    for name in (
        "psnr",
        "psnr_people",
        "psnr_background",
        "ssim_people",
        "temporal_l1",
        "flicker_excess",
    ):
        entry = result["pictures"]["renders"][name]
        low, high = entry["interval"]
        assert low <= entry["value"] <= high
        assert [len(entry["cameras"][c]["frames"]) for c in "ab"] == [30, 30]
        assert entry["cameras"]["a"]["used"] + entry["cameras"]["a"]["skipped"] == 30
    assert result["pictures"]["renders"]["psnr_seen"]["value"] is None
    assert result["pictures"]["renders"]["psnr"]["cameras"]["a"]["capped"] == 0
    assert result["pictures"]["photo"]["temporal_l1"]["value"] is not None
    assert result["provenance"]["masks"].startswith("given")


def test_the_command_alone_and_a_run_get_the_same(default_settings: Callable) -> None:
    told = settings_module.load(evaluate.Settings, default_settings("report"), "report")
    assert told.flow_preset == score._FLOW_PRESET
    assert (told.bootstrap_samples, told.seed) == (score._BOOTSTRAP.samples, score._BOOTSTRAP.seed)


def test_one_film_or_one_folder_of_pictures_is_one_camera(tmp_path: Path) -> None:
    write_folders(tmp_path, frames=3, cameras="a")
    for name in ("renders", "truth"):
        (tmp_path / f"{name}_only").mkdir()
        for frame in range(3):
            picture = read_frame(tmp_path / f"{name}/a.mkv", frame)
            cv2.imwrite(str(tmp_path / f"{name}_only/{frame}.png"), picture[..., ::-1])
    folders = score.score(tmp_path / "renders_only", tmp_path / "truth_only", None)
    films = score.score(tmp_path / "renders/a.mkv", tmp_path / "truth/a.mkv", None)
    assert folders["pictures"]["renders"]["psnr"]["value"] == films["pictures"]["renders"]["psnr"]["value"]


def test_scoring_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    write_folders(tmp_path, frames=8)
    assert scored(tmp_path, "one.json").read_bytes() == scored(tmp_path, "two.json").read_bytes()


@pytest.mark.parametrize("frames", [[0, 2, 4, 6, 8, 10], [0, 1, 2], None])
def test_a_film_of_another_run_is_refused_by_name(reported: Path, tmp_path: Path, frames: list[int] | None) -> None:
    held_out, capture = read_model(reported / "cameras/heldout"), read_manifest(reported / "capture/manifest.json")
    name = "elsewhere" if frames is None else held_out[0].name
    write_path(tmp_path / "heldout.json", [PathStep(held_out[0], float(f), name) for f in frames or range(FRAMES)], FPS)
    with pytest.raises(UserError, match=r"heldout\.json .* belongs to another run"):
        films.first_frames(tmp_path / "heldout.json", held_out[:1], capture)


def test_without_held_out_cameras_the_training_cameras_are_compared_apart(
    reported: Path, default_settings: Callable, tmp_path: Path
) -> None:
    """The footage itself as render: the numbers are under ``training``, and none is among the results."""
    for name in ("cameras", "images"):
        (tmp_path / f"{name}.txt").write_text("# none\n")
    training = read_model(reported / "cameras")
    pictures = [read_frame(reported / f"capture/{c.name}.mkv", f) for c in training for f in range(FRAMES)]
    write_lossless(tmp_path / "train.mkv", pictures, FPS)
    write_path(tmp_path / "train.json", [PathStep(c, float(f), c.name) for c in training for f in range(FRAMES)], FPS)
    call(
        evaluate.run,
        settings_module.load(evaluate.Settings, default_settings("report"), "report"),
        manifest=reported / "capture/manifest.json",
        model=reported / "cameras/images.txt",
        heldout_model=tmp_path / "images.txt",
        poses=poses_of_nobody(tmp_path),
        videos=[reported / f"capture/{c.name}.mkv" for c in training],
        render=[tmp_path / "train.mkv"],
        render_path=[tmp_path / "train.json"],
        truth_maps=[],
        metrics=tmp_path / "metrics.json",
    )
    metrics = read_json(tmp_path / "metrics.json")
    assert metrics["training"]["raw"]["psnr"]["value"] == 100.0
    assert metrics["training"]["raw"]["psnr"]["cameras"][training[0].name]["capped"] == FRAMES
    assert metrics["pictures"]["raw"]["psnr"]["value"] is None


def test_the_papers_rows_stand_beside_the_runs_and_are_marked(reported: Path, root: Path) -> None:
    recognised = {"raw": {"pck_0.05": 0.75}}
    header, rows = paper.paper_comparison(
        read_json(reported / "report/metrics.json"), recognised, root / "resources/paper/results.tsv"
    )
    assert [name for name in header if "other data" in name] == [f"{m} (other data)" for m in paper.METHODS]
    by_measure = {row[0]: row for row in rows}
    assert by_measure["PSNR ↑"][3:7] == ["20.44", "17.06", "16.68", "17.21"]
    assert by_measure["LPIPS ↓"][1:3] == [MISSING, MISSING]
    assert by_measure["PCK@0.05 ↑"][1:3] == ["0.750", MISSING]
    assert "Compared with the paper" in (reported / "report/index.html").read_text()
