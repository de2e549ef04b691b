# SPDX-License-Identifier: Apache-2.0
"""One Protocol per kind of upstream model, in this project's conventions.

Pictures are (H, W, 3) RGB, uint8 where a network reads files and float32 in [0, 1] where it improves renders; cameras
have OpenCV axes, intrinsics in pixels with centres at +0.5; depth is z-depth, 0 = unknown. An adapter converts a
network's other conventions in one place. A model is loaded once, when its adapter is created; long clips are iterators,
so memory does not grow with their length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Num, Shaped


@dataclass(frozen=True)
class Reconstruction:
    """Cameras and depth of some pictures of one moment, in one world of unknown unit unless ``metric``.

    Attributes:
        cameras: at the size the network worked on; the first one is the world's origin.
        depths, confidences: float32; 0 = unknown, and in [0, 1].
        focal_residuals_px: median distance of a pixel from the projection of its point by the fitted focal length.
    """

    cameras: Sequence[Camera]
    depths: Sequence[Float[np.ndarray, "H W"]]
    confidences: Sequence[Float[np.ndarray, "H W"]]
    focal_residuals_px: Sequence[float]
    metric: bool


@dataclass(frozen=True)
class Bodies:
    """People of one frame from a body estimator, in its camera's frame.

    Attributes:
        tracks: identity of each within its camera, 0-based.
        poses_rad: axis-angles, the root first.
        translations_m: SMPL's own, which is not the pelvis.
        joints_px: pixels, centres at +0.5.
        confidences: in [0, 1].
    """

    tracks: Integer[np.ndarray, " P"]
    shapes: Float[np.ndarray, "P 10"]
    poses_rad: Float[np.ndarray, "P 24 3"]
    translations_m: Float[np.ndarray, "P 3"]
    pelvises_m: Float[np.ndarray, "P 3"]
    joints_px: Float[np.ndarray, "P J 2"]
    confidences: Float[np.ndarray, " P"]


@dataclass(frozen=True)
class Moment:
    """Facts about one picture besides its colours.

    Attributes:
        frame: (fractional) frame of the capture it shows.
        depth_m: rendered depth, 0 = unknown.
        injected: share of the input that comes from earlier outputs, which were already enhanced.
    """

    camera: Camera
    frame: float
    depth_m: Float[np.ndarray, "H W"]
    injected: Float[np.ndarray, "H W"]


@dataclass(frozen=True)
class KeyFrame:
    """A photo that is warped into a generated film: ``camera`` at the network's size, colours in [0, 1], valid
    pixels."""

    camera: Camera
    rgb: Float[np.ndarray, "H W 3"]
    depth_m: Float[np.ndarray, "H W"]
    usable: Bool[np.ndarray, "H W"]


class PoseAndDepth(Protocol):
    """Estimates cameras and depth: Pi3, Pi3X."""

    def reconstruct(self, pictures: Sequence[Integer[np.ndarray, "H W 3"]], names: Sequence[str]) -> Reconstruction:
        """Cameras and depth of pictures (H, W, 3) uint8 of one moment."""
        ...


class MonocularDepth(Protocol):
    """Estimates depth of one picture: MoGe; or its inverse, up to scale and shift (kind "inverse depth")."""

    def depth(self, picture: Integer[np.ndarray, "H W 3"], focal_px: float | None) -> Float[np.ndarray, "H W"]:
        """Float32 depth (or inverse depth) of a uint8 picture, 0 = unknown; ``focal_px``: horizontal, if known."""
        ...


class PersonSegmenter(Protocol):
    """Segments people: SAM 3."""

    def segment(self, frames: Iterable[Integer[np.ndarray, "H W 3"]]) -> Iterator[Integer[np.ndarray, "H W"]]:
        """Uint16 per uint8 frame: 0 = nobody, else 1 + the person's number, the same through the clip."""
        ...


class BodyEstimator(Protocol):
    """Estimates bodies: CoMotion."""

    layout: str
    """The layout of its 2D points: a name of ``keypoints.layouts``."""

    @staticmethod
    def read_stored(rows: Mapping[str, Shaped[np.ndarray, " ..."]], where: str) -> list[tuple[int, Bodies]]:
        """(frame, bodies) from a file of the network's arrays, called ``where``; raises UserError for missing ones."""
        ...

    def bodies(
        self, frames: Iterable[Integer[np.ndarray, "H W 3"]], intrinsics: Num[np.ndarray, "3 3"]
    ) -> Iterator[Bodies]:
        """The people of each uint8 frame of one calibrated camera."""
        ...


class ViewSynthesizer(Protocol):
    """Generates views: GEN3C.

    A request consists of arrays in the network's own names and conventions. Stages use ``w2cs_all`` (T, 4, 4), one per
    requested view, and ``scene_scale``, the factor on all lengths. Requests are made and checked without the network:
    on another machine, before a GPU is reserved.
    """

    hw: tuple[int, int]
    """The only size of its pictures."""
    most_key_frames: int
    """Most photos at once, limited by its job's main memory."""

    @staticmethod
    def request(key_frames: Sequence[KeyFrame], path: Sequence[Camera]) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """The request for a film along ``path`` from photos; raises UserError for a path that it cannot follow."""
        ...

    @staticmethod
    def check(request: dict[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Raises ValueError for a request that the network would misread."""
        ...

    @staticmethod
    def evidence(request: dict[str, Shaped[np.ndarray, " ..."]]) -> str:
        """The result of re-rendering a checked request, in a sentence; raises UserError when it is not worth a GPU."""
        ...

    def views(self, request: dict[str, Shaped[np.ndarray, " ..."]]) -> Iterator[Integer[np.ndarray, "t H W 3"]]:
        """Parts of the requested film, in order."""
        ...


class Enhancer(Protocol):
    """Improves a rendered picture with a real photo for reference: Difix3D+, Fixer, embedded residual transfer."""

    def enhance(
        self, image: Float[np.ndarray, "H W 3"], reference: Num[np.ndarray, "h w 3"], moment: Moment
    ) -> Float[np.ndarray, "H W 3"]:
        """The enhanced float32 picture of ``image``; ``reference`` is a photo of the same time."""
        ...


class Flow(Protocol):
    """Estimates optical flow: RAFT."""

    def flow(
        self, first: Integer[np.ndarray, "H W 3"], second: Integer[np.ndarray, "H W 3"]
    ) -> Float[np.ndarray, "H W 2"]:
        """Float32 flow from the first to the second uint8 picture: p of the first shows the same as p + flow(p)."""
        ...


SMALLEST_MEASURED_PX = 64
"""Side of a picture below which LPIPS is not measured."""


class PerceptualDistance(Protocol):
    """LPIPS as a measure."""

    def measure(self, prediction: Integer[np.ndarray, "H W 3"], truth: Integer[np.ndarray, "H W 3"]) -> float | None:
        """The distance of two (H, W, 3) uint8 pictures; None when a side is under ``SMALLEST_MEASURED_PX``."""
        ...


class CanonicalAvatar(Protocol):
    """Makes a person's Gaussians in a rest pose from one photo: LHM."""

    def avatar(self, photo: Integer[np.ndarray, "H W 3"], mask: Bool[np.ndarray, "H W"]) -> Gaussians:
        """Gaussians in the body's rest pose and axes (x left, y up, z forward), from a uint8 photo and a mask."""
        ...
