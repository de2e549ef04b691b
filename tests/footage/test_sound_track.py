# SPDX-License-Identifier: Apache-2.0
"""Which of a film's sound tracks is heard."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from studiorecon.footage.sound_track import RATE_HZ, read_sound

TONES_HZ = (300, 700)


def with_two_tones(path: Path) -> Path:
    """Two seconds with a track of either tone."""
    tones = [np.sin(2 * np.pi * hz * np.arange(2 * RATE_HZ) / RATE_HZ).astype(np.float32) for hz in TONES_HZ]
    with av.open(str(path), "w") as container:
        for stream, tone in [(container.add_stream("aac", rate=RATE_HZ, layout="mono"), tone) for tone in tones]:
            for begin in range(0, 15 * 1024, 1024):
                piece = av.AudioFrame.from_ndarray(tone[None, begin : begin + 1024], format="fltp", layout="mono")
                piece.rate, piece.pts = RATE_HZ, begin
                container.mux(stream.encode(piece))
            container.mux(stream.encode(None))
    return path


def heard_hz(path: Path) -> float:
    samples = read_sound(path)
    assert samples is not None
    return float(np.argmax(np.abs(np.fft.rfft(samples))) * RATE_HZ / len(samples))


@pytest.mark.filterwarnings("ignore")
def test_the_second_track_is_heard_where_the_first_cannot_be_decoded(tmp_path: Path) -> None:
    path = with_two_tones(tmp_path / "a.mkv")
    assert heard_hz(path) == pytest.approx(TONES_HZ[0], abs=5)
    path.write_bytes(path.read_bytes().replace(b"A_AAC", b"A_XYZ", 1))
    assert heard_hz(path) == pytest.approx(TONES_HZ[1], abs=5)
