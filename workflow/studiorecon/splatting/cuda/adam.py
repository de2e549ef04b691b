# SPDX-License-Identifier: Apache-2.0
"""Adam over tensors of Gaussians, as ``train.optimiser``: only visible ones move, epsilon is relative, NaN is
skipped."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch

from studiorecon.splatting.train.schedule import BETA_1, BETA_2, EPSILON_MIN, EPSILON_STEPS

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer, Shaped


class Adam:
    """Moments of the fields of ``Gaussians``; higher harmonics have a rate and an epsilon of their own.

    Attributes:
        refused: () int64 tensor, gradient entries so far that were not finite.
    """

    def __init__(self, leaves: Mapping[str, torch.Tensor], epsilon: float) -> None:
        self._first = {name: torch.zeros_like(leaf) for name, leaf in leaves.items()}
        self._second = {name: torch.zeros_like(leaf) for name, leaf in leaves.items()}
        self._epsilon, self._steps = epsilon, 0
        self._squares: dict[str, torch.Tensor] = {}
        self._epsilons: dict[str, torch.Tensor] = {}
        self.refused = torch.zeros((), dtype=torch.int64, device=next(iter(leaves.values())).device)

    @torch.no_grad()
    def step(
        self,
        leaves: Mapping[str, torch.Tensor],
        rates: Mapping[str, float],
        rest_rate: float,
        bands: int,
        visible: torch.Tensor,
    ) -> None:
        """One step of the visible rows from the leaves' own gradients; of the harmonics the first ``bands`` move."""
        self._steps += 1
        for name, leaf in leaves.items():
            parts = (
                {name: (slice(None),)}
                if name != "sh"
                else {"sh": (slice(None), slice(0, 1)), "rest": (slice(None), slice(1, bands))}
            )
            for part, at in parts.items():
                if leaf[at].numel() and leaf.grad is not None:
                    self._step_part(
                        part,
                        leaf[at],
                        leaf.grad[at],
                        self._first[name][at],
                        self._second[name][at],
                        rest_rate if part == "rest" else rates[name],
                        visible,
                    )

    def _step_part(
        self,
        part: str,
        value: torch.Tensor,
        gradient: torch.Tensor,
        first: torch.Tensor,
        second: torch.Tensor,
        rate: float,
        visible: torch.Tensor,
    ) -> None:
        seen = visible.reshape(-1, *[1] * (value.ndim - 1))
        good = torch.isfinite(gradient)
        self.refused += (~good & seen).sum()
        gradient = torch.where(good & seen, gradient, 0.0)
        if self._steps <= EPSILON_STEPS:
            self._settle(part, gradient, value, seen)
        # In place on views of the whole tensors.
        first.copy_(torch.where(seen, torch.lerp(gradient, first, BETA_1), first))
        second.copy_(torch.where(seen, torch.lerp(gradient * gradient, second, BETA_2), second))
        unbiased = (second / (1 - BETA_2**self._steps)).sqrt_()
        value -= torch.where(
            seen, rate / (1 - BETA_1**self._steps) * first / (unbiased + self._epsilons.get(part, EPSILON_MIN)), 0.0
        )

    def _settle(self, part: str, gradient: torch.Tensor, value: torch.Tensor, seen: torch.Tensor) -> None:
        """Set epsilon × root mean square gradient of the first steps, by activated scale and opacity, as on the CPU."""
        if part == "log_scales":
            gradient = gradient / value.exp()
        elif part == "logit_opacities":
            opacity = torch.sigmoid(value)
            gradient = gradient / (opacity * (1 - opacity)).clamp_min(1e-30)
        rows = torch.nan_to_num(gradient).double().square().sum(0).flatten() / seen.sum().clamp_min(1)
        before = self._squares.get(part, torch.zeros_like(rows))
        if len(before) < len(rows):  # a higher degree of harmonics has begun to move
            before = torch.nn.functional.pad(before, (0, len(rows) - len(before)))
        self._squares[part] = before + rows
        typical = torch.sqrt(self._squares[part].max() / self._steps).float()
        self._epsilons[part] = (self._epsilon * typical).clamp_min(EPSILON_MIN)

    def arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """Moments, steps, epsilons and the count of refused entries, for a checkpoint."""
        kinds = {"first": self._first, "second": self._second, "squares": self._squares, "epsilon": self._epsilons}
        held = {
            f"{kind}.{name}": value.cpu().numpy() for kind, values in kinds.items() for name, value in values.items()
        }
        return {**held, "steps": np.array(self._steps), "refused": self.refused.cpu().numpy()}

    def resume(self, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Restore ``arrays``."""
        for kind, values in (
            ("first", self._first),
            ("second", self._second),
            ("squares", self._squares),
            ("epsilon", self._epsilons),
        ):
            values.clear()
            for name in (n for n in held if n.startswith(f"{kind}.")):
                values[name.removeprefix(f"{kind}.")] = torch.as_tensor(held[name], device=self.refused.device)
        self._steps = int(held["steps"])
        self.refused.fill_(int(held["refused"]))

    def regrow(self, parent: Integer[np.ndarray, " M"], fresh: Bool[np.ndarray, " M"]) -> None:
        """The moments of Gaussians that descend from ``parent``; ``fresh`` ones start without."""
        for moments in (self._first, self._second):
            for name, value in moments.items():
                taken = value[torch.as_tensor(parent, device=value.device)]
                taken[torch.as_tensor(fresh, device=value.device)] = 0
                moments[name] = taken
