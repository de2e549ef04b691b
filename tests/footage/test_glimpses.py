# SPDX-License-Identifier: Apache-2.0
"""A few pictures of a long video, sought from key frame to key frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import av
import av.filter
import numpy as np
import pytest
from studiorecon.footage import frames as footage
from studiorecon.footage.container import film_stream, open_container
from studiorecon.footage.frames import seek_frames
from studiorecon.footage.source import open_source
from studiorecon.footage.timing import shown_frames

FRAMES = 120


def written(path: Path, key_frames_every: int) -> Path:
    """Every picture has a grey level of its own."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"sc_threshold": "0"})
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 64, 48, "yuv420p", key_frames_every
        for k in range(FRAMES):
            picture = np.full((48, 64, 3), 2 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize("key_frames_every", [10, 50, 1000])
def test_the_frames_are_those_that_were_requested(tmp_path: Path, suffix: str, key_frames_every: int) -> None:
    source = open_source(written(tmp_path / f"a.{suffix}", key_frames_every), 30.0)
    wanted = [0, 0, 1, 37, 38, 51, 100, 119, 119, 500]
    found = [float(picture.mean()) / 2 for picture in seek_frames(source, wanted)]
    np.testing.assert_allclose(found, np.minimum(wanted, FRAMES - 1), atol=0.7)


def test_one_group_of_pictures_is_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And where there are many, none of those between."""
    searched: list[int] = []
    between = footage._key_frame_between

    def noted(stream: av.VideoStream, after: float, target: float) -> bool:
        searched.append(between(stream, after, target))
        return bool(searched[-1])

    monkeypatch.setattr(footage, "_key_frame_between", noted)
    for every, jumps in ((1000, [False] * 4), (10, [True] * 4)):
        searched.clear()
        seek_frames(open_source(written(tmp_path / f"{every}.mp4", every), 30.0), [0, 25, 50, 75, 100])
        assert searched == jumps


def test_colours_are_set_up_once_for_all_glimpses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The set-up of HDR's conversion takes as long as a hundred frames."""
    source = open_source(written(tmp_path / "a.mp4", 10), 30.0)
    assert source.form is not None
    colours = (("scale", "out_primaries=bt709:out_transfer=bt709:out_range=pc"), ("format", "pix_fmts=rgb24"))
    source = replace(source, form=replace(source.form, colours=colours))
    made: list[av.filter.Graph] = []
    graph = av.filter.Graph
    monkeypatch.setattr(av.filter, "Graph", lambda: made.append(graph()) or made[-1])
    assert len(seek_frames(source, [0, 37, 51, 119])) == 4
    assert len(made) == 1


def test_frames_that_no_other_needs_are_not_decoded_on_the_way(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mp4", 1000)
    last_s = open_source(path, 30.0).times_s[-1]
    with open_container(path) as container:
        stream = film_stream(container)
        assert stream.time_base is not None
        shown = [frame.time for frame in shown_frames(container, stream, needed=[round(last_s / stream.time_base)])]
    assert shown[-1] == pytest.approx(last_s)
    assert len(shown) < 0.7 * FRAMES
