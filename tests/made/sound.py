# SPDX-License-Identifier: Apache-2.0
"""Made recordings: videos with sound whose every camera was started at another moment, runs at its own rate and hears
with its own ears."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from scipy import signal

RATE_HZ = 24000
_CLAP = 2000


def world_sound(kind: str, seconds: float, seed: int = 0) -> np.ndarray:
    """(N,) samples of what is to be heard in the room: "claps", one "clap" in the middle, "speech", a "hum" or
    "silence"."""
    rng, count = np.random.default_rng(seed), int(seconds * RATE_HZ)
    sound = np.zeros(count)
    if kind in ("claps", "clap"):
        times = np.cumsum(rng.uniform(0.7, 3.0, int(seconds))) if kind == "claps" else np.array([seconds / 2])
        for start in (times * RATE_HZ).astype(int):
            if start + _CLAP < count:
                sound[start : start + _CLAP] += rng.normal(size=_CLAP) * np.exp(-np.arange(_CLAP) / 200)
    elif kind == "speech":
        syllables = np.maximum(signal.lfilter([1], [1, -0.9994], rng.normal(size=count)), 0)
        sound = signal.lfilter([1], [1, -1.6, 0.8], rng.normal(size=count)) * syllables
    elif kind == "hum":
        times = np.arange(count) / RATE_HZ
        sound = sum(np.sin(2 * np.pi * 50 * k * times + k) / k for k in range(1, 30))
    return 0.5 * sound / max(float(np.abs(sound).max()), 1e-9)


@dataclass(frozen=True)
class Recorder:
    """A camera: it begins at ``start_s`` of the world's time, its second is longer by ``drift_ppm``; ``echo`` 0.4 is a
    bare room.

    ``muffled`` takes the high tones out, ``deaf``: without a sound track.
    """

    name: str
    start_s: float
    drift_ppm: float = 0.0
    fps: float = 30.0
    echo: float = 0.0
    noise: float = 0.002
    muffled: float = 0.0
    deaf: bool = False
    codec: str = "aac"

    def world_s(self, own_s: np.ndarray) -> np.ndarray:
        return self.start_s + own_s * (1 + 1e-6 * self.drift_ppm)


def received(recorder: Recorder, world: np.ndarray, seconds: float, seed: int = 0) -> np.ndarray:
    """(N,) samples that a recorder takes of the world's sound."""
    rng = np.random.default_rng([seed, len(recorder.name), *recorder.name.encode()])
    if recorder.echo:
        tail = rng.normal(size=int(0.3 * RATE_HZ)) * np.exp(-np.arange(int(0.3 * RATE_HZ)) / (0.06 * RATE_HZ)) / 8
        tail[: int(0.003 * RATE_HZ)] = 0
        world = signal.fftconvolve(world, np.concatenate([[1.0], recorder.echo * tail]))[: len(world)]
    times = recorder.world_s(np.arange(int(seconds * RATE_HZ)) / RATE_HZ)
    sound = np.interp(times * RATE_HZ, np.arange(len(world)), world, left=0, right=0)
    if recorder.muffled:
        sound = signal.lfilter([1 - recorder.muffled], [1, -recorder.muffled], sound)
    return (sound + recorder.noise * rng.normal(size=len(sound))).astype(np.float32)


def moving(times_s: np.ndarray, wh: tuple[int, int] = (64, 48), view: int = 0) -> np.ndarray:
    """(T, H, W, 3) uint8: a bright block that moves in fits and starts, the same for all views but for where it is
    seen."""
    rng = np.random.default_rng(7)
    knots = np.cumsum(rng.uniform(0.15, 0.8, 400))
    places = np.cumsum(rng.choice([-1.0, 0.0, 1.0], 400) * rng.uniform(15, 60, 400))
    at = np.interp(times_s, knots, places) * (1 + 0.1 * view)
    frames = np.full((len(times_s), wh[1], wh[0], 3), 40 + 10 * view, np.uint8)
    for frame, place in zip(frames, at):
        left = int(abs((place + 11 * view) % (2 * (wh[0] - 12)) - (wh[0] - 12)))
        frame[10:38, left : left + 12] = 220
    return frames


def record(
    folder: Path,
    recorder: Recorder,
    world: np.ndarray,
    seconds: float,
    frames: np.ndarray | None = None,
    own_s: Sequence[float] = (),
) -> Path:
    """Write ``folder``/name.mp4: a still grey film or ``frames``, at ``own_s`` or at the recorder's rate, with its
    sound."""
    count = len(own_s) or round(seconds * recorder.fps)
    frames = np.full((count, 32, 32, 3), 90, np.uint8) if frames is None else frames
    path = folder / f"{recorder.name}.{'mkv' if recorder.codec in ('flac', 'pcm_s16le') else 'mp4'}"
    folder.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        video = container.add_stream(
            "libx264", rate=Fraction(recorder.fps).limit_denominator(1001), options={"preset": "ultrafast"}
        )
        video.width, video.height, video.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        video.codec_context.time_base = Fraction(1, 90000)
        if not recorder.deaf:
            audio = container.add_stream(recorder.codec, rate=RATE_HZ, layout="mono")
            samples = received(recorder, world, seconds)
            step = 1024
            for begin in range(0, len(samples), step):
                piece = av.AudioFrame.from_ndarray(samples[None, begin : begin + step], format="fltp", layout="mono")
                piece.sample_rate, piece.pts, piece.time_base = RATE_HZ, begin, Fraction(1, RATE_HZ)
                container.mux(audio.encode(piece))
            container.mux(audio.encode(None))
        for k, frame in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame))
            picture.pts = round((own_s[k] if len(own_s) else k / recorder.fps) * 90000)
            picture.time_base = Fraction(1, 90000)
            container.mux(video.encode(picture))
        container.mux(video.encode(None))
    return path
