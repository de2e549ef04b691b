# SPDX-License-Identifier: Apache-2.0
"""A small network that adds changes over time to colour and opacity of a person's Gaussians (paper, appendix D).

(Δc, Δα) = f(γ(μ), γ(t)): 8 layers of 256, the input joined again after layer 4, 63 + 21 inputs (``encoding``). The
residuals are added to the raw values: the constant harmonic and the logit opacity. The last layer starts at zero, so
the network starts without a jump (U48). The paper evaluates it at every Gaussian; with ``control`` it is evaluated at
some hundred points and interpolated. Matrices and gradients are written out here in fifty lines, so that no step needs
torch to draw a person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.arrays import require
from studiorecon.body.avatar.control_points import ControlPoints
from studiorecon.body.avatar.encoding import encode_position, encode_time, in_body_box
from studiorecon.scene.schema import Schema, flag, metres, real, whole

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num, Shaped

WIDTH, LAYERS, SKIP = 256, 8, 4
_POSITION_INPUTS, _TIME_INPUTS, _OUTPUTS = 63, 21, 4
_INPUTS = _POSITION_INPUTS + _TIME_INPUTS
_PAPERS = ("use_all_bands", "move_unseen")  # stored only when True
NETWORK: dict[str, Schema] = {
    "flat": real("P"),
    "shape": whole("3", low=1),
    "low_m": metres("3"),
    "high_m": metres("3"),
    "points_m": metres("M 3"),
    "near": whole("Q C", low=0),
    "shares": real("Q C"),
    **dict.fromkeys(_PAPERS, flag()),
}
"""What ``to_arrays`` holds; the last five only of some networks."""


@dataclass
class TemporalNetwork:
    """One person's network (U49: one each, so that people can be trained separately).

    Attributes:
        flat: all parameters as one float32 vector, so that an optimiser has one array to move.
        width, layers: units of a hidden layer, and hidden layers.
        low_m, high_m: opposite corners of the box that positions are normalised to (O01).
        frames: number of frames that time runs over.
        control: the points at which it is evaluated; None evaluates it at every Gaussian (paper).
        use_all_bands: whether to use time frequencies above what the frames can sample (paper).
        move_unseen: whether it also acts on Gaussians that no camera saw (paper).
    """

    flat: Float[np.ndarray, " P"]
    width: int
    layers: int
    low_m: Num[np.ndarray, " 3"]
    high_m: Num[np.ndarray, " 3"]
    frames: int
    control: ControlPoints | None = None
    use_all_bands: bool = False
    move_unseen: bool = False
    _kept: list[Float[np.ndarray, "M inputs"]] = field(default_factory=list, repr=False)
    _place: Float[np.ndarray, "M 63"] | None = field(default=None, repr=False)

    @classmethod
    def start(
        cls,
        low_m: Num[np.ndarray, " 3"],
        high_m: Num[np.ndarray, " 3"],
        frames: int,
        rng: np.random.Generator,
        width: int = WIDTH,
        layers: int = LAYERS,
        control: ControlPoints | None = None,
        use_all_bands: bool = False,
        move_unseen: bool = False,
    ) -> TemporalNetwork:
        """Random hidden layers (He), a last layer of zeros: all residuals are 0."""
        size = sum(rows * columns + columns for rows, columns in _shapes(width, layers))
        made = cls(
            np.zeros(size, np.float32),
            width,
            layers,
            np.asarray(low_m, np.float64),
            np.asarray(high_m, np.float64),
            frames,
            control,
            use_all_bands,
            move_unseen,
        )
        for weights, _ in made.matrices()[:-1]:
            weights[...] = rng.standard_normal(weights.shape) * np.sqrt(2 / len(weights))
        return made

    def matrices(
        self, flat: Float[np.ndarray, " P"] | None = None
    ) -> list[tuple[Float[np.ndarray, "inputs units"], Float[np.ndarray, " units"]]]:
        """Weights and biases of every layer as views of the parameters, or of ``flat``, a vector of the same size."""
        source, at, views = self.flat if flat is None else flat, 0, []
        for rows, columns in _shapes(self.width, self.layers):
            middle = at + rows * columns
            views.append((source[at:middle].reshape(rows, columns), source[middle : middle + columns]))
            at = middle + columns
        return views

    def residuals(
        self, means_m: Num[np.ndarray, "N 3"], frame: float
    ) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
        """Residuals of the constant harmonic and of the logit opacity, float32, at a possibly fractional frame.

        With control points they are those of the Gaussians the points were made for; ValueError for another number of
        those.
        """
        require("means_m", means_m, ("N", 3), finite=False)
        if self.control is None:
            out = self._evaluate(self._place_code(means_m), frame)
        else:
            require("means_m", means_m, (len(self.control.near), 3), finite=False)
            out = self.control.spread(self.at_points(frame))
        return out[:, :3], out[:, 3]

    def at_points(self, frame: float) -> Num[np.ndarray, "M 4"]:
        """Colour and logit residuals of the control points at a frame; ValueError without any."""
        if self.control is None:
            raise ValueError("this network has no control points: it is evaluated at every Gaussian")
        if self._place is None:
            self._place = self._place_code(self.control.points_m)
        return self._evaluate(self._place, frame)

    def _place_code(self, points_m: np.ndarray) -> np.ndarray:
        return encode_position(in_body_box(points_m, self.low_m, self.high_m))

    def _evaluate(self, place: np.ndarray, frame: float) -> np.ndarray:
        """(M, 4) colour and opacity residuals at positions with code (M, 63)."""
        code = np.empty((len(place), _INPUTS), np.float32)
        code[:, :_POSITION_INPUTS] = place
        at = float(np.clip(frame, 0, self.frames - 1))
        code[:, _POSITION_INPUTS:] = encode_time(at, self.frames, use_all_bands=self.use_all_bands)
        # One Gaussian with NaN must not spoil the gradient that all share.
        code[~np.isfinite(code).all(axis=1)] = 0
        self._kept, hidden = [code], code
        *inner, (weights, biases) = self.matrices()
        for k, (matrix, bias) in enumerate(inner):
            if k == SKIP + 1:
                hidden = self._kept[-1] = np.concatenate([code, hidden], axis=1)
            hidden = hidden @ matrix
            hidden += bias
            np.maximum(hidden, 0, out=hidden)
            self._kept.append(hidden)
        return hidden @ weights + biases

    def gradient(self, by_colour: Num[np.ndarray, "N 3"], by_logit: Num[np.ndarray, " N"]) -> Float[np.ndarray, " P"]:
        """Gradient by ``flat`` from those by the last ``residuals``; positions are constant, as in the predecessor."""
        found = np.empty_like(self.flat)
        back = np.empty((len(by_colour), _OUTPUTS), self.flat.dtype)
        back[:, :3], back[:, 3] = by_colour, by_logit
        if self.control is not None:
            back = self.control.gather_gradient(back).astype(self.flat.dtype, copy=False)
        back[~np.isfinite(back)] = 0
        # Gaussians that no camera sees have no gradient: about half of a body.
        taught = np.flatnonzero(back.any(axis=1))
        back = back[taught]
        layers = list(zip(self.matrices(), self.matrices(found), self._kept))
        for index, ((matrix, _), (by_matrix, by_bias), kept) in reversed(list(enumerate(layers))):
            fed = kept[taught]
            by_matrix[...], by_bias[...] = fed.T @ back, back.sum(axis=0)
            if index > 0:
                # The end of a layer's input is the previous layer's output; its rectifier passes no gradient where it
                # was 0.
                back = (back @ matrix[-self.width :].T) * (fed[:, -self.width :] > 0)
        return found

    def to_arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """The arrays to store in a file."""
        shape = np.array([self.width, self.layers, self.frames])
        own = {"flat": self.flat, "shape": shape, "low_m": self.low_m, "high_m": self.high_m}
        own |= {name: np.array(True) for name in _PAPERS if getattr(self, name)}
        return own | (self.control.to_arrays() if self.control else {})

    @classmethod
    def from_arrays(cls, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> TemporalNetwork:
        """The inverse of ``to_arrays``; raises ValueError for parameters of another size."""
        width, layers, frames = (int(n) for n in held["shape"])
        control, papers = ControlPoints.from_arrays(held), [name in held for name in _PAPERS]
        flat, box = np.ascontiguousarray(held["flat"]), (held["low_m"], held["high_m"])
        size = sum(rows * columns + columns for rows, columns in _shapes(width, layers))
        if flat.size != size:
            raise ValueError(f"network has {flat.size} parameters, expected {size}")
        return cls(flat, width, layers, *box, frames, control, use_all_bands=papers[0], move_unseen=papers[1])


def with_residuals(
    network: TemporalNetwork | None,
    seen: Bool[np.ndarray, " N"],
    means_m: Num[np.ndarray, "N 3"],
    colour: Num[np.ndarray, "N 1 3"],
    logits: Num[np.ndarray, " N"],
    frame: float,
) -> tuple[Num[np.ndarray, "N 1 3"], Num[np.ndarray, " N"]]:
    """Constant harmonics and logits with the residuals of ``network``, if any, on the ``seen`` Gaussians."""
    if network is None or not seen.any():
        return colour, logits
    more_colour, more_logit = network.residuals(means_m[seen], frame)
    colour, logits = colour.copy(), logits.copy()
    colour[seen, 0] += more_colour
    logits[seen] += more_logit
    return colour, logits


def _shapes(width: int, layers: int) -> list[tuple[int, int]]:
    inner = [(_INPUTS if k == 0 else width + (_INPUTS if k == SKIP + 1 else 0), width) for k in range(layers)]
    return [*inner, (width, _OUTPUTS)]
