# SPDX-License-Identifier: Apache-2.0
"""The temporal network in a person's training: whether it is needed, its first step, and its optimiser (appendix D)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from studiorecon.body.avatar.temporal import TemporalNetwork, with_residuals
from studiorecon.configuration.setting import setting
from studiorecon.scene.decisions import Decision, from_entry
from studiorecon.splatting.train.optimiser import Adam

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Shaped


@dataclass(frozen=True)
class OverTime:
    """When and how appearance may change over time."""

    use: Literal["auto", "always", "never"] = setting(
        "auto",
        "Temporal network: colour and opacity independent of the pose; auto = where a tenth of the "
        "body changes colour.",
        paper="always, appendix D; U47 to U49",
        paper_value="always",
    )
    start: int = setting(
        450, "First step with the temporal network.", minimum=0, paper="3,000 of 10,000", paper_value=3000
    )
    width: int = setting(64, "Units of a hidden layer.", minimum=1, paper="256", paper_value=256)
    points: int = setting(
        512,
        "Body points where it is evaluated; 0 = every Gaussian, twice as slow.",
        minimum=0,
        paper="at every Gaussian",
        paper_value=0,
    )
    bands: Literal["below_nyquist", "all"] = setting(
        "below_nyquist",
        "Time frequencies of its input: those that the frames can represent, or all ten.",
        paper="all ten, appendix D",
        paper_value="all",
    )
    layers: int = 8
    rate: float = 0.0005


class Appearance:
    """Residuals of colour and opacity during training; zero until ``begin``.

    Attributes:
        network: the network in training; its last layer is zero until the first step.
        seen: the Gaussians it acts on: those that a camera saw; the paper evaluates it at all.
        decision: the measured decision whether the network is needed; None before it, and when none was required.
    """

    def __init__(
        self,
        settings: OverTime,
        network: TemporalNetwork,
        seen: Bool[np.ndarray, " N"],
        decide: Callable[[Callable], Decision],
    ) -> None:
        self.settings, self.network, self.seen = settings, network, seen
        self.decision: Decision | None = None
        self._judge, self._active = decide, False
        self._adam = Adam({"network": network.flat})

    @property
    def active_network(self) -> TemporalNetwork | None:
        """The network if it is used, else None."""
        return self.network if self._active else None

    def begin(self, draw: Callable) -> None:
        """Decide whether the network is used; ``draw`` renders a crop in its current state, (h, w, 3)."""
        if self.settings.use == "auto":
            self.decision = self._judge(draw)
        self._active = self.settings.use == "always" or (self.decision is not None and self.decision.is_on)

    def add_residuals(
        self,
        means_m: Float[np.ndarray, "N 3"],
        colour: Float[np.ndarray, "N 1 3"],
        logits: Float[np.ndarray, " N"],
        frame: int,
    ) -> tuple[Float[np.ndarray, "N 1 3"], Float[np.ndarray, " N"]]:
        """Constant harmonics and logit opacities of one frame, with residuals."""
        return with_residuals(self.active_network, self.seen, means_m, colour, logits, frame)

    def step(self, by_colour: Float[np.ndarray, "N 1 3"], by_logit: Float[np.ndarray, " N"]) -> None:
        """Move the network along gradients by the constant harmonics and logits of the last ``added`` frame."""
        if self._active:
            slope = self.network.gradient(by_colour[self.seen, 0], by_logit[self.seen])
            self._adam.step({"network": slope}, {"network": self.settings.rate})

    def facts(self) -> dict[str, Any]:
        """Whether the network is used, and the decision, for a checkpoint."""
        return {"active": self._active, "decision": asdict(self.decision) if self.decision else None}

    def resume_facts(self, facts: Mapping[str, Any]) -> None:
        """Restore ``facts``."""
        self._active, decision = facts["active"], facts["decision"]
        self.decision = from_entry(decision) if decision else None

    def arrays(self) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """The network and Adam's state, for a checkpoint."""
        return {f"network.{name}": value for name, value in self._adam.arrays().items()}

    def resume(self, held: Mapping[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Restore ``arrays``, in place."""
        self._adam.resume({n.removeprefix("network."): v for n, v in held.items() if n.startswith("network.")})
