# SPDX-License-Identifier: Apache-2.0
"""The pictures of a shot from its settings, with a path that avoids walls and furniture where its kind allows it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.render.composite import is_blocked
from studiorecon.render.keyframes import Spline, from_camera_to_camera, read_keys, spline_steps
from studiorecon.render.kinds import Heldout, read_film_settings
from studiorecon.render.look_at_targets import LookAtTargets
from studiorecon.render.moves import DollyZoom, Follow, Oscillate, dolly_zoom_steps, follow_steps, oscillate_steps
from studiorecon.render.orbit import Orbit, orbit_steps
from studiorecon.render.path_file import GivenPath, path_steps
from studiorecon.render.shots import all_frames_path, picture_size
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Float

# Factors on the distance to the subject for paths that are blocked, widest first.
_SHRINK = (1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)


def plan_steps(
    shot: str,
    shots: Mapping[str, Any],
    width: int,
    clearance_m: float,
    training: Sequence[Camera],
    held_out: Sequence[Camera],
    subjects: LookAtTargets,
    background: Gaussians,
) -> list[PathStep]:
    """The pictures of a shot; ``train`` and ``heldout`` show every frame, one segment per camera of their kind.

    Raises UserError for a shot that is not configured or cannot be made of these cameras and people.
    """
    if shot == "train":
        return all_frames_path(training, subjects.frames)
    if shot not in shots:
        raise UserError(f"there is no shot {shot!r} under render.shots; it names {', '.join(shots) or 'none'}")
    settings = read_film_settings(shots[shot], shot)
    if isinstance(settings, Heldout):
        if not held_out:
            raise UserError(
                f"shot {shot} shows the held-out cameras, but there are none; name some under held_out in capture.yaml"
            )
        return all_frames_path(held_out, subjects.frames)
    wh = picture_size(training, width)
    if isinstance(settings, Spline):
        keys = read_keys(settings.keys, shot) if settings.keys else from_camera_to_camera(training, shot)
        return spline_steps(keys, shot, training, subjects, wh)
    if isinstance(settings, GivenPath):
        return path_steps(settings, shot, wh, subjects.frames)
    if isinstance(settings, DollyZoom):
        return dolly_zoom_steps(settings, shot, training, subjects, wh)
    makers: dict[type, Callable] = {Orbit: orbit_steps, Oscillate: oscillate_steps, Follow: follow_steps}
    maker = makers[type(settings)]

    def steps(shrink: np.ndarray) -> list[PathStep]:
        return maker(settings, shot, training, subjects, wh, shrink)

    return clear_path(steps, settings.frames, shot, background, clearance_m)


def clear_path(
    path: Callable[[Float[np.ndarray, " pictures"]], list[PathStep]],
    pictures: int,
    shot: str,
    background: Gaussians,
    clearance_m: float,
) -> list[PathStep]:
    """A path that moves closer to its subject where it would pass within ``clearance_m`` of solid background.

    ``path`` makes the steps from a factor on the distance of each picture. If no factor gives a clear path, it keeps
    its full distance; the ledger of the shot says so (``render/statistics.py``).
    """
    inside = np.array([_blocked_steps(path(np.full(pictures, shrink)), background, clearance_m) for shrink in _SHRINK])
    clear = ~inside.all(axis=0)
    factors = np.where(clear, np.array(_SHRINK)[np.argmin(inside, axis=0)], 1.0)
    if inside[0].any():
        say(
            f"shot {shot} would pass within {clearance_m} m of walls or furniture in {inside[0].sum()} pictures; its "
            f"path is moved inwards there, by up to {100 - 100 * factors.min():.0f} %"
        )
    return path(smooth_dips(factors))


def smooth_dips(factors: Float[np.ndarray, " pictures"]) -> Float[np.ndarray, " pictures"]:
    """A smooth closed curve that never exceeds ``factors``, for a path around obstacles.

    The smallest factor within a fourteenth of the film on either side, then a Hann window of the same reach.
    """
    count = len(factors)
    reach = max(count // 14, 1)
    around = (np.arange(count)[:, None] + np.arange(-reach, reach + 1)) % count
    window = np.hanning(2 * reach + 3)[1:-1]
    return factors[around].min(axis=1)[around] @ (window / window.sum())


def _blocked_steps(steps: list[PathStep], background: Gaussians, clearance_m: float) -> np.ndarray:
    return is_blocked(np.array([step.camera.centre_m for step in steps]), background, clearance_m)
