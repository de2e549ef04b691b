# SPDX-License-Identifier: Apache-2.0
"""Adam on the CPU, for arrays and for parameter blocks; ``cuda/adam`` is the same for tensors.

It differs from the textbook in three points, each because of a known failure (O04–O06). Gaussians that were not visible
keep their parameters and moments. Epsilon is relative to the typical gradient where a set is trained as blocks or
tensors, so that rounding noise does not become full steps. A gradient that is not finite counts as 0 and is reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.splatting.conventions import LANES, OPACITY, QUATERNION, ROWS, SCALE, SH
from studiorecon.splatting.cpu.adam import step_arrays, step_blocks
from studiorecon.splatting.train.schedule import BETA_1, BETA_2, EPSILON_MIN, EPSILON_STEPS
from studiorecon.splatting.train.state import TrainingState

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Integer, Shaped


class Adam:
    """Adam over named arrays, which ``step`` changes in place; ``refused`` counts gradient entries that were not
    finite.
    """

    def __init__(
        self,
        parameters: Mapping[str, Float[np.ndarray, " ..."]],
        betas: tuple[float, float] = (0.9, 0.999),
        epsilon: float = 1e-15,
    ) -> None:
        for name, value in parameters.items():
            if not value.flags.c_contiguous or value.dtype not in (np.float32, np.float64):
                raise ValueError(f"{name} must be a C-contiguous float array, to be updated in place")
        self.parameters = dict(parameters)
        self.refused = 0
        self._betas, self._epsilon = betas, epsilon
        self._moments = {
            name: (np.zeros_like(p).reshape(-1), np.zeros_like(p).reshape(-1)) for name, p in parameters.items()
        }
        self._steps = dict.fromkeys(parameters, 0)

    def arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """Parameters, moments, steps and the count of refused entries, for a checkpoint."""
        held = {f"parameter.{name}": value for name, value in self.parameters.items()}
        for name, (first, second) in self._moments.items():
            held |= {f"first.{name}": first, f"second.{name}": second, f"steps.{name}": np.array(self._steps[name])}
        return {**held, "refused": np.array(self.refused)}

    def resume(self, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Restore ``arrays``, in place."""
        for name, value in self.parameters.items():
            value[...] = held[f"parameter.{name}"]
            for moment, kind in zip(self._moments[name], ("first", "second")):
                moment[...] = held[f"{kind}.{name}"]
            self._steps[name] = int(held[f"steps.{name}"])
        self.refused = int(held["refused"])

    def regrown(
        self,
        parameters: Mapping[str, Float[np.ndarray, " ..."]],
        parent: Integer[np.ndarray, " M"],
        fresh: Bool[np.ndarray, " M"],
    ) -> Adam:
        """Adam over ``parameters`` with other rows: ``parent`` is each one's old row, ``fresh`` ones start without
        moments.
        """
        other = Adam(parameters, self._betas, self._epsilon)
        other.refused, other._steps = self.refused, dict(self._steps)
        for name, old in self._moments.items():
            for moment, new in zip(old, other._moments[name]):
                rows = moment.reshape(self.parameters[name].shape)[parent]
                rows[fresh] = 0
                new[:] = rows.reshape(-1)
        return other

    def step(
        self,
        gradients: Mapping[str, Float[np.ndarray, " ..."]],
        rates: Mapping[str, float],
        rows: Bool[np.ndarray, " N"] | None = None,
    ) -> None:
        """Move the parameters named in ``gradients`` by one step, or only their ``rows``; ValueError for another
        shape."""
        for name, gradient in gradients.items():
            parameter, (first, second) = self.parameters[name], self._moments[name]
            if gradient.shape != parameter.shape:
                raise ValueError(f"gradient of {name} has shape {gradient.shape}, expected {parameter.shape}")
            if rows is not None and rows.shape != parameter.shape[:1]:
                raise ValueError(f"rows has shape {rows.shape}, expected {parameter.shape[:1]} for {name}")
            self._steps[name] += 1
            corrections = tuple(1 - beta ** self._steps[name] for beta in self._betas)
            kind = parameter.dtype.type  # scalars of the array's own type: float32 stays float32 in the kernel
            width = max(1, parameter.size // max(1, len(parameter)))
            chosen = np.zeros(0, np.bool_) if rows is None else np.ascontiguousarray(rows, np.bool_)
            self.refused += step_arrays(
                parameter.reshape(-1),
                np.ascontiguousarray(gradient, parameter.dtype).reshape(-1),
                first,
                second,
                chosen,
                width,
                *(kind(x) for x in (rates[name], *self._betas, self._epsilon, *corrections)),
            )


class BlockAdam:
    """Adam of a set in parameter blocks; one epsilon for each kind of parameter, from the gradients of the first
    steps."""

    def __init__(self, epsilon: float) -> None:
        self.refused, self._steps, self._epsilon = 0, 0, epsilon
        self._squares, self._epsilons = np.zeros(ROWS), np.zeros(ROWS, np.float32)

    def step(
        self,
        state: TrainingState,
        gradient: Float[np.ndarray, " P"],
        visible: Integer[np.ndarray, " p"],
        rates: Float[np.ndarray, " 59"],
        degree: int,
        log_scale_max: float,
    ) -> None:
        """Move ``visible`` Gaussians by ``rates`` along ``gradient`` (blocks); harmonics above ``degree`` stay."""
        self._steps += 1
        if self._steps <= EPSILON_STEPS:
            self._settle_epsilons(gradient, visible)
        refused = np.empty(len(visible) // LANES, np.int32)
        step_blocks(
            state.blocked.parameters,
            state.raw,
            gradient,
            state.first,
            state.second,
            rates,
            self._epsilons,
            *(np.float32(x) for x in (BETA_1, BETA_2, 1 - BETA_1**self._steps, 1 - BETA_2**self._steps)),
            visible,
            SH + 3 * (degree + 1) ** 2,
            np.float32(log_scale_max),
            refused,
        )
        self.refused += int(refused.sum())

    def _settle_epsilons(self, by_blocks: np.ndarray, visible: np.ndarray) -> None:
        """Set, per kind of parameter, epsilon × root mean square gradient over the first steps."""
        shown, gradients = visible.reshape(-1, LANES) != 0, by_blocks.reshape(-1, ROWS, LANES)
        count = max(1, int(shown.sum())) * EPSILON_STEPS
        for row in range(ROWS):  # one at a time: all at once in float64 would be the largest thing in memory
            # One infinite gradient would make epsilon infinite and stop all further steps.
            seen = np.where(shown & np.isfinite(gradients[:, row]), gradients[:, row], 0).astype(np.float64)
            self._squares[row] += np.square(seen).sum() / count
        for begin, end in ((0, SCALE), (SCALE, QUATERNION), (QUATERNION, OPACITY), (OPACITY, SH), (SH, ROWS)):
            typical = np.sqrt(self._squares[begin:end].max() * EPSILON_STEPS / self._steps)
            self._epsilons[begin:end] = max(self._epsilon * typical, EPSILON_MIN)

    def arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """Epsilons, steps and the count of refused entries, for a checkpoint; the moments are in the state."""
        counts = {"steps": np.array(self._steps), "refused": np.array(self.refused)}
        return {"squares": self._squares, "epsilons": self._epsilons, **counts}

    def resume(self, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Restore ``arrays``."""
        self._squares, self._epsilons = held["squares"], held["epsilons"]
        self._steps, self.refused = int(held["steps"]), int(held["refused"])
