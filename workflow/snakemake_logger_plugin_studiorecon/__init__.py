# SPDX-License-Identifier: Apache-2.0
"""Snakemake's logger plugin ``studiorecon`` (profiles/default switches it on; ``--logger`` names another): on a
terminal one bar at the bottom, with what runs and how long the rest may take; ``results/<scene>/progress.html``; and at
the end every warning once, and where the results are.

Steps write to the same terminal. They know from their environment (``progress.RUN``) that a bar is there: they put
their lines in its place, and it is drawn again below. Where standard error is no terminal, Snakemake's own lines stay
as they are.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import sys
import threading
import time
from collections import Counter
from dataclasses import astuple
from pathlib import Path

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent
from studiorecon.cli.run_progress import PROGRESS, Run, Running, read_seconds, record_seconds
from studiorecon.configuration.overlays import OVERLAY_OPTIONS, check_overlay, split_option
from studiorecon.errors import UserError
from studiorecon.pages.run_summary import closing_lines
from studiorecon.progress import CLEAR_LINE, RUN, wrap_on_terminal

_SECONDS = Path("timings/seconds.json")
_EVERY_S = 1.0  # between two pages
_DRAWN_EVERY_S = 0.2  # the bar, where a step put a line in its place
_NOTHING = "Nothing to be done"
_KILLED = re.compile(r"-m studiorecon ([a-z]+\.[a-z_]+) .*died with <Signals\.SIG(KILL|SEGV|ABRT|BUS)", re.DOTALL)
_HOW = {"KILL": "the system killed it, as it does", "BUS": "the system stopped it, as it does on a full disk or"}


class LogHandler(LogHandlerBase):
    """Follows one run through the events that Snakemake logs."""

    def __post_init__(self) -> None:
        # Snakemake reads these files before our Snakefile, and names none of them.
        try:
            for overlay in split_option(sys.argv, OVERLAY_OPTIONS)[0]:
                check_overlay(Path(overlay))
        except UserError as refusal:
            print(refusal, file=sys.stderr)
            raise SystemExit(1) from None
        self._run = Run({}, os.cpu_count() or 1, time.monotonic())
        self._order: list[str] = []
        self._scene, self._written_s, self._idle = "", 0.0, False
        self._ends, self._drawing = threading.Event(), threading.Lock()
        self._bar: threading.Thread | None = None
        if not self.common_settings.dryrun:
            os.environ[RUN] = "bar" if self.writes_to_stream else "lines"

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
        if record.getMessage().startswith(_NOTHING):
            self._idle = True
        if not self.writes_to_stream:
            return
        # Of what Snakemake itself says, trouble alone: the bar has the rest.
        own = "snakemake" not in Path(record.pathname).parts and getattr(record, "event", None) is None and record.msg
        if record.levelno >= logging.WARNING or own or record.getMessage().startswith(_NOTHING):
            self._print(self.format(record) if record.levelno >= logging.WARNING else record.getMessage())
        if self._run.total and self._bar is None:
            self._bar = threading.Thread(target=self._draw, daemon=True)
            self._bar.start()

    def _draw(self) -> None:
        """Draws the bar again and again, since steps write over it."""
        while not self._ends.wait(_DRAWN_EVERY_S):
            with self._drawing:
                line = self._run.bar(time.monotonic(), shutil.get_terminal_size().columns - 1)
                # The cursor goes back, so that what a library writes there does not stick to the bar's end.
                print(f"{CLEAR_LINE}{line}\r", end="", file=sys.stderr, flush=True)

    def _print(self, text: str) -> None:
        with self._drawing:
            print(f"{CLEAR_LINE if self.writes_to_stream else ''}{text}\n", end="", file=sys.stderr, flush=True)

    def _explain(self, record: logging.LogRecord) -> None:
        # A step that the system kills says nothing itself.
        if record.levelno >= logging.ERROR and (killed := _KILLED.search(record.getMessage())):
            why = (
                f"{killed.group(1)}: {_HOW.get(killed.group(2), 'a library gave up in the middle, as some do')} when "
                "memory runs out; run fewer jobs at once (--cores 1), or make pictures smaller (capture.width); what "
                "is finished is kept"
            )
            self._print(wrap_on_terminal(why))

    def _write_page(self, on: bool) -> None:
        # Not before a run is on: Snakemake imports its plugins at every start.
        from studiorecon.pages import run_page
        from studiorecon.scene.files import write_json

        run, now = self._run, time.monotonic()
        by_stage: dict[str, list[int]] = {stage: [0, 0] for stage in self._order}
        for rule, count in run.planned.items():
            if rule in ("all", "everything"):
                continue
            done_total = by_stage.setdefault(rule.partition("_")[0], [0, 0])
            done_total[0] += min(run.done[rule], count)
            done_total[1] += count
        stages = [run_page.Stage(name, *numbers) for name, numbers in by_stage.items() if numbers[1]]
        done, total = sum(s.done for s in stages), sum(s.total for s in stages)
        rest = run.left_in_words(now) if on else "finished" if done >= total else "stopped"
        folder = Path("results") / self._scene
        jobs = [f"{job.rule} {job.of}".strip() + f", since {now - job.since_s:.0f} s" for job in run.running.values()]
        text = run_page.write_page(
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
        about = {"scene": self._scene, "on": on, "pid": os.getpid(), "done": done, "total": total, "left": rest}
        about |= {"running": jobs if on else [], "failed": run.failed, "stages": [list(astuple(one)) for one in stages]}
        write_json(PROGRESS, about)

    def close(self) -> None:
        """Snakemake closes a handler, and Python does again when it ends."""
        if not self._ends.is_set() and not self.common_settings.dryrun:
            self._ends.set()
            os.environ.pop(RUN, None)
            if self._bar is not None:
                self._bar.join()
            ran = self._scene and self._run.total
            if ran:
                self._write_page(on=False)
                record_seconds(_SECONDS, self._scene, self._run.took)
            scene = self._scene if ran else os.environ.get("STUDIORECON_SCENE", "") if self._idle else ""
            if scene and (last := closing_lines(scene, set(self._run.done) if ran else None)):
                self._print(wrap_on_terminal(last))
            elif self._bar is not None:
                print(CLEAR_LINE, end="", file=sys.stderr, flush=True)
        super().close()
