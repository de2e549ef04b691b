# SPDX-License-Identifier: Apache-2.0
"""A clip through an enhancer, picture by picture, with earlier outputs injected into its input.

The feedback is the picture as stored, in eight bits. So a clip can be cut anywhere and continued from the stored
outputs of the K pictures before the cut, with the same bytes as one pass. Memory holds K pictures whatever the length
of the clip.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from studiorecon.errors import UserError
from studiorecon.footage.video import to_bytes, to_float
from studiorecon.images.flow import one_thread
from studiorecon.images.warp import warp
from studiorecon.models.protocols import Enhancer, Flow, Moment
from studiorecon.progress import say, warn
from studiorecon.recursive.alignment import Past, backward_flow
from studiorecon.recursive.injection import Injection, confidence, inject
from studiorecon.scene.path import PathStep

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Num

# Pictures that differ by less than this from the ones before them, in levels of 255 on average, make a static clip.
_STILL_LEVELS = 0.25

# Brightness that feedback may add before it is worth a warning: two levels of 255, half of what is seen side by side.
_MAX_SETTLED = 2 / 255
# Change of brightness, of 1, in the test of an enhancer's gain: no more than exposures differ.
_PROBE = np.float32(8 / 255)


def blend_history(
    picture: Integer[np.ndarray, "H W 3"], history: Sequence[Past], injection: Injection, search: Flow, pool: Executor
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"]] | None:
    """The enhancer's input with earlier pictures, latest first, and their share of it; None after a cut.

    A cut is where less than ``injection.cut_share`` of the picture matches the one before it. Every stored output is
    warped once, along the flow of the raw renders straight to it (U06, E08).
    """
    render = to_float(picture)
    flows = list(pool.map(lambda past: backward_flow(picture, past.render, search, injection.check), history))
    if flows and injection.check and flows[0][1].mean() < injection.cut_share:
        return None
    found = list(pool.map(partial(_align_output, render, injection), history, flows))
    return inject(render, [warped for warped, _ in found], [trust for _, trust in found], injection)


def enhance_sequence(
    steps: Sequence[PathStep],
    pictures: Iterable[Integer[np.ndarray, "H W 3"]],
    depths_mm: Iterable[Num[np.ndarray, "H W"]],
    reference: Callable[[PathStep], Integer[np.ndarray, "H W 3"]],
    enhancer: Enhancer,
    injection: Injection,
    search: Flow,
) -> Iterator[Integer[np.ndarray, "H W 3"]]:
    """The enhanced uint8 pictures, in order; history restarts with every segment of the path and every cut.

    Raises UserError for pictures of different sizes and for an enhancer whose outputs may not be fed back.
    """
    history: deque[Past] = deque(maxlen=injection.history)
    segment = None
    checked = False
    with one_thread(), ThreadPoolExecutor(max_workers=2) as pool:
        for number, (step, picture, depth_mm) in enumerate(zip(steps, pictures, depths_mm, strict=True)):
            photo = to_float(reference(step))
            depth_m = depth_mm.astype(np.float32) / 1000
            if not checked and injection.history:
                untouched = Moment(step.camera, step.frame, depth_m, np.zeros(depth_m.shape, np.float32))
                check_gain(loop_gain(enhancer, to_float(picture), photo, untouched), injection.strength)
                checked = True
            if step.segment != segment:
                history.clear()
                segment = step.segment
            if history and history[0].output.shape != picture.shape:
                old, new = (f"{shape[1]}x{shape[0]}" for shape in (history[0].output.shape, picture.shape))
                raise UserError(
                    f"picture {number} of segment {segment} is {new} and the one before it "
                    f"{old}; pictures of a clip have one size"
                )
            mixed = blend_history(picture, history, injection, search, pool)
            if mixed is None:
                say(f"picture {number} of segment {segment} follows a cut: injection restarts")
                history.clear()
                mixed = to_float(picture), np.zeros(depth_m.shape, np.float32)
            blended, injected = mixed
            moment = Moment(step.camera, step.frame, depth_m, injected)
            output = _finite(enhancer.enhance(blended, photo, moment), picture, step)
            history.appendleft(Past(to_float(output), picture))
            yield output


def adapt_injection(injection: Injection, steps: Sequence[PathStep]) -> Injection:
    """The injection for a film along ``steps``: with ``moving_strength`` if the camera moves or zooms within a
    segment."""
    for one, other in itertools.pairwise(steps):
        if one.segment == other.segment and not (
            np.array_equal(one.camera.camera_from_world, other.camera.camera_from_world)
            and np.array_equal(one.camera.intrinsics, other.camera.intrinsics)
        ):
            return replace(injection, strength=injection.moving_strength)
    return injection


def is_still(steps: Sequence[PathStep], pictures: Iterable[Integer[np.ndarray, "H W 3"]]) -> bool:
    """Whether no picture of a clip differs from the one before it in its segment, so that it cannot flicker."""
    earlier: tuple[str, np.ndarray] | None = None
    for step, picture in zip(steps, pictures):
        if (
            earlier is not None
            and (earlier[0], earlier[1].shape) == (step.segment, picture.shape)
            and np.abs(picture.astype(np.int16) - earlier[1]).mean() > _STILL_LEVELS
        ):
            return False
        earlier = step.segment, picture
    return True


def _align_output(
    render: np.ndarray, injection: Injection, past: Past, flow: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """An earlier output warped to the current picture, and its confidence there."""
    backward, valid = flow
    warped, inside = warp(past.output, backward)
    return warped, confidence(render, warped, inside & valid, injection)


def _finite(output: np.ndarray, picture: np.ndarray, step: PathStep) -> np.ndarray:
    """(H, W, 3) uint8: the output, as rendered where the enhancer's value is not finite."""
    bad = ~np.isfinite(output).all(axis=-1)
    if bad.any():
        warn(
            f"picture {step.frame:g} of {step.camera.name}: {int(bad.sum())} pixels not "
            "finite after the enhancer, left as rendered"
        )
    return np.where(bad[..., None], picture, to_bytes(np.where(bad[..., None], 0, output)))


def loop_gain(
    enhancer: Enhancer, render: Float[np.ndarray, "H W 3"], reference: Num[np.ndarray, "H W 3"], moment: Moment
) -> float:
    """The enhancer's gain on a change of brightness of a real render.

    It is the mean difference of the outputs for a slightly brighter and a slightly darker picture, relative to that of
    the inputs. On a flat field networks invent content.
    """
    darker, brighter = np.clip(render - _PROBE, 0, 1), np.clip(render + _PROBE, 0, 1)
    low, high = (enhancer.enhance(picture, reference, moment) for picture in (darker, brighter))
    known = np.isfinite(low) & np.isfinite(high)  # non-finite values stay as rendered
    answer = np.where(known, high, 0).astype(np.float64) - np.where(known, low, 0)
    given = np.where(known, brighter, 0).astype(np.float64) - np.where(known, darker, 0)
    return float(answer.sum() / given.sum()) if known.any() else float("nan")


def check_gain(gain: float, strength: float) -> None:
    """Raises UserError when outputs fed back with share ``strength`` would diverge (w·g ≥ 1).

    Else a film settles at (g − 1)/(1 − w·g) above its renders (E14), of which g − 1 is the enhancer's own; a visible
    rest is a warning.
    """
    answer = f"the enhancer multiplies a change of brightness by {gain:.3f}, so feeding its outputs back"
    remedy = "set enhance.injection.history to 0 or use another enhancer"
    if not np.isfinite(gain) or strength * gain >= 1:
        raise UserError(f"{answer} with share {strength} would change the film's brightness without end; {remedy}")
    added = (gain - 1) / (1 - strength * gain) - (gain - 1)
    if added > _MAX_SETTLED:
        warn(f"{answer} with share {strength} makes the film {added:.1%} brighter than without; {remedy}")
