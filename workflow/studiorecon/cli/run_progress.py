# SPDX-License-Identifier: Apache-2.0
"""The progress of a run: finished, running and remaining jobs, and an estimate of the remaining time.

The estimate comes from earlier jobs of each rule on this machine, corrected by the ratio for this run's finished jobs.
A rule that never ran here has no estimate, and the display says so.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from studiorecon.progress import shorten

PROGRESS = Path(".snakemake/progress.json")
"""The progress of the working folder's latest run, as the window reads it."""
REMEMBERED_JOBS = 12
"""Number of jobs of one rule and scene whose seconds are remembered."""
_ENOUGH = 0.9  # share of remaining jobs that need an estimate for a plain answer
_SURE_S = 20.0  # estimated seconds of finished work before this run's own pace counts


@dataclass(frozen=True)
class Running:
    """A running job: its rule, its subject (camera, person, film; empty for the scene), its start, its threads."""

    rule: str
    of: str
    since_s: float
    threads: int = 1


@dataclass
class Run:
    """One run; times are seconds of any steady clock.

    ``planned``, ``done``: jobs per rule. ``seconds``: rule → seconds of earlier jobs. ``cores``: number of cores.
    """

    seconds: Mapping[str, list[float]]
    cores: int
    started_s: float
    planned: Counter[str] = field(default_factory=Counter)
    done: Counter[str] = field(default_factory=Counter)
    running: dict[int, Running] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    took: dict[str, list[float]] = field(default_factory=dict)

    def finished(self, job: int, now_s: float) -> None:
        """Record a finished job; a job whose start was not recorded is ignored."""
        found = self.running.pop(job, None)
        if found:
            self.done[found.rule] += 1
            self.took.setdefault(found.rule, []).append(now_s - found.since_s)

    def stopped(self, job: int) -> None:
        """Record a failed job."""
        found = self.running.pop(job, None)
        if found:
            self.failed.append(f"{found.rule} {found.of}".strip())

    @property
    def total(self) -> int:
        return max(sum(self.planned.values()), sum(self.done.values()) + len(self.running))

    def guess_s(self, rule: str) -> float | None:
        """Estimated seconds of a job of a rule: from this run if it has any, else from earlier ones."""
        known = self.took.get(rule) or self.seconds.get(rule)
        return median(known) if known else None

    def pace(self) -> float:
        """Ratio of job times in this run to earlier ones; 1.0 while unknown."""
        before = after = 0.0
        for rule, took in self.took.items():
            if self.seconds.get(rule):
                before += len(took) * median(self.seconds[rule])
                after += sum(took)
        return after / before if before >= _SURE_S else 1.0

    def remaining(self, now_s: float) -> tuple[float, float]:
        """(seconds left, share of the remaining jobs with an estimate), over all cores; the longest job is a lower
        bound."""
        left: Counter[str] = Counter(self.planned)
        left.subtract(self.done)
        work = longest = 0.0
        jobs = known = 0
        for job in self.running.values():
            left[job.rule] -= 1
            jobs += 1
            guess = self._paced(job.rule)
            if guess is not None:
                known += 1
                own = max(guess - (now_s - job.since_s), 0.0)
                work, longest = work + own * min(job.threads, self.cores), max(longest, own)
        for rule, count in left.items():
            guess = self._paced(rule)
            jobs += max(count, 0)
            if guess is not None and count > 0:
                known += count
                work, longest = work + guess * count, max(longest, guess)
        return max(work / max(self.cores, 1), longest), known / jobs if jobs else 1.0

    def _paced(self, rule: str) -> float | None:
        guess = self.guess_s(rule)
        return guess if guess is None or self.took.get(rule) else guess * self.pace()

    def left_in_words(self, now_s: float) -> str:
        """The remaining time in words; a lower bound if rules have never run here."""
        seconds, share = self.remaining(now_s)
        if not share:
            return "time left not known yet"
        plain = f"{round(seconds / 60)} min" if seconds >= 90 else f"{max(round(seconds / 10) * 10, 10)} s"
        return f"{'about' if share >= _ENOUGH else 'at least'} {plain} left"

    def bar(self, now_s: float, columns: int) -> str:
        """One line of a terminal: progress, remaining time, and running jobs."""
        done, width = sum(self.done.values()), 20 if columns >= 100 else 10
        full = width * done // max(self.total, 1)
        names = ", ".join(f"{job.rule.replace('_', '.', 1)} {job.of}".strip() for job in self.running.values())
        words = f"{self.left_in_words(now_s)}; {names}" if names else "starting"
        return shorten(f"{done}/{self.total} {'█' * full}{'░' * (width - full)} {words}", columns)


def read_seconds(path: Path, scene: str) -> dict[str, list[float]]:
    """Rule → seconds of earlier jobs, of this scene if it has any, else of all scenes; empty for an unreadable file."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    found: dict[str, list[float]] = {}
    for rules in held.values():
        for rule, took in rules.items():
            found.setdefault(rule, []).extend(took)
    return {**found, **held.get(scene, {})}


def record_seconds(path: Path, scene: str, took: Mapping[str, list[float]]) -> None:
    """Add a run's seconds to the file, completely or not at all."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        held = {}
    own = held.setdefault(scene, {})
    for rule, seconds in took.items():
        own[rule] = [*own.get(rule, []), *(round(s, 1) for s in seconds)][-REMEMBERED_JOBS:]
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(held, sort_keys=True) + "\n", encoding="utf-8")
    partial.replace(path)
