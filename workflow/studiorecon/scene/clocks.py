# SPDX-License-Identifier: Apache-2.0
"""One common clock for all cameras, and the video frame that shows each moment: ``clocks/clocks.json``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.scene.files import write_json
from studiorecon.scene.schema import ASCENDING, ListOf, MappingOf, frame_rate, real, record, seconds, text, whole
from studiorecon.scene.step_files import expect, read

if TYPE_CHECKING:
    from jaxtyping import Integer, Num

# Times closer than this share of a frame are equal: files round times to their time base.
_SAME_FRAMES = 1e-4
_FPS = frame_rate()
_CLOCK = {
    "camera": text(),
    "fps": _FPS,
    "frames": whole(low=0),
    "times_s": seconds("N", such=ASCENDING),
    "offset_s": seconds(),
    "drift_ppm": real(above=-1e6, high=1e6, unit="ppm"),
    "readout_s": seconds(low=-1, high=1),
}
_CLOCKS = {"fps": _FPS, "start_s": seconds(), "frames": whole(low=0), "refusal": text(), "cameras": ListOf(_CLOCK)}
_ESTIMATE = {"method": text(), "offset_s": seconds(), "half_s": seconds(low=0), "drift_ppm": real(unit="ppm")}
_FINDING = {
    **_ESTIMATE,
    "half_s": seconds(low=0, gaps=True),
    "camera": text(),
    "kind": text("reference", "in step", "found", "undetermined"),
    "reason": text(),
    "sentence": text(),
    "proposals": ListOf(_ESTIMATE),
    "without": MappingOf(text()),
}
_FINDINGS = {
    "sync": text(),
    "given": MappingOf(real(unit="frames")),
    "cameras": ListOf(_FINDING),
    "films": ListOf(text()),
}


@dataclass(frozen=True)
class Clock:
    """Times of one camera's frames on the common clock.

    Attributes:
        fps: frames per second by the camera's own clock.
        frames: number of frames of the footage.
        times_s: seconds of every frame after the first one where they are not evenly spaced; empty: frame k at k / fps.
        offset_s: common time of the first frame, seconds.
        drift_ppm: by how many millionths a second of this camera is longer than a common one.
        readout_s: seconds from the first row to the last, used to correct keypoints; 0: all rows at once.
    """

    camera: str
    fps: float
    frames: int
    times_s: tuple[float, ...] = ()
    offset_s: float = 0.0
    drift_ppm: float = 0.0
    readout_s: float = 0.0

    @property
    def own_s(self) -> Num[np.ndarray, " N"]:
        """Seconds of every frame after the first, by the camera's own clock."""
        return np.array(self.times_s) if self.times_s else np.arange(self.frames) / self.fps

    @property
    def common_s(self) -> Num[np.ndarray, " N"]:
        """Seconds on the common clock at which the middle rows of every frame were taken."""
        return self.offset_s + (1 + 1e-6 * self.drift_ppm) * self.own_s


@dataclass(frozen=True)
class Clocks:
    """All cameras on one clock, and the times of the scene: working frame w is at ``start_s`` + w / ``fps``.

    ``refusal`` is the reason why the footage cannot be used; empty when it can.
    """

    fps: float
    start_s: float
    frames: int
    cameras: tuple[Clock, ...]
    refusal: str = ""

    def of(self, camera: str) -> Clock:
        """The clock of one camera; raises KeyError when there is none of that name."""
        for clock in self.cameras:
            if clock.camera == camera:
                return clock
        raise KeyError(camera)

    def positions(self, camera: str) -> Num[np.ndarray, " N"]:
        """Position of every frame among the working frames: 3.4 is 0.4 frames after working frame 3."""
        exact = (self.of(camera).common_s - self.start_s) * self.fps
        whole = np.round(exact)
        return np.where(np.abs(exact - whole) < _SAME_FRAMES, whole, exact)

    def source_frames(self, camera: str) -> Integer[np.ndarray, " T"]:
        """The frame of the camera's footage nearest to every working frame; of two equally near ones the earlier."""
        position, wanted = self.positions(camera), np.arange(self.frames)
        after = np.clip(np.searchsorted(position, wanted), 1, max(len(position) - 1, 1))
        late = position[np.minimum(after, len(position) - 1)] - wanted
        return np.where(
            wanted - position[after - 1] <= late + _SAME_FRAMES, after - 1, np.minimum(after, len(position) - 1)
        )

    def late_frames(self, camera: str) -> Num[np.ndarray, " T"]:
        """Delay in working frames of the picture of every working frame; at most half a frame of its camera."""
        return self.positions(camera)[self.source_frames(camera)] - np.arange(self.frames)


@dataclass(frozen=True)
class ClockFinding:
    """What ``clocks.offsets`` measured of one camera.

    Attributes:
        camera, sentence: its name, and all estimates in words.
        people_s: by people, seconds of its first frame after the reference's and half of the 95 % interval; None
            without an estimate, and where other sources contradict it.
    """

    camera: str
    sentence: str
    people_s: tuple[float, float] | None


def write_clocks(path: Path, clocks: Clocks) -> None:
    write_json(path, asdict(clocks))


def read_clocks(path: Path) -> Clocks:
    """All cameras on one clock; raises UserError as ``step_files.read`` does."""
    return read(path, _CLOCKS, _clocks)


def read_clock_findings(path: Path) -> tuple[list[ClockFinding], list[str]]:
    """The findings on every camera's clock, and warnings of films that differ from the others; raises UserError as
    ``step_files.read`` does."""
    return read(path, _FINDINGS, lambda value: ([_finding(one) for one in value["cameras"]], list(value["films"])))


def _finding(value: dict[str, Any]) -> ClockFinding:
    by_method = {p["method"]: (p["offset_s"], p["half_s"]) for p in value["proposals"]}
    people_s = {"reference": (0.0, 0.0), "undetermined": None}.get(value["kind"], by_method.get("people"))
    return ClockFinding(value["camera"], value["sentence"], people_s)


def _clocks(value: dict[str, Any]) -> Clocks:
    cameras = [record(Clock, clock) for clock in value["cameras"]]
    for c in cameras:
        expect(len(c.times_s) in (0, c.frames), f"times_s of {c.camera} has {len(c.times_s)} of {c.frames} frames")
    expect(len({c.camera for c in cameras}) == len(cameras), "two cameras share a name")
    return record(Clocks, {**value, "cameras": cameras})
