# SPDX-License-Identifier: Apache-2.0
"""Snakemake's logger plugin ``studiorecon`` (profiles/default switches it on; ``--logger`` names another): on a
terminal one bar for the whole run with what runs and how long the rest may take, and ``results/<scene>/progress.html``.

Where standard error is no terminal, Snakemake's own lines stay as they are and the page alone is written.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import time
from collections import Counter
from pathlib import Path

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent
from studiorecon.cli.run_progress import Run, Running, keep_seconds, read_seconds
from tqdm import tqdm

_SECONDS = Path("timings/seconds.json")
_EVERY_S = 1.0  # between two pages
_KILLED = re.compile(r"-m studiorecon ([a-z]+\.[a-z_]+) .*died with <Signals\.SIG(KILL|SEGV|ABRT|BUS)", re.DOTALL)
_HOW = {"KILL": "the system killed it, as it does", "BUS": "the system stopped it, as it does on a full disk or"}


class LogHandler(LogHandlerBase):
    """Follows one run through the events that Snakemake logs."""

    def __post_init__(self) -> None:
        self._run = Run({}, os.cpu_count() or 1, time.monotonic())
        self._order: list[str] = []
        self._scene, self._written_s = "", 0.0
        self._bar: tqdm | None = None

    @property
    def writes_to_stream(self) -> bool:
        return sys.stderr.isatty() and not self.common_settings.dryrun

    @property
    def writes_to_file(self) -> bool:
        return False

    @property
    def has_filter(self) -> bool:
        return True

    @property
    def has_formatter(self) -> bool:
        return False

    @property
    def needs_rulegraph(self) -> bool:
        return False

    def emit(self, record: logging.LogRecord) -> None:
        if self.common_settings.dryrun:
            return
        try:
            self._follow(record)
            self._show(record)
            self._explain(record)
        except Exception:  # as every handler of the standard library: what cannot be logged does not stop a run
            self.handleError(record)

    def _follow(self, record: logging.LogRecord) -> None:
        event, said, now = getattr(record, "event", None), record.__dict__, time.monotonic()
        if event == LogEvent.RUN_INFO:
            counts = {str(rule): int(n) for rule, n in said["stats"].items() if rule != "total"}
            self._run.planned = Counter(counts) + self._run.done
        elif event == LogEvent.JOB_INFO:
            of = {str(name): str(value) for name, value in dict(said.get("wildcards") or {}).items()}
            scene = of.pop("scene", "")
            if scene and not self._scene:
                self._scene, self._run.seconds = scene, read_seconds(_SECONDS, scene)
            rule, threads = str(said["rule_name"]), int(said.get("threads") or 1)
            self._run.running[int(said["jobid"])] = Running(rule, ", ".join(of.values()), now, threads)
            if (stage := rule.partition("_")[0]) not in self._order:
                self._order.append(stage)
        elif event == LogEvent.JOB_FINISHED:
            self._run.finished(int(said["job_id"]), now)
        elif event == LogEvent.JOB_ERROR:
            self._run.stopped(int(said["jobid"]))
        else:
            return
        if self._scene and now - self._written_s >= _EVERY_S:
            self._write_page(on=True)
            self._written_s = now

    def _show(self, record: logging.LogRecord) -> None:
        if not self.writes_to_stream:
            return
        if record.levelno >= logging.WARNING:
            tqdm.write(self.format(record), file=sys.stderr)
        elif not self._run.total and getattr(record, "event", None) is None and record.msg:
            # Before a plan is there: what is decided, or that nothing is to be done.
            tqdm.write(record.getMessage(), file=sys.stderr)
        if not self._run.total:
            return
        if self._bar is None:
            self._bar = tqdm(
                total=0, file=sys.stderr, dynamic_ncols=True, bar_format="{n_fmt}/{total_fmt} |{bar:20}| {desc}"
            )
        self._bar.total, self._bar.n = self._run.total, sum(self._run.done.values())
        names = ", ".join(f"{job.rule} {job.of}".strip() for job in self._run.running.values())
        self._bar.set_description_str(f"{self._run.left_in_words(time.monotonic())}; {names}" if names else "")

    def _explain(self, record: logging.LogRecord) -> None:
        # A step that the system kills says nothing itself.
        if record.levelno >= logging.ERROR and (killed := _KILLED.search(record.getMessage())):
            tqdm.write(
                f"{killed.group(1)}: {_HOW.get(killed.group(2), 'a library gave up in the middle, as some do')} when "
                "memory runs out; run fewer jobs at once (--cores 1), or make pictures smaller (capture.width); what "
                "is finished is kept",
                file=sys.stderr,
            )

    def _write_page(self, on: bool) -> None:
        # Not before a run is on: Snakemake imports its plugins at every start.
        from studiorecon.pages import running

        run, now = self._run, time.monotonic()
        by_stage: dict[str, list[int]] = {stage: [0, 0] for stage in self._order}
        for rule, count in run.planned.items():
            if rule in ("all", "everything"):
                continue
            done_total = by_stage.setdefault(rule.partition("_")[0], [0, 0])
            done_total[0] += min(run.done[rule], count)
            done_total[1] += count
        stages = [running.Stage(name, *numbers) for name, numbers in by_stage.items() if numbers[1]]
        done, total = sum(s.done for s in stages), sum(s.total for s in stages)
        rest = run.left_in_words(now) if on else "finished" if done >= total else "stopped"
        folder = Path("results") / self._scene
        jobs = [f"{job.rule} {job.of}".strip() + f", since {now - job.since_s:.0f} s" for job in run.running.values()]
        text = running.written(
            folder,
            self._scene,
            f"{done} of {total} jobs, {rest}",
            f"Written at {time.strftime('%H:%M:%S')}; it loads itself again while the run is on.",
            stages,
            jobs if on else [],
            run.failed,
            on,
        )
        folder.mkdir(parents=True, exist_ok=True)
        partial = folder / ".progress.partial.html"
        partial.write_text(text, encoding="utf-8")
        partial.replace(folder / "progress.html")

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
        if self._scene and self._run.total and not self.common_settings.dryrun:
            self._write_page(on=False)
            keep_seconds(_SECONDS, self._scene, self._run.took)
            self._scene = ""  # a handler is closed by Snakemake, and again when Python ends
        super().close()
