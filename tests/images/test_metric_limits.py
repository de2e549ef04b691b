# SPDX-License-Identifier: Apache-2.0
"""Hard cases of picture measures (I01–I10, metric side) and of evaluation (V01–V06)."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.arrays import mean_of_measured
from studiorecon.geometry import rotations
from studiorecon.images import metrics
from studiorecon.report.metrics import jitter, measures, pck, truth

from tests.made.scene import ring

SHAPE = (64, 80, 3)


@pytest.mark.parametrize(
    ("level", "other"),
    [
        pytest.param(77, 77, id="I01-equal"),
        pytest.param(77, 78, id="I01-dark"),
        pytest.param(230, 229, id="I01-bright"),
    ],
)
def test_similarity_of_flat_pictures_is_the_luminance_term_alone(level: int, other: int) -> None:
    # Naive float32: variances of −3e-8 and −1.8e-7, similarity 1.00014 and 0.99954.
    a, b = level / 255, other / 255
    expected = (2 * a * b + 0.01**2) / (a * a + b * b + 0.01**2)
    similarity = metrics.ssim_map(np.full(SHAPE, level, np.uint8), np.full(SHAPE, other, np.uint8))
    assert similarity.max() <= 1.0
    assert metrics.ssim(similarity) == pytest.approx(expected, abs=1e-9)


def test_i02_the_range_is_never_inferred_from_a_dark_pair() -> None:
    # Naive, range from the data: SSIM 0.747 for 0.877 and PSNR 26.0 for 36.5.
    from skimage.metrics import structural_similarity

    rng = np.random.default_rng(0)
    dark = (rng.random(SHAPE) * 60).astype(np.uint8)
    noisy = np.clip(dark + rng.normal(0, 14, SHAPE), 0, 255).astype(np.uint8)
    right, wrong = (
        structural_similarity(
            dark,
            noisy,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            channel_axis=2,
            data_range=data_range,
        )
        for data_range in (255, 60)
    )
    assert metrics.ssim(metrics.ssim_map(noisy, dark)) == pytest.approx(right, abs=1e-9)
    assert abs(right - wrong) > 0.01
    squares = ((dark.astype(float) - noisy) ** 2).mean()
    assert metrics.psnr(noisy, dark) == pytest.approx(10 * np.log10(255**2 / squares), abs=1e-9)


def test_i03_identical_pictures_count_a_hundred_decibels_and_are_counted() -> None:
    # Naive: infinite, and so is every mean it enters.
    picture = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    noisy = (picture ^ 1).astype(np.uint8)
    frames = [{"psnr": metrics.psnr(p, picture)} for p in (picture, noisy)]
    entry = measures.summaries({"a": frames}, ["psnr"], {})["psnr"]
    assert frames[0]["psnr"] == 100.0
    assert entry["cameras"]["a"]["capped"] == 1
    assert entry["value"] == pytest.approx((100 + 20 * np.log10(255)) / 2)


def test_i04_values_beyond_white_are_clamped_first() -> None:
    # Naive: 5 % of the pixels 0.6 too bright score 17.4 dB, clamped 18.7 in the table's example.
    rng = np.random.default_rng(0)
    photo = rng.integers(102, 204, (100, 100, 3)).astype(np.float64) / 255
    render = photo + 0.6 * (rng.random((100, 100, 1)) < 0.05)
    clamped = np.mean((np.rint(np.minimum(render, 1) * 255) / 255 - photo) ** 2)
    assert metrics.psnr(render, photo) == pytest.approx(-10 * np.log10(clamped), abs=1e-9)
    assert metrics.psnr(render, photo) > -10 * np.log10(np.mean((render - photo) ** 2)) + 0.3


@pytest.mark.parametrize(
    "width", [pytest.param(w, id=f"I05-{np.dtype(w).name}") for w in (np.float16, np.float32, np.float64)]
)
def test_squared_errors_are_exact_whatever_the_width_of_the_pictures(width: type) -> None:
    # Naive float16: the squares of differences of 0.01 are 4.6 % too small, those of 2e-4 are 6e-8 for 4e-8.
    first, second = np.full((500, 500, 3), 100, np.uint8), np.full((500, 500, 3), 103, np.uint8)
    error = 10 ** (-metrics.psnr((first / 255).astype(width), (second / 255).astype(width)) / 10)
    assert error == pytest.approx((3 / 255) ** 2, rel=1e-12)


def test_i07_metric_a_frame_without_a_single_pixel_is_skipped_and_counted() -> None:
    # Naive: 0/0, a NaN that swallows the mean of the film.
    rng = np.random.default_rng(0)
    photo = rng.integers(0, 256, SHAPE, dtype=np.uint8)
    render, nobody = (photo ^ 4).astype(np.uint8), np.zeros(SHAPE[:2], bool)
    frames = [measures.measure_picture(render, photo, {"people": mask}) for mask in (nobody, ~nobody)]
    for name in ("psnr_people", "ssim_people"):
        entry = measures.summaries({"a": frames}, [name], {})[name]
        assert frames[0][name] is None
        assert (entry["cameras"]["a"]["used"], entry["cameras"]["a"]["skipped"]) == (1, 1)
        assert np.isfinite(entry["value"])


def test_i08_metric_an_error_inside_a_person_does_not_reach_the_similarity_outside() -> None:
    # Naive, map averaged outside the undilated mask: 0.991.
    photo = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    person = np.zeros(SHAPE[:2], bool)
    person[20:45, 30:50] = True
    similarity = metrics.ssim_map(np.where(person[..., None], 255 - photo, photo), photo)
    assert metrics.ssim(similarity, ~person) == 1.0
    assert similarity[~person].mean() < 0.999


def test_i09_metric_masked_similarity_divides_by_the_mask() -> None:
    # Naive, person blanked in both and the whole map averaged: 0.513 for a true 0.475.
    rng = np.random.default_rng(0)
    photo = rng.integers(0, 256, SHAPE, dtype=np.uint8)
    render = np.clip(photo + rng.normal(0, 60, SHAPE), 0, 255).astype(np.uint8)
    room = np.ones(SHAPE[:2], bool)
    room[:, 40:] = False
    blanked = metrics.ssim_map(render * room[..., None], photo * room[..., None])
    mine = metrics.ssim(metrics.ssim_map(render, photo), room)
    # The room alone, cut out of the picture, is the truth.
    assert mine == pytest.approx(metrics.ssim(metrics.ssim_map(render[:, :40], photo[:, :40])), abs=1e-12)
    assert blanked.mean() > mine + 0.02


@pytest.mark.parametrize("hidden", [pytest.param(v, id=f"I10-metric-{v}") for v in (0, 255)])
def test_no_window_at_a_masks_border_mixes_in_what_is_masked(hidden: int) -> None:
    # Naive, windows normalised by their count: the local mean of a constant 0.5 runs from 0.66 down to 0.006.
    half = np.zeros(SHAPE[:2], bool)
    half[:, :40] = True
    render, photo = (np.where(half[..., None], level, hidden).astype(np.uint8) for level in (128, 140))
    a, b = 128 / 255, 140 / 255
    expected = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    used = metrics.whole_windows(half)
    np.testing.assert_allclose(metrics.ssim_map(render, photo)[used], expected, atol=1e-9)
    assert metrics.ssim(metrics.ssim_map(render, photo), half) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("depth", [pytest.param(v, id=f"V01-{v}") for v in (0.0, -1.0, np.nan, np.inf)])
def test_a_training_depth_that_is_none_sees_nothing(depth: float) -> None:
    # Naive: |inf − z| ≤ 0.05 · inf is true.
    camera = ring([0.0], "c")[0]
    pixels = camera.pixel_centres()[30:50, 50:80]
    points = camera.unproject(pixels, np.full(pixels.shape[:2], 2.0))
    known, wh = np.ones(pixels.shape[:2], bool), camera.wh
    real = np.full((wh[1], wh[0]), 2.0, np.float32)
    assert truth.is_visible(points, known, camera, real, 0.05)[0].all()
    assert not truth.is_visible(points, known, camera, np.full_like(real, depth), 0.05)[0].any()


def test_v02_the_seen_test_is_relative_to_the_training_depth() -> None:
    # 4.77 m against a training depth of 5.02 m: 4.98 % of the training depth, 5.24 % of the other.
    camera = ring([0.0], "c")[0]
    pixels = camera.pixel_centres()[30:50, 50:80]
    points, known = camera.unproject(pixels, np.full(pixels.shape[:2], 4.77)), np.ones(pixels.shape[:2], bool)
    depth = np.full((camera.wh[1], camera.wh[0]), 5.02, np.float32)
    strict, usual = (truth.is_visible(points, known, camera, depth, share)[0] for share in (0.02, 0.05))
    assert (strict.any(), usual.all()) == (False, True)
    picture = np.zeros((*known.shape, 3), np.uint8)
    assert measures.measure_picture(picture, picture, {"seen": usual, "unseen": ~usual})["share_seen"] == 1.0


POINTS = np.stack([np.linspace(10, 50, 24), np.linspace(10, 90, 24)], axis=1)


def person(box_wh: tuple[float, float] = (40.0, 80.0), away_px: float = 0.0) -> pck.TruePerson:
    return pck.TruePerson(POINTS + away_px, np.ones(24, bool), box_wh)


@pytest.mark.parametrize(
    ("found", "people", "share", "rate", "skipped"),
    [
        pytest.param([POINTS], [person((0.0, 0.0))], None, None, 1, id="V03-no-box"),  # ≤ gives 100 %, < gives 0
        pytest.param([POINTS], [person((9.0, 15.9))], None, None, 1, id="V03-small-box"),
        pytest.param(
            [np.where(np.arange(24)[:, None] < 6, np.nan, POINTS)], [person()], 0.75, 1.0, 0, id="V03-missing-points"
        ),
        pytest.param([], [person()], 0.0, 0.0, 0, id="V03-undetected"),
        # Left out of the count, the undetected one would leave 100 %.
        pytest.param([POINTS], [person(), person(away_px=500)], 0.5, 0.5, 0, id="V03-one-of-two"),
        pytest.param([], [], None, None, 0, id="V03-nobody"),
    ],
)
def test_keypoints_are_wrong_skipped_or_counted_as_defined(
    found: list[np.ndarray], people: list[pck.TruePerson], share: float | None, rate: float | None, skipped: int
) -> None:
    result = pck.score_keypoints([(found, people)])
    assert (result["pck_0.05"], result["detection_rate"], result["skipped"]) == (share, rate, skipped)
    assert "longer side" in result["side"], "a score without its scale means nothing (U58)"


@pytest.mark.parametrize(
    "filler", [pytest.param(v, id=f"V04-{n}") for n, v in (("dropped", 3.0), ("zero", 0.0), ("nan", np.nan))]
)
def test_constant_speed_with_a_gap_has_no_jitter(filler: float) -> None:
    # Naive: 1.18 with the frame dropped, 20.0 with it filled by 0, NaN.
    x = np.arange(20.0)[:, None, None] * np.array([0.03, 0.01, 0.0]) + np.zeros((20, 24, 1))
    valid = np.arange(20) != 9
    x[9] = filler
    found = jitter.jitter(x, np.where(valid[:, None], 0.1, filler) + np.zeros((20, 72)), valid, 30.0)
    assert found["joints_mm_f2"] == pytest.approx(0, abs=1e-9)
    assert found["pose_deg_f2"] == pytest.approx(0, abs=1e-9)
    assert (found["used"], found["skipped"]) == (15, 3)


def test_v05_a_steady_turn_through_half_a_turn_has_no_jitter() -> None:
    # Naive, differences of axis-angles: mean 37.9, largest 360 °/frame².
    turn = np.radians(np.arange(150.0, 211.0))[:, None] * np.array([0, 0, 1.0])
    principal = rotations.log(rotations.exp(turn))
    assert np.abs(np.diff(np.degrees(principal), n=2, axis=0)).max() > 300
    poses = np.tile(principal, (1, 24))
    found = jitter.jitter(np.zeros((61, 24, 3)), poses, np.ones(61, bool), 30.0)
    assert found["pose_deg_f2"] < 1e-9


def test_v05_noise_jitter_of_known_noise_and_of_free_fall_is_what_it_should_be() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.001, (3000, 24, 3))
    found = jitter.jitter(noise, np.zeros((3000, 72)), np.ones(3000, bool), 30.0)
    # Second differences have a deviation of √6 mm per axis; the mean length of such a vector is √(8/π) of that: 3.91
    # mm/f².
    assert found["joints_mm_f2"] == pytest.approx(np.sqrt(6) * np.sqrt(8 / np.pi), rel=0.01)
    time_s = np.arange(60)[:, None, None] / 30
    fall = -0.5 * 9.81 * time_s**2 * np.array([0, 0, 1.0]) + np.zeros((60, 24, 3))
    found = jitter.jitter(fall, np.zeros((60, 72)), np.ones(60, bool), 30.0)
    assert (found["root_mm_f2"], found["root_m_s2"]) == (pytest.approx(10.9, abs=0.01), pytest.approx(9.81))


@pytest.mark.parametrize(
    "values", [pytest.param(v, id=f"V06-{len(v)}") for v in ([], [None], [np.nan, np.nan], [None, np.inf, np.nan])]
)
def test_statistics_of_nothing_are_undetermined(values: list[float | None]) -> None:
    # Naive: NaN and a warning, or an exception for a maximum.
    assert mean_of_measured(values) is None
    assert measures.summary({"a": values}, "nothing there") == {
        "value": None,
        "interval": None,
        "reason": "nothing there",
        "cameras": {"a": {"value": None, "used": 0, "skipped": len(values), "frames": [None] * len(values)}},
    }


def test_v06_one_nan_one_value_that_is_none_does_not_take_the_others_along() -> None:
    # Naive: the mean of values with one NaN is NaN.
    assert mean_of_measured([1.0, np.nan, 3.0, None]) == 2.0
