# SPDX-License-Identifier: Apache-2.0
"""Converts a film's stored frames to pictures as shown: one moment, BT.709 colours, square pixels, upright."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, cast

import av
import av.filter
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorTrc

if TYPE_CHECKING:
    from jaxtyping import Integer

_UPRIGHT = ((1, 0), (0, 1))
# No camera's pixels have a larger aspect; anamorphic lenses reach 2.
_MAX_ASPECT = 4
# Differ from BT.709 by less than cameras of one kind differ: SDR transfers, and primaries of television.
_SDR = {ColorTrc.BT709, ColorTrc.UNSPECIFIED, ColorTrc.GAMMA22, ColorTrc.GAMMA28, ColorTrc.SMPTE170M}
_SDR |= {ColorTrc.SMPTE240M, ColorTrc.IEC61966_2_4, ColorTrc.BT1361_ECG, ColorTrc.IEC61966_2_1}
_SDR |= {ColorTrc.BT2020_10, ColorTrc.BT2020_12}
_TELEVISION = {ColorPrimaries.BT709, ColorPrimaries.UNSPECIFIED, ColorPrimaries.BT470BG, ColorPrimaries.SMPTE170M}
_TELEVISION |= {ColorPrimaries.SMPTE240M, ColorPrimaries.EBU3213}
_HDR: dict[int, str] = {ColorTrc.SMPTE2084: "PQ", ColorTrc.ARIB_STD_B67: "HLG"}
_CONVERTED = {*_SDR, *_HDR, ColorTrc.LINEAR}


@dataclass(frozen=True)
class StoredFormat:
    """How a film's frames are stored.

    Attributes:
        wh, square_wh: size of the stored frames, and the same with square pixels.
        turn: the display matrix: x and y of a shown pixel in those of the stored one, each 1, −1 or 0.
        deinterlacing: libavfilter's filters, with arguments, that consecutive frames go through.
        colours: those that convert a frame's colours to BT.709.
    """

    wh: tuple[int, int]
    square_wh: tuple[int, int]
    turn: tuple[tuple[int, int], tuple[int, int]] = _UPRIGHT
    deinterlacing: tuple[tuple[str, str], ...] = ()
    colours: tuple[tuple[str, str], ...] = ()

    @property
    def shown_wh(self) -> tuple[int, int]:
        """Width and height as shown."""
        return self._turned(self.square_wh)

    @property
    def stored_wh(self) -> tuple[int, int]:
        """Width and height upright, with pixels as stored: the size in programs that ignore the aspect."""
        return self._turned(self.wh)

    @property
    def rotation_deg(self) -> int:
        """Counter-clockwise turn: 0, 90, 180 or 270; for a mirrored film, after mirroring."""
        (a, b), (c, d) = self.turn
        mirrored = a * d - b * c < 0
        return {(1, 0): 0, (0, -1): 90, (-1, 0): 180, (0, 1): 270}[(-a, -b) if mirrored else (a, b)]

    def pictures(self, frames: Iterable[av.VideoFrame]) -> Iterator[Integer[np.ndarray, "H W 3"]]:
        """Yields uint8 RGB as shown, from frames without fields; one call for all, because setting up takes seconds."""
        width, height = self.square_wh
        for frame in _through(self.colours, frames):
            if self.square_wh == self.wh:
                picture = frame.to_ndarray(format="rgb24")
            else:
                picture = frame.to_ndarray(format="rgb24", width=width, height=height, interpolation="BICUBIC")
            yield self.upright(picture)

    def upright(self, picture: Integer[np.ndarray, "H W ..."]) -> Integer[np.ndarray, "h w ..."]:
        """A stored picture turned upright."""
        (a, b), (c, d) = self.turn
        turned = picture if a else np.swapaxes(picture, 0, 1)
        return np.ascontiguousarray(turned[:: b + d, :: a + c]) if self.turn != _UPRIGHT else picture

    def without_fields(self, frames: Iterable[av.VideoFrame]) -> Iterator[av.VideoFrame]:
        """Yields consecutive frames of the stored size, each with its time, deinterlaced where they are not whole."""
        yield from _through(self.deinterlacing, frames)

    def _turned(self, wh: tuple[int, int]) -> tuple[int, int]:
        return wh if self.turn[0][0] else (wh[1], wh[0])


def stored_format(stream: av.VideoStream, first: av.VideoFrame) -> tuple[StoredFormat, tuple[str, ...]]:
    """How the frames of ``stream`` are stored, and sentences about their conversion."""
    wh, notes, deinterlacing = (first.width, first.height), [], []
    square_wh, about = _square(wh, stream.sample_aspect_ratio)
    notes += about
    turn, about = _display_matrix(first)
    notes += about
    if first.interlaced_frame:
        deinterlacing.append(("yadif", "deint=interlaced"))
        notes.append("it is interlaced: lines between the fields are interpolated, which blurs what moves")
    colours, about = _colours(first)
    return StoredFormat(wh, square_wh, turn, tuple(deinterlacing), tuple(colours)), (*notes, *about)


def _square(wh: tuple[int, int], aspect: Fraction | None) -> tuple[tuple[int, int], list[str]]:
    """The size with square pixels of ``wh`` pixels of that aspect, as players show it: with the stored height."""
    if not aspect or aspect <= 0:
        return wh, []
    named = f"{aspect.numerator}:{aspect.denominator}"
    if not 1 / _MAX_ASPECT <= aspect <= _MAX_ASPECT:
        return wh, [f"its header gives pixels of {named}, which no camera has: square ones are assumed"]
    square = (max(round(wh[0] * aspect), 1), wh[1])
    return square, [f"its pixels are {named}: {wh[0]}×{wh[1]} are shown as {square[0]}×{square[1]}"] * (square != wh)


def _display_matrix(frame: av.VideoFrame) -> tuple[tuple[tuple[int, int], tuple[int, int]], list[str]]:
    """ISO 14496-12's matrix without its offsets: (x', y') = (a x + c y, b x + d y), as ((a, b), (c, d))."""
    given = frame.side_data.get("DISPLAYMATRIX")
    if given is None:
        return _UPRIGHT, []
    matrix = np.frombuffer(cast("bytes", given), np.int32)[:9].reshape(3, 3)[:2, :2] / 65536.0
    scale = np.abs(matrix).max()
    signs = np.rint(matrix / scale).astype(int) if scale else np.eye(2, dtype=int)
    if sorted(np.abs(signs).sum(0)) != [1, 1] or sorted(np.abs(signs).sum(1)) != [1, 1]:
        return _UPRIGHT, ["its rotation tag is not a multiple of 90°: the pictures stay as stored"]
    (a, b), (c, d) = signs.tolist()
    return ((a, b), (c, d)), ["it is mirrored (rotation tag)"] * (a * d - b * c < 0)


def _colours(frame: av.VideoFrame) -> tuple[list[tuple[str, str]], list[str]]:
    transfer, primaries = int(frame.color_trc), int(frame.color_primaries)
    if transfer in _SDR and primaries in _TELEVISION:
        return [], []
    named = f"{_HDR.get(transfer) or _named(ColorTrc, transfer)} with primaries {_named(ColorPrimaries, primaries)}"
    if transfer not in _CONVERTED or primaries not in list(ColorPrimaries):
        return [], [f"its colours are {named}, which are not converted: it will differ in colour from other cameras"]
    # libswscale's own colour management: white of 203 cd/m² (BT.2408) becomes white, brighter values are clipped.
    clipped = "; colours brighter than white are clipped" * (transfer in _HDR)
    return [("scale", "out_primaries=bt709:out_transfer=bt709:out_range=pc"), ("format", "pix_fmts=rgb24")], [
        f"its colours are {named} and become BT.709{clipped}"
    ]


def _named(kind: type[ColorTrc] | type[ColorPrimaries], value: int) -> str:
    return next((member.name.replace("_", " ") for member in kind if member == value), f"number {value}")


def _through(filters: Sequence[tuple[str, str]], frames: Iterable[av.VideoFrame]) -> Iterator[av.VideoFrame]:
    """Yields the frames, all of one size and format, after libavfilter's ``filters``."""
    if not filters:
        yield from frames
        return
    graph: av.filter.Graph | None = None
    for frame in frames:
        if graph is None:
            graph = av.filter.Graph()
            steps = [
                graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
            ]
            steps += [graph.add(name, arguments) for name, arguments in filters]
            graph.link_nodes(*steps, graph.add("buffersink")).configure()
        graph.push(frame)
        yield from _pulled(graph)
    if graph is not None:
        graph.push(None)
        yield from _pulled(graph)


def _pulled(graph: av.filter.Graph) -> Iterator[av.VideoFrame]:
    while True:
        try:
            frame = graph.pull()
        except (av.BlockingIOError, av.EOFError):
            return
        assert isinstance(frame, av.VideoFrame)
        yield frame
