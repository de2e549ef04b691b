# SPDX-License-Identifier: Apache-2.0
"""From light to 8-bit pictures: tone curve, planted exposure and white balance, planted noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.footage.video import to_bytes
from studiorecon.studio.description import Description

if TYPE_CHECKING:
    from jaxtyping import Float, Integer


@dataclass(frozen=True)
class Sensor:
    """One camera's electronics: ``gains`` on red, green and blue, and seeded noise in grey levels."""

    gains: tuple[float, float, float]
    noise_levels: float
    seed: tuple[int, ...]

    @staticmethod
    def perfect() -> Sensor:
        """Whether the sensor has no fault."""
        return Sensor((1.0, 1.0, 1.0), 0.0, (0,))


def camera_sensor(description: Description, name: str) -> Sensor:
    """The sensor of one camera; held-out cameras have no faults."""
    if name not in description.training:
        return Sensor.perfect()
    index = description.names.index(name)
    rng = np.random.default_rng([description.seed, 41])
    exposure, red, blue = rng.uniform(-1, 1, (len(description.training), 3))[index] * (
        description.faults.exposure,
        description.faults.white_balance,
        description.faults.white_balance,
    )
    gains = (float((1 + exposure) * (1 + red)), float(1 + exposure), float((1 + exposure) * (1 + blue)))
    return Sensor(gains, description.faults.noise_levels, (description.seed, 42, index))


def develop(radiance: Float[np.ndarray, "H W 3"], sensor: Sensor, frame: int) -> Integer[np.ndarray, "H W 3"]:
    """Picture of a radiance map: gamma 2.2, then the gains, then noise that depends on the frame number."""
    picture = np.clip(radiance.astype(np.float32), 0, 1) ** np.float32(1 / 2.2)
    picture = picture * np.asarray(sensor.gains, dtype=np.float32)
    if sensor.noise_levels > 0:
        rng = np.random.default_rng([*sensor.seed, frame])
        picture = picture + rng.normal(0, sensor.noise_levels / 255, picture.shape)
    return to_bytes(picture)
