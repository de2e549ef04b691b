# SPDX-License-Identifier: Apache-2.0
"""Working videos keep every bit, and broken ones are named."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from studiorecon.clocks.motion import motion_energy, motion_lag
from studiorecon.errors import UserError
from studiorecon.footage.container import open_container
from studiorecon.footage.streams import parallel_writers
from studiorecon.footage.video import (
    read_frame,
    read_frames,
    read_stack,
    to_bytes,
    to_float,
    write_lossless,
    write_watchable,
)
from studiorecon.images.regions import dilate


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((7, 5, 32, 3), np.uint8), ((3, 17, 9), np.uint8), ((4, 16, 10), np.uint16)],
    ids=["rgb", "grey", "grey16"],
)
def test_lossless_videos_keep_every_bit(tmp_path: Path, shape: tuple[int, ...], dtype: type) -> None:
    frames = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    assert write_lossless(tmp_path / "a.mkv", iter(frames), 29.97) == len(frames)
    np.testing.assert_array_equal(read_stack(tmp_path / "a.mkv"), frames)
    np.testing.assert_array_equal(read_frame(tmp_path / "a.mkv", 2), frames[2])


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    frames = np.random.default_rng(1).integers(0, 256, (5, 20, 30, 3), np.uint8)
    for name in ("a", "b"):
        write_lossless(tmp_path / f"{name}.mkv", iter(frames), 30)
    assert (tmp_path / "a.mkv").read_bytes() == (tmp_path / "b.mkv").read_bytes()


def test_a_failing_source_leaves_the_old_video(tmp_path: Path) -> None:
    frames = np.zeros((2, 8, 8, 3), np.uint8)
    write_lossless(tmp_path / "a.mkv", iter(frames), 30)
    before = (tmp_path / "a.mkv").read_bytes()

    def breaks():
        yield frames[0]
        raise UserError("the source broke")

    with pytest.raises(UserError, match="the source broke"):
        write_lossless(tmp_path / "a.mkv", breaks(), 30)
    assert (tmp_path / "a.mkv").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.mkv"]


def test_watchable_videos_keep_colours(tmp_path: Path) -> None:
    colours = np.array([[200, 40, 40], [40, 200, 40], [40, 40, 200], [128, 128, 128]], np.uint8)
    frame = np.repeat(np.repeat(colours.reshape(2, 2, 3), 32, axis=0), 32, axis=1)
    write_watchable(tmp_path / "a.mp4", iter([frame] * 3), 30, crf=4)
    back = read_frame(tmp_path / "a.mp4", 1)
    for row, column in ((16, 16), (16, 48), (48, 16), (48, 48)):
        np.testing.assert_allclose(back[row, column].astype(int), frame[row, column].astype(int), atol=4)


@pytest.mark.parametrize("suffix", [".mkv", ".mp4"])
def test_a_film_whose_title_is_not_utf_8_is_read(tmp_path: Path, suffix: str) -> None:
    # PyAV's own way with such a title changed with its version, and the argument that says so went with it.
    path = tmp_path / f"a{suffix}"
    with av.open(str(path), "w") as container:
        container.metadata["title"] = "Turnhalle Mxyller"
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))))
        container.mux(stream.encode(None))
    written = path.read_bytes()
    assert written.count(b"Mxyller") == 1
    path.write_bytes(written.replace(b"Mxyller", b"M\xff\xfeller"))
    with open_container(path) as container:
        assert container.metadata["title"].startswith("Turnhalle M")
    assert read_stack(path).shape == (1, 48, 64, 3)


def test_missing_truncated_and_short_videos_are_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"a\.mkv is missing"):
        next(read_frames(tmp_path / "a.mkv"))
    frames = np.random.default_rng(2).integers(0, 256, (20, 64, 64, 3), np.uint8)
    write_lossless(tmp_path / "a.mkv", iter(frames), 30)
    with pytest.raises(UserError, match="ends after 20 frames where 25 are needed"):
        list(read_frames(tmp_path / "a.mkv", 0, 25))
    (tmp_path / "b.mkv").write_bytes(b"not a video")
    with pytest.raises(UserError, match=r"b\.mkv cannot be read"):
        list(read_frames(tmp_path / "b.mkv"))


def test_bytes_and_floats_round_and_clamp() -> None:
    every = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(to_bytes(to_float(every)), every)
    np.testing.assert_array_equal(to_bytes(np.array([-1.0, 2.0, np.nan, 0.5])), [0, 255, 0, 128])


def test_a_film_whose_pictures_change_size_is_refused(tmp_path: Path) -> None:
    # The encoder would rescale the second picture without a word.
    with pytest.raises(ValueError, match="62×48 in a film of 64×48"):
        write_lossless(tmp_path / "a.mkv", [np.zeros((48, 64, 3), np.uint8), np.zeros((48, 62, 3), np.uint8)], 30.0)
    assert not list(tmp_path.iterdir())


def test_films_that_are_encoded_side_by_side_have_the_bytes_of_one_encoded_alone(tmp_path: Path) -> None:
    ramp, rng = np.linspace(0, 200, 96), np.random.default_rng(2)
    noise = rng.integers(0, 56, (70, 64, 96, 3))
    frames = np.stack([np.roll(ramp, 3 * t)[None, :, None] + noise[t] for t in range(70)]).astype(np.uint8)
    write_watchable(tmp_path / "alone.mp4", iter(frames), 30)
    alone = (tmp_path / "alone.mp4").read_bytes()
    for turn in range(3):
        paths = [tmp_path / f"{turn}.{side}.mp4" for side in "ab"]
        with parallel_writers([lambda film, p=p: write_watchable(p, film, 30) for p in paths]) as put:
            for frame in frames:
                put(frame, frame)
        assert all(path.read_bytes() == alone for path in paths)


def test_a_file_that_fails_as_it_is_closed_ends_the_films_beside_it(tmp_path: Path) -> None:
    """As on a full disk: the last frame is taken, and only then the encoder fails."""

    def closes_badly(frames: Iterator[np.ndarray]) -> None:
        for _ in frames:
            pass
        raise OSError(28, "No space left on device")

    def written(frames: Iterator[np.ndarray]) -> None:
        write_lossless(tmp_path / "film.mkv", frames, 10.0)

    def film() -> None:
        with parallel_writers([closes_badly, written]) as put:
            for _ in range(20):
                put(np.zeros((16, 16, 3), np.uint8), np.zeros((16, 16, 3), np.uint8))

    with pytest.raises(OSError, match="No space left"):
        film()


def test_what_the_disk_refuses_names_the_film_and_not_its_half_written_file(tmp_path: Path) -> None:
    script = """if True:
        import resource, sys
        import numpy as np
        from pathlib import Path
        from studiorecon.footage.exr import write_depth
        from studiorecon.footage.video import write_lossless
        noise = np.random.default_rng(0)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
        for make in (
            lambda: write_lossless(Path("film.mkv"), noise.integers(0, 256, (40, 64, 64, 3), dtype=np.uint8), 10.0),
            lambda: write_depth(Path("depth.exr"), *noise.random((2, 256, 256))),
        ):
            try:
                make()
            except OSError as error:
                print(error.errno, error.filename)
        print(sorted(path.name for path in Path().iterdir()))
    """
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, text=True, capture_output=True)
    assert done.stdout.split() == ["27", "film.mkv", "27", "depth.exr", "[]"], done.stderr


# ---- Hard cases of footage and masks, by their ids ----


@pytest.mark.parametrize("case", ["still", "steady", "short", "one-sided"], ids=lambda c: f"V07-{c}")
def test_clocks_that_cannot_be_compared_are_undetermined(case: str) -> None:
    # Naive: the best lag of a static scene lies near half a frame, because interpolation averages noise.
    rng = np.random.default_rng(7)
    if case == "still":
        frames = np.clip(100 + rng.normal(0, 1, (3, 60, 32, 48)), 0, 255).astype(np.uint8)
        energies = [np.array(list(motion_energy(f))) for f in frames]
    elif case == "steady":
        energies = [5 + rng.normal(0, 0.2, 60) for _ in range(3)]
    elif case == "short":
        energies = [np.abs(rng.normal(size=5)) for _ in range(3)]
    else:
        energies = [np.abs(rng.normal(size=60)), np.zeros(60), np.zeros(60)]
    for a, b in ((0, 1), (1, 2)):
        found = motion_lag(energies[a], energies[b], 30.0)
        assert found.outlier_probability > 0.05
        assert found.reason


@pytest.mark.parametrize("size", [21], ids=["U24"])
def test_the_paper_s_dilation_is_a_kernel_of_21(size: int) -> None:
    # Naive: radius 21 (kernel 43) eats four times the floor around the feet.
    region = np.zeros((64, 64), bool)
    region[32, 32] = True
    assert dilate(region, size).sum() == 441
