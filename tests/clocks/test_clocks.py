# SPDX-License-Identifier: Apache-2.0
"""Clocks without hardware: planted starts, rates and drifts come out of sound, people or motion, and of nothing where
nothing tells."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.clocks import moments as moments_step
from studiorecon.clocks import offsets as clocks_step
from studiorecon.clocks.motion import motion_lag
from studiorecon.clocks.people import people_lags
from studiorecon.clocks.posterior import Lag, Offset, Source, estimate_offsets
from studiorecon.clocks.timeline import common_moments
from studiorecon.configuration.settings import load
from studiorecon.keypoints.resampling import resample_keypoints
from studiorecon.scene.clocks import Clock, Clocks, read_clock_findings, read_clocks
from studiorecon.scene.files import read_json, write_json
from studiorecon.scene.people import Detections, write_detections

from benchmarks.clocks import the_man
from tests.defaults import UNSEARCHED
from tests.made.cameras import STANDING, detect, ring
from tests.made.sound import Recorder, moving, record, world_sound

FPS = 30.0
Found = tuple[Clocks, dict[str, Any]]


@pytest.fixture
def find(default_settings: Callable[..., dict[str, Any]], tmp_path: Path) -> Callable[..., Found]:
    """What the step makes of recordings of ``seconds`` of a world with ``sound``."""

    def run(
        recorders: Sequence[Recorder],
        sound: str,
        seconds: float,
        moves: bool = False,
        sync: str = "auto",
        starts: str = "{}",
        seen: Sequence[Detections] = (),
        own_s: dict[str, np.ndarray] | None = None,
        count: int = 0,
    ) -> Found:
        world = world_sound(sound, seconds + 25)
        paths = []
        for view, recorder in enumerate(recorders):
            own = (own_s or {}).get(recorder.name, np.arange(round(seconds * recorder.fps)) / recorder.fps)
            frames = moving(recorder.world_s(own), view=view) if moves else None
            paths.append(record(tmp_path, recorder, world, seconds, frames, own))
        for d in seen:
            write_detections(tmp_path / f"{d.camera}.npz", d)
        settings = load(clocks_step.Settings, default_settings("clocks", sync=sync), "clocks")
        take, lags = clocks_step.Take([r.name for r in recorders], paths, starts, 0, count), tmp_path / "lags.json"
        moments_step.run(settings, take, 0, lags, *UNSEARCHED)
        sightings, written = [tmp_path / f"{d.camera}.npz" for d in seen], ("clocks.json", "sync.json")
        clocks_step.run(settings, take, sightings, lags, *(tmp_path / name for name in written))
        looked = [] if sync == "never" else [r.name for r in recorders]
        assert [f.camera for f in read_clock_findings(tmp_path / "sync.json")[0]] == looked
        return read_clocks(tmp_path / "clocks.json"), {
            f["camera"]: f for f in read_json(tmp_path / "sync.json")["cameras"]
        }

    return run


def error_frames(found: Clocks, recorders: Sequence[Recorder]) -> float:
    """By how many frames the found moments of any camera are off at worst, over the clip."""
    first = recorders[0]
    lead = first.start_s - found.of(first.name).offset_s
    errors = [found.of(r.name).common_s + lead - r.world_s(found.of(r.name).own_s) for r in recorders]
    return max(float(np.abs(e).max()) for e in errors) * found.fps


class TestSound:
    @pytest.mark.parametrize("sound", ["speech", "claps"])
    def test_ten_seconds_a_frame_and_less_come_out(self, find, sound: str) -> None:
        """Two file formats, three codecs, one deaf camera's neighbours, a bare room and a muffled microphone."""
        recorders = [
            Recorder("a", 10.0),
            Recorder("b", 20.0, codec="pcm_s16le"),
            Recorder("c", 10 + 1 / FPS, muffled=0.6, codec="flac"),
            Recorder("d", 10 - 0.4 / FPS, noise=0.01),
            Recorder("e", 10 + 0.4 / FPS, echo=0.2),
        ]
        found, reported = find(recorders, sound, 14)
        assert error_frames(found, recorders) < 0.2
        assert {f["kind"] for f in reported.values()} == {"reference", "found"}
        assert found.frames == pytest.approx(4 * FPS, abs=1), "what all have"
        for recorder in recorders:
            shown = recorder.world_s(found.source_frames(recorder.name) / FPS) - 10
            moments = found.start_s + np.arange(found.frames) / FPS
            assert np.abs(shown - moments).max() * FPS < 0.5 + 0.2, "the nearest picture"

    def test_one_clap_is_enough(self, find) -> None:
        recorders = [Recorder("a", 14.0), Recorder("b", 12.5)]
        found, _ = find(recorders, "clap", 8)
        assert error_frames(found, recorders) < 0.1

    def test_a_hum_tells_nothing(self, find) -> None:
        found, reported = find([Recorder("a", 10.0), Recorder("b", 12.0)], "hum", 8)
        assert [c.offset_s for c in found.cameras] == [0, 0]
        assert reported["b"]["kind"] == "undetermined"
        assert "a hum" in reported["b"]["sentence"]

    def test_noise_of_microphones_tells_nothing(self, find) -> None:
        for seed in range(3):
            _, reported = find([Recorder(f"a{seed}", 10.0), Recorder(f"b{seed}", 12.0)], "silence", 8)
            assert reported[f"b{seed}"]["kind"] == "undetermined"

    def test_a_clock_that_drifts_is_followed(self, find) -> None:
        """50 ppm over four minutes at 15 frames per second: 0.18 frames between the ends."""
        recorders = [Recorder("a", 10.0, fps=15.0), Recorder("b", 12.2, fps=15.0, drift_ppm=50)]
        found, reported = find(recorders, "claps", 240)
        assert found.of("b").drift_ppm == pytest.approx(50, abs=10)
        assert error_frames(found, recorders) < 0.1
        assert re.search(r"its clock (4|5)\d ppm slow", reported["b"]["sentence"])


class TestOthers:
    def test_a_silent_camera_is_placed_by_its_motion(self, find) -> None:
        recorders = [Recorder("a", 10.0), Recorder("b", 11.0), Recorder("c", 11.5, deaf=True)]
        found, reported = find(recorders, "speech", 16, moves=True)
        assert error_frames(found, recorders) < 1.01, "motion tells whole frames"
        assert (reported["b"]["method"], reported["c"]["method"]) == ("sound", "motion")

    def test_pictures_that_stand_still_tell_nothing(self, find) -> None:
        found, reported = find([Recorder("a", 10.0, deaf=True), Recorder("b", 12.0, deaf=True)], "silence", 6)
        assert reported["b"]["kind"] == "undetermined"
        assert found.frames == 180, "as filmed"

    def test_people_place_cameras_that_nobody_calibrated(self, find) -> None:
        """Keypoints at 2 px of noise; the second camera began 2.4 frames later."""
        cameras, seen = ring()[:3], []
        for camera, late in zip(cameras, (0.0, 2.4, 0.0)):
            seen += detect(
                [camera], [walking(late, 240), walking(late, 240, 1.0)], 2.0, np.random.default_rng(len(seen))
            )
        recorders = [Recorder(c.name, 10 + late / FPS, deaf=True) for c, late in zip(cameras, (0.0, 2.4, 0.0))]
        found, reported = find(recorders, "silence", 8, seen=seen)
        assert error_frames(found, recorders) < 0.2
        assert [reported[c.name]["kind"] for c in cameras] == ["reference", "found", "in step"]

    def test_what_contradicts_itself_is_undetermined_with_all_that_was_said(self) -> None:
        lags = [Lag(Source("sound"), 0, 1, 2.0, 0.005, 0.01), Lag(Source("people"), 0, 1, 3.0, 0.005, 0.01)]
        verdict = clocks_step.applied_clock(estimate_offsets(lags, 2, 0)[1], FPS, 10)
        assert verdict.kind == "undetermined"
        alone = {lag.source.name: estimate_offsets([lag], 2, 0)[1] for lag in lags}
        reported = clocks_step.clock_sentence("b", verdict, alone, {}, "a", FPS)
        assert "sound +2.000" in reported
        assert "people +3.000" in reported

    @pytest.mark.parametrize(
        ("kind", "people_s"), [("found", (2.0, 0.1)), ("undetermined", None), ("reference", (0.0, 0.0))]
    )
    def test_people_alone_blame_no_clock_that_other_sources_contradict(self, tmp_path, kind, people_s) -> None:
        estimate = {"method": "people", "offset_s": 2.0, "half_s": 0.1, "drift_ppm": 0.0}
        about = {"camera": "a", "kind": kind, "reason": "", "sentence": "", "proposals": [estimate], "without": {}}
        write_json(tmp_path / "sync.json", {"sync": "auto", "given": {}, "cameras": [estimate | about], "films": []})
        ((finding,), _) = read_clock_findings(tmp_path / "sync.json")
        assert finding.people_s == people_s

    @pytest.mark.parametrize(("frames", "applied"), [(11.04, 11), (11.4, 11.4), (0.05, 0), (-2.93, -3)])
    def test_nothing_is_resampled_for_a_fraction_that_does_not_matter(self, frames: float, applied: float) -> None:
        verdict = clocks_step.applied_clock(Offset(frames / FPS, 0.1 / FPS), FPS, 10)
        assert verdict.offset_s * FPS == pytest.approx(applied)

    def test_what_is_only_known_to_a_quarter_of_a_second_is_undetermined(self) -> None:
        assert clocks_step.applied_clock(Offset(1.0, 0.25), FPS, 10).kind == "undetermined"
        assert clocks_step.applied_clock(estimate_offsets([], 2, 0)[1], FPS, 10).kind == "undetermined"

    def test_the_interval_covers_what_was_found_whatever_is_applied(self) -> None:
        """A camera that is kept as filmed although 0.6 ± 0.68 frames were found may be off by 1.28."""
        verdict = clocks_step.applied_clock(Offset(0.6 / FPS, 0.68 / FPS), FPS, 8)
        assert verdict.kind == "in step"
        assert verdict.half_s * FPS == pytest.approx(1.28)
        apart = clocks_step.applied_clock(Offset(0.4 / FPS, 0.5 / FPS), FPS, 8, triggered=False)
        assert apart.kind == "found"
        assert apart.offset_s * FPS == pytest.approx(0.4)


class TestPosterior:
    TRUE = (0.0, 1.0, -2.0, 0.5)

    def lags(
        self, source: Source, sigma_s: float, off_s: dict[tuple[int, int], float], outlier_probability: float
    ) -> list[Lag]:
        return [
            Lag(source, a, b, self.TRUE[b] - self.TRUE[a] + off_s.get((a, b), 0.0), sigma_s, outlier_probability)
            for a, b in itertools.combinations(range(4), 2)
        ]

    def test_one_wrong_lag_of_many_is_left_out(self) -> None:
        found = estimate_offsets(self.lags(Source("sound"), 0.01, {(0, 2): 0.7}, 0.01), 4, 0)
        assert [o.seconds for o in found] == pytest.approx(self.TRUE, abs=1e-3)
        assert max(o.half_s for o in found) < 0.05

    def test_a_third_camera_decides_between_two_that_contradict_each_other(self) -> None:
        sound, people = Source("sound"), Source("people")
        lags = [Lag(sound, 0, 1, 3.0, 0.01, 0.01), Lag(people, 0, 1, 1.0, 0.01, 0.01)]
        assert estimate_offsets(lags, 3, 0)[1].half_s > 1
        lags += [Lag(people, 0, 2, -2.0, 0.01, 0.01), Lag(sound, 1, 2, -3.0, 0.01, 0.01)]
        found = estimate_offsets(lags, 3, 0)
        assert [o.seconds for o in found] == pytest.approx(self.TRUE[:3], abs=1e-3)
        assert max(o.half_s for o in found) < 0.05

    def test_stated_intervals_cover_and_a_shared_error_does_not_average_out(self) -> None:
        covered, rng = {0.0: 0, 0.02: 0}, np.random.default_rng(0)
        for bias_s in covered:
            for _ in range(100):
                bias = bias_s * rng.normal(size=4)
                off = {(a, b): 0.01 * rng.normal() + bias[b] - bias[a] for a, b in itertools.combinations(range(4), 2)}
                found = estimate_offsets(self.lags(Source("sound", bias_s), 0.01, off, 0.01), 4, 0)
                covered[bias_s] += sum(abs(o.seconds - t) <= o.half_s for o, t in zip(found[1:], self.TRUE[1:]))
        assert all(270 <= count <= 298 for count in covered.values()), covered

    def test_a_source_that_is_mostly_deceived_is_not_believed_elsewhere(self) -> None:
        sound, motion = Source("sound"), Source("motion")
        lags = [Lag(sound, 0, c, 0.0, 0.01, 0.01) for c in range(1, 6)]
        wrong = [Lag(motion, 0, c, 2.0 + c, 0.04, 0.03) for c in range(1, 7)]
        assert estimate_offsets(lags + wrong[-1:], 7, 0)[6].half_s < 0.15
        assert estimate_offsets(lags + wrong, 7, 0)[6].half_s > 1


class TestUse:
    def test_the_user_s_starts_stand(self, find) -> None:
        recorders = [Recorder("a", 10.0), Recorder("b", 11.0)]
        found, _ = find(recorders, "speech", 10, starts=json.dumps({"a": 12.6, "b": 0.0}))
        assert [c.offset_s for c in found.cameras] == pytest.approx([-12.6 / FPS, 0])
        assert (found.source_frames("a")[0], found.source_frames("b")[0]) == (13, 0)

    @pytest.mark.parametrize("sync", ["report", "never"])
    def test_what_is_only_reported_changes_nothing(self, find, sync: str) -> None:
        found, reported = find([Recorder("a", 10.0), Recorder("b", 11.0)], "speech", 8, sync=sync)
        assert [list(found.source_frames(c)) for c in "ab"] == [list(range(240))] * 2
        assert bool(reported) == (sync == "report")

    def test_videos_of_two_lengths_and_unknown_clocks_are_refused_later(self, find) -> None:
        own = {"b": np.arange(200) / FPS}
        films = [Recorder("a", 10.0, deaf=True), Recorder("b", 10.0, deaf=True)]
        found, _ = find(films, "silence", 8, own_s=own)
        assert "b.mp4 has 200 frames and" in found.refusal
        assert "frames: {first: 0, count: 200}" in found.refusal
        assert "starts: {CAMERA: frame}" in found.refusal
        # Either advice, followed.
        found, _ = find(films, "silence", 8, own_s=own, count=200)
        assert (found.refusal, found.frames) == ("", 200)
        found, _ = find(films, "silence", 8, own_s=own, starts=json.dumps({"a": 30, "b": 0}))
        assert (found.refusal, found.frames) == ("", 200)

    def test_a_variable_rate_is_put_on_the_common_clock(self, find) -> None:
        """A phone that gives 24 to 33 frames per second, as it likes, beside one that keeps time."""
        rng = np.random.default_rng(3)
        own = {"b": np.round(np.cumsum(rng.uniform(1 / 33, 1 / 24, 230)), 4)}
        own["b"] -= own["b"][0]
        recorders = [Recorder("a", 10.0), Recorder("b", 10.5)]
        found, _ = find(recorders, "speech", 8, own_s=own)
        assert np.abs(found.of("b").own_s - own["b"]).max() < 1e-4
        shown = recorders[1].world_s(own["b"][found.source_frames("b")]) - 10
        assert np.abs(shown - found.start_s - np.arange(found.frames) / FPS).max() < 0.55 / 24 + 0.2 / FPS

    def test_cameras_of_two_rates_share_the_moments_of_most(self) -> None:
        rates = [Clock("a", 30.0, 100), Clock("b", 25.0, 100, offset_s=1.0), Clock("c", 30.0, 100)]
        found = common_moments(rates, 0, 0)
        assert (found.fps, found.frames) == (30.0, 70), "most cameras' rate, from 1 s to 3.3 s"
        np.testing.assert_array_equal(found.source_frames("a"), np.arange(30, 100))
        assert np.abs(found.late_frames("b")).max() <= 0.6 + 1e-9

    def test_videos_without_a_common_moment_are_named(self) -> None:
        found = common_moments([Clock("a", 30.0, 100), Clock("b", 30.0, 100, offset_s=9.0)], 0, 0)
        assert "camera b begins 5.7 s after camera a has ended" in found.refusal


def walking(late_frames: float, frames: int, phase: float = 0.0) -> np.ndarray:
    """(T, 12, 3) a person who walks to and fro, turns and swings arms and legs, at frames that are taken
    ``late_frames`` late."""
    t = (np.arange(frames) + late_frames) / FPS
    swing = 0.2 * np.sin(5 * t + phase)[:, None] * np.repeat([0, 0.5, 1, 0, 0.5, 1], 2) * np.tile([1, -1], 6)
    body = STANDING[None] + np.stack([swing, np.zeros_like(swing), np.zeros_like(swing)], axis=-1)
    turn = 1.1 * t + 2 * phase
    c, s, o, e = np.cos(turn), np.sin(turn), np.zeros(frames), np.ones(frames)
    turned = np.einsum("tkj,tij->tki", body, np.stack([c, -s, o, s, c, o, o, o, e], -1).reshape(-1, 3, 3))
    place = np.stack([0.7 * np.sin(1.3 * t + phase), 0.6 * np.sin(0.8 * t + 2 * phase), 0 * t], -1)
    return turned + place[:, None]


class TestRetiming:
    @staticmethod
    def seen(position: np.ndarray, path: Callable[[np.ndarray], np.ndarray], readout: float = 0.0) -> Detections:
        """One person's 17 keypoints at ``path`` of their times; rows of the picture (100 high) look ``readout``
        apart."""
        offsets = np.stack([np.linspace(0, 30, 17), np.linspace(10, 90, 17)], -1)
        points = np.array([[path(t + readout * (o[1] / 100 - 0.5)) + o for o in offsets] for t in position])
        points = np.concatenate([points, np.ones((*points.shape[:2], 1))], -1)
        return Detections("a", "coco17", np.arange(len(position)), np.zeros(len(position), int), points)

    def test_on_the_beat_nothing_changes(self) -> None:
        clocks = Clocks(FPS, 3 / FPS, 10, (Clock("a", FPS, 20),))
        seen = self.seen(np.arange(20), lambda t: np.array([3 * t, 0]))
        moved = resample_keypoints(seen, clocks, 100)
        np.testing.assert_array_equal(moved.keypoints, seen.keypoints[3:13])
        np.testing.assert_array_equal(moved.frame, np.arange(10))

    @pytest.mark.parametrize("late", [0.4, -0.4])
    def test_between_frames_a_swinging_arm_is_where_it_is(self, late: float) -> None:
        def swing(t: float) -> np.ndarray:
            return np.array([20 * np.sin(2 * np.pi * 1.2 * t / FPS), 0.0])

        clocks = Clocks(FPS, 2 / FPS, 30, (Clock("a", FPS, 40, offset_s=late / FPS),))
        moved = resample_keypoints(self.seen(np.arange(40) + late, swing), clocks, 100)
        wanted = self.seen(np.arange(2, 32), swing).keypoints
        assert np.abs(moved.keypoints - wanted).max() < 0.02
        unmoved = self.seen(np.arange(40) + late, swing).keypoints[2:32]
        assert np.abs(unmoved - wanted).max() > 1.5, "what it would be as filmed"

    def test_a_rolling_shutter_stands_upright_again(self) -> None:
        clocks = Clocks(FPS, 2 / FPS, 30, (Clock("a", FPS, 40, readout_s=0.6 / FPS),))
        moved = resample_keypoints(self.seen(np.arange(40), lambda t: np.array([8 * t, 0]), 0.6), clocks, 100)
        np.testing.assert_allclose(
            moved.keypoints, self.seen(np.arange(2, 32), lambda t: np.array([8 * t, 0])).keypoints, atol=1e-6
        )

    def test_what_was_not_seen_is_not_invented(self) -> None:
        clocks = Clocks(FPS, 2 / FPS, 10, (Clock("a", FPS, 20, offset_s=0.4 / FPS),))
        seen = self.seen(np.arange(20), lambda t: np.array([3 * t, 0]))
        gone = replace(
            seen,
            frame=np.delete(seen.frame, 5),
            track=np.delete(seen.track, 5),
            keypoints=np.delete(seen.keypoints, 5, 0),
        )
        gone.keypoints[8, 3] = [np.nan, np.nan, 0]
        moved = resample_keypoints(gone, clocks, 100)
        assert 3 not in moved.frame, "nearest to the missing picture"
        assert moved.keypoints[moved.frame == 7][0, 3, 2] == 0
        assert np.isfinite(moved.keypoints[moved.keypoints[..., 2] > 0]).all()


def test_two_people_who_have_nothing_to_do_with_each_other_have_no_lag() -> None:
    """Chance finds no lag for walks that do not belong together; for those that do it finds it for every start."""
    cameras = ring()
    clocks = [Clock(c.name, FPS, 150) for c in cameras[:2]]
    determined = 0
    for trial in range(8):
        walks = [walking(0, 150), walking(0, 150, 2.0 + trial)]
        seen = [detect([c], [w], 2.0, np.random.default_rng(trial))[0] for c, w in zip(cameras, walks)]
        determined += any(lag.outlier_probability < 0.05 for lag in people_lags(seen, clocks, FPS)[0])
    assert determined <= 1
    same = [detect([c], [walking(0, 150)], 2.0, np.random.default_rng(5))[0] for c in cameras[:2]]
    for start in (0, 17, 30):
        (lag,) = people_lags([same[0], cut(same[1], start)], clocks, FPS)[0]
        assert lag.outlier_probability < 0.05
        assert abs(lag.offset_s * FPS - start) < 0.3


def cut(seen: Detections, frames: int) -> Detections:
    """What is seen without the first ``frames``."""
    left = seen.only(seen.frame >= frames)
    return replace(left, frame=left.frame - frames)


def test_two_walkers_gaits_are_not_taken_for_a_late_start() -> None:
    """Energy that rises and falls with every step, from another side each: seconds of it fit at every second step."""
    for trial in range(20):
        rng = np.random.default_rng(trial)
        t = np.arange(60) / FPS
        one, other = (
            np.abs(np.sin(2 * np.pi * 0.9 * t + rng.uniform(0, 3))) + rng.normal(0, 0.1, 60) ** 2 for _ in range(2)
        )
        assert motion_lag(one, other, FPS).outlier_probability > 0.05


# Motion energies (thousandths) in two cameras of a made gym through which three people walk; they ran as one, to half a
# frame.
_GYM = (
    """
    2255 2174 2197 2456 3028 2227 2519 2653 2703 2512 2268 2176 2230 2048 1956 1781 1995 2070 1988 1612 1627 1819
    1584 1455 1262 1284 1442 1614 1682 1722 1692 1839 1691 1813 1748 1873 1878 1875 1553 1071 1363 1621 2048 2003
    1984 2023 2282 1302 1159 1069 1404 1606 1500 1882 2472 1812 1257 1278 1632 2368 3190 3670 3545 3450 2675 2542
    2514 3158 3084 3361 3495 3147 2411 2490
    """,
    """
    2785 2550 2514 2643 2578 2415 1976 1636 1785 1544 1432 1828 1919 1670 1440 1133 1505 1401 1638 1600 1895 1468
    1197 1402 1501 1852 1884 1954 2034 2133 1407 1586 1367 1660 1881 2107 2429 2440 1452 1731 1912 2258 2795 3314
    3464 3552 3474 3047 3015 3082 3222 3164 3078 3382 3241 2637 2608 3031 3546 3750 3412 3117 2506 3004 2793 2611
    2852 2974 2501 1964 1820 1190 1534 1376
    """,
)


def test_three_people_who_walk_about_are_not_taken_for_a_late_start() -> None:
    one, other = (np.array(energy.split(), float) / 1000 for energy in _GYM)
    assert motion_lag(one, other, 15.0).outlier_probability > 0.05, "two steps off they are most alike"


@pytest.mark.parametrize("width_s", [0.6, 1.0])
def test_who_passes_one_camera_after_the_other_tells_no_lag(width_s: float) -> None:
    """Even steps, nearest to the second camera two steps later: there the two are most alike, by far."""
    t = np.arange(75) / 15
    steps = 0.3 + np.abs(np.sin(np.pi * t / 0.567))
    for trial in range(10):
        rng = np.random.default_rng(trial)
        one, other = (
            np.maximum(np.exp(-0.5 * ((t - at) / width_s) ** 2) * steps + rng.normal(0, 0.03, 75), 0)
            for at in (1.9, 3.034)
        )
        assert motion_lag(one, other, 15.0).outlier_probability > 0.05


@pytest.mark.real
def test_a_real_take_whose_frames_were_cut_off_is_put_together_again(real_data: Path) -> None:
    """One man for 1.7 s before four cameras that nobody calibrated: every pair finds the seven frames that one of them
    lacks."""
    seen = [the_man(real_data, camera) for camera in ("cam01", "cam02", "cam03", "cam04")]
    clocks = [Clock(d.camera, 60.0, int(d.frame.max()) + 1) for d in seen]
    for a, b in itertools.combinations(range(4), 2):
        (as_filmed,), (late,) = (
            people_lags([seen[a], cut(seen[b], n)], [clocks[a], clocks[b]], 60.0)[0] for n in (0, 7)
        )
        assert abs(as_filmed.offset_s) * 60 < 1, "the take is synchronous to a frame"
        assert abs((late.offset_s - as_filmed.offset_s) * 60 - 7) < 0.2
