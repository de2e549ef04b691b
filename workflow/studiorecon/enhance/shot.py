# SPDX-License-Identifier: Apache-2.0
"""``enhance.shot``: enhances one shot, picture by picture, with consistency injection, if it needs either
(``trial``)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from studiorecon.enhance.backends import ResidualTransfer, Unchanged, load_enhancer
from studiorecon.enhance.injection_settings import Carrying, Enhancing, Injecting
from studiorecon.enhance.photos import Training, TrainingFiles
from studiorecon.enhance.trial import decide_injection, flicker_increase, transfer_strength
from studiorecon.footage.stills import read_plate
from studiorecon.footage.streams import parallel_writers
from studiorecon.footage.video import read_frames, to_bytes, write_lossless, write_watchable
from studiorecon.models.protocols import Enhancer, Flow
from studiorecon.progress import progress, say, warn
from studiorecon.recursive.flows import load_flow
from studiorecon.recursive.injection import Injection
from studiorecon.recursive.sequence import adapt_injection, enhance_sequence, is_still
from studiorecon.scene.decisions import Decision, apply_forced, read_decisions, write_decisions
from studiorecon.scene.effects import ENHANCEMENT, FILMED, INJECTION, certain_decision, force, thresholds
from studiorecon.scene.path import PathStep, read_path
from studiorecon.scene.step_files import require
from studiorecon.signature import Place, Written

if TYPE_CHECKING:
    from jaxtyping import Integer

    Named = str
else:
    Named = Literal[tuple(effect.name for effect in FILMED)]


@dataclass(frozen=True)
class Settings(Enhancing, Carrying, Injecting):
    """Settings of enhancing a film, with the thresholds that ``survey.effects.EffectSettings`` declares."""

    thresholds: Mapping[Named, float] = thresholds(FILMED)
    force: Mapping[Named, str] = force(FILMED)

    def threshold(self, effect: str) -> float:
        """The threshold of one of the effects that are decided here."""
        return self.thresholds.get(effect) or next(one.threshold for one in FILMED if one.name == effect)


@dataclass(frozen=True)
class RenderedFilm:
    """A rendered film, or a part of it from picture ``first`` on; depth is unknown where ``truth`` says that pixels
    were never photographed."""

    steps: Sequence[PathStep]
    fps: float
    render: Path
    depth: Path
    truth: Path | None = None
    first: int = 0

    def pictures(self) -> Iterator[Integer[np.ndarray, "h w 3"]]:
        """Pictures, in order."""
        return self._read(self.render)

    def depths_mm(self) -> Iterator[Integer[np.ndarray, "h w"]]:
        """Uint16 millimetres, in order; 0 where unknown."""
        depths = self._read(self.depth)
        if self.truth is None:
            return depths
        return (np.where(level > 0, depth, 0) for depth, level in zip(depths, self._read(self.truth), strict=True))

    def segment(self, name: str) -> RenderedFilm:
        """One segment, whose pictures follow one another."""
        own = [k for k, step in enumerate(self.steps) if step.segment == name]
        return replace(self, steps=[self.steps[k] for k in own], first=own[0])

    def _read(self, film: Path) -> Iterator[np.ndarray]:
        return read_frames(film, self.first, self.first + len(self.steps))


@dataclass(frozen=True)
class RenderFiles:
    """A film with its path and depth, and, if a person is replaced, ``truth``: invented parts have no photo to correct
    them."""

    render: Path
    render_path: Path
    render_depth: Path
    truth: list[Path] = field(default_factory=list)

    def read(self) -> RenderedFilm:
        """The film, whose pictures are read when they are asked for."""
        steps, fps = read_path(self.render_path)
        return RenderedFilm(steps, fps, self.render, self.render_depth, self.truth[0] if self.truth else None)


def run(
    settings: Settings,
    shot: str,
    drawn: RenderFiles,
    photos: TrainingFiles,
    video: Written,
    film: Written,
    decisions: Written,
    edited: list[Path] | None = None,
    made: list[Path] | None = None,
    decided_before: list[Path] | None = None,
    only: list[str] | None = None,
    weights: Place = Path("resources/weights"),
    device: str = "cpu",
) -> None:
    """Enhance one shot, or ``only`` one segment of it; without ``train`` files the film stays as rendered.

    Decisions, which are about the whole film, and reasons are written to ``decisions``. An ``edited`` picture, if
    given, is a network's reference instead of the photos (paper: one edited reference). Films ``made`` of this shot
    before, by another tool or as its segments, follow one another as they are, with what was ``decided_before``.
    """
    source = drawn.read()
    decided: list[Decision] = []
    if made:
        say(f"shot {shot}: the pictures come from {', '.join(map(str, made))}")
        outputs = read_made_films(made, source.render, len(source.steps))
        decided = list(read_decisions(decided_before[0]).values()) if decided_before else []
    elif not photos.train:
        say(f"shot {shot}: the film is the render; enhance.enhancer is none and nothing is injected")
        left_out = [certain_decision(ENHANCEMENT, False, "enhance.enhancer is none")]
        left_out.append(certain_decision(INJECTION, False, "enhance.injection.history is 0"))
        outputs, decided = source.pictures(), apply_forced(left_out, settings.force)
    else:
        instead = to_bytes(read_plate(edited[0])[0]) if edited else None
        outputs, decided = enhance_film(settings, shot, source, photos.read(), instead, weights, device, only)
    write_decisions(decisions, decided)
    writers = (
        lambda frames: write_lossless(video, frames, source.fps),
        lambda frames: write_watchable(film, frames, source.fps),
    )
    with parallel_writers(writers) as put:
        for output in progress(outputs, " ".join(["pictures of", shot, *(only or [])]), total=len(source.steps)):
            put(output, output)


def enhance_film(
    settings: Settings,
    shot: str,
    drawn: RenderedFilm,
    training: Training,
    instead: Integer[np.ndarray, "h w 3"] | None,
    weights: Path,
    device: str,
    only: list[str] | None = None,
) -> tuple[Iterator[Integer[np.ndarray, "h w 3"]], list[Decision]]:
    """Uint8 pictures of the film, or of its segment ``only``, and the decisions about the whole film; a network gets
    ``instead`` as reference, or the photos."""
    enhancer, enhancement = choose_enhancer(settings, training, weights, device)
    say(f"shot {shot}: enhancement is {enhancement.verdict}; {enhancement.reason}")

    def reference(step: PathStep) -> np.ndarray:
        return training.reference(step.camera, training.nearest_frame(step.frame)) if instead is None else instead

    search = load_flow(settings.flow, settings.flow_preset, weights, device)
    injection, called = choose_injection(settings, drawn, reference, enhancer, search)
    drawn = drawn.segment(only[0]) if only else drawn
    say(f"shot {shot}: injection is {called.verdict}; {called.reason}")
    if isinstance(enhancer, Unchanged) and not injection.history:
        say(f"shot {shot}: the film is the render")
        return drawn.pictures(), [enhancement, called]
    outputs = enhance_sequence(drawn.steps, drawn.pictures(), drawn.depths_mm(), reference, enhancer, injection, search)
    return outputs, [enhancement, called]


def choose_enhancer(settings: Settings, training: Training, weights: Path, device: str) -> tuple[Enhancer, Decision]:
    """The enhancer of the film, and the decision: the selected network, or the residual transfer if it gains enough."""
    if settings.enhancer != "residual":
        on = settings.enhancer != "none"
        decision = certain_decision(ENHANCEMENT, on, f"enhance.enhancer is {settings.enhancer}")
        (decision,) = apply_forced([decision], _of(settings.force, ENHANCEMENT.name))
        decision = decision if on else no_enhancement(decision)
        name = settings.enhancer if decision.is_on else "none"
        return load_enhancer(name, weights, device, settings.seed), decision
    if settings.strength == "auto":
        strength, decision = transfer_strength(
            training, settings.judged_frames, settings.transfer, settings.threshold(ENHANCEMENT.name)
        )
    else:
        strength = float(settings.strength)
        decision = certain_decision(ENHANCEMENT, strength > 0, f"enhance.strength is {strength:g}")
    (decision,) = apply_forced([decision], _of(settings.force, ENHANCEMENT.name))
    decision = decision if strength else no_enhancement(decision)
    if not decision.is_on:
        return Unchanged(), decision
    latest = lru_cache(maxsize=1)(lambda frame: training.sources(frame, settings.transfer))
    return ResidualTransfer(lambda frame: latest(training.nearest_frame(frame)), strength, settings.transfer), decision


def no_enhancement(decision: Decision) -> Decision:
    """A decision against enhancement where there is nothing to add, even if it was forced: the film is the render."""
    if not decision.is_on:
        return decision
    reason = f"{decision.reason}, but there is nothing to add: choose enhance.enhancer, or a strength above 0"
    warn(f"enhancement is forced on: {reason}")
    return replace(decision, verdict="off", reason=reason)


def choose_injection(
    settings: Settings,
    drawn: RenderedFilm,
    reference: Callable[[PathStep], Integer[np.ndarray, "h w 3"]],
    enhancer: Enhancer,
    search: Flow,
) -> tuple[Injection, Decision]:
    """How earlier outputs enter later ones, and why: where enhanced pictures flicker more than renders do."""
    injection = adapt_injection(settings.injection, drawn.steps)
    if not injection.history:
        decision = certain_decision(INJECTION, False, "enhance.injection.history is 0")
    elif settings.force.get(INJECTION.name):
        decision = certain_decision(INJECTION, False, "not measured")
    elif isinstance(enhancer, Unchanged):
        decision = certain_decision(INJECTION, False, "nothing is enhanced, so nothing is added that could flicker")
    elif is_still(drawn.steps, drawn.pictures()):
        decision = certain_decision(INJECTION, False, "the camera does not move, so earlier outputs add nothing")
    else:
        change = flicker_increase(drawn.steps, drawn.render, drawn.depth, reference, enhancer, search)
        decision = decide_injection(change, settings.threshold(INJECTION.name))
    (decision,) = apply_forced([decision], _of(settings.force, INJECTION.name))
    return injection if decision.is_on else replace(injection, history=0), decision


def _of(verdicts: Mapping[str, str], effect: str) -> dict[str, str]:
    return {effect: verdicts[effect]} if effect in verdicts else {}


def read_made_films(films: Sequence[Path], render: Path, count: int) -> Iterator[Integer[np.ndarray, "h w 3"]]:
    """Pictures of films that were made of a shot's render, one after the other; UserError for another number or
    size."""
    (drawn,) = read_frames(render, 0, 1)
    number = 0
    for film in films:
        for picture in read_frames(film):
            require(film, picture.shape == drawn.shape, f"it has another size than {render}")
            number += 1
            if number <= count:
                yield picture
    require(films[-1], number == count, f"it has {number} pictures and {render} {count}")
