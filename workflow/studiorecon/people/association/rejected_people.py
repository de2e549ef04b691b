# SPDX-License-Identifier: Apache-2.0
"""Reports people whom association left out although two cameras saw them for a while, with the lines that accept
them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from studiorecon.people.association.grouping import Group
from studiorecon.people.association.terms import Term, strongest_objections, total_nats
from studiorecon.progress import say, warn
from studiorecon.scene.camera import Camera

# Two cameras must have agreed for so long, seconds, or for half of a clip shorter than twice that.
_LONG_S = 1.0
# Within so many nats of 0 a person may have been left out.
_REACH_NATS = 2.0
# At most so many lines for identities.tsv are logged; the page has them all.
_SAID = 12


@dataclass(frozen=True)
class RejectedPerson:
    """A group that was rejected as a person of this scene.

    Attributes:
        name: ``r0``, ``r1``, …, the likeliest first.
        frames: number of those frames; seconds: the same in time.
        cameras: names of those that see it; tracks: (camera, track id) of all of them.
        confidence: share of its keypoints that agree; nats: log-likelihood ratio of a person to nobody.
        reason: why it is left out, as the end of a sentence.
    """

    name: str
    frames: int
    seconds: float
    cameras: tuple[str, ...]
    tracks: tuple[tuple[str, int], ...]
    confidence: float
    nats: float
    reason: str

    def row(self) -> tuple[str, int, str, float, str, str, str]:
        """The line of people.tsv."""
        return (self.name, self.frames, ",".join(self.cameras), self.confidence, "keypoints", "rejected", self.reason)

    def lines(self, person: str) -> list[str]:
        """The lines of identities.tsv that make it ``person``."""
        return [f"{camera}\t{track}\t{person}" for camera, track in self.tracks]

    def as_json(self, person: str) -> dict[str, Any]:
        """The group's data for the identity page, with the lines that make it ``person``."""
        described = {"name": self.name, "seconds": self.seconds, "cameras": self.cameras, "reason": self.reason}
        return described | {"tracks": self.tracks, "lines": self.lines(person)}


def list_rejected(
    rejected: Sequence[tuple[Group, Sequence[Term]]], cameras: Sequence[Camera], frames: int, fps: float
) -> list[RejectedPerson]:
    """The rejected groups, with reasons, the likeliest first: those on which two cameras agreed for a second, or half
    of a shorter clip, or near 0 nats, without duplicates of accepted people."""
    lasting = min(_LONG_S * fps, frames / 2)
    listed = [
        (total_nats(own), group, own)
        for group, own in rejected
        if not any(term.name == "overlap" for term in own)
        and (len(group.frames) >= lasting or total_nats(own) > -_REACH_NATS)
    ]
    return [
        RejectedPerson(
            f"r{n}",
            len(group.frames),
            len(group.frames) / fps,
            tuple(group.seen_by(cameras)),
            tuple((cameras[v].name, t) for v, t in group.members),
            group.confidence,
            nats,
            strongest_objections(own),
        )
        for n, (nats, group, own) in enumerate(sorted(listed, key=lambda one: (-one[0], one[1].members)))
    ]


def report_rejected(those: Sequence[RejectedPerson], next_person: str) -> None:
    """Log the rejected groups with their reasons, and the lines that accept each of them as ``next_person``."""
    for one in those:
        lines = one.lines(next_person)
        warn(
            f"left out: {one.name}, seen by {', '.join(one.cameras)} for {one.seconds:.1f} s: {one.reason}. To "
            "accept this person, copy people/identities.tsv into the dataset folder and replace these lines of the "
            "same tracks:"
        )
        more = [f"and {len(lines) - _SAID} more lines, listed in people/review.html"] * (len(lines) > _SAID)
        for line in [*lines[:_SAID], *more]:
            say(line)
