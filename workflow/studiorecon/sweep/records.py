# SPDX-License-Identifier: Apache-2.0
"""Run records of a sweep: one line of JSON per configuration, failed ones included, after a line that says how many
there are."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from studiorecon.errors import UserError
from studiorecon.scene.files import write_text

FORMAT = "studiorecon sweep 1"
# What must agree for two records' seconds and metrics to stand in one picture.
_MUST_AGREE = ("scene", "machine", "versions")
OK, FAILED = "ok", "failed"


@dataclass(frozen=True)
class Record:
    """One configuration and what came of it.

    Attributes:
        name, parameter, preset: the row of the sweep's table; ``parameter`` is empty where several change.
        settings: dotted key → value, what differs from the configuration the sweep was started with.
        verdict: ok or failed; ``sentence`` says why it failed.
        metrics: measure → value, None where it was not measured (a failed run measures nothing).
        intervals: measure → [low, high], 95 % over frames.
        frames: camera → PSNR per frame, for paired differences.
        worst: worst camera and worst frame by PSNR.
        seconds: ``from_nothing`` (every job this result needs), ``marginal`` (those the base did not run), ``ran``
            (those nobody before ran), ``cpu`` (processor seconds of from_nothing, which other work on the machine
            disturbs less), ``wall`` (the clock, Snakemake's planning included), ``scoring`` (not part of the others).
        stages, ran_stages: stage → seconds, of from_nothing and of ran.
        peak_memory_mb: of the largest job.
        seeds: dotted key → seed.
        others_cores: cores that everything else on the machine kept busy during the run, in the mean; seconds beside
            much of that are no measurement.
        scored: what metrics were computed with; runs that differ in it are not comparable.
    """

    scene: str
    name: str
    parameter: str
    preset: str
    settings: Mapping[str, Any]
    verdict: str
    sentence: str
    metrics: Mapping[str, float | None]
    intervals: Mapping[str, Sequence[float] | None]
    frames: Mapping[str, Sequence[float | None]]
    worst: Mapping[str, Any]
    seconds: Mapping[str, float | None]
    stages: Mapping[str, float]
    ran_stages: Mapping[str, float]
    peak_memory_mb: float | None
    seeds: Mapping[str, int]
    others_cores: float
    machine: Mapping[str, Any]
    versions: Mapping[str, Any]
    scored: Mapping[str, Any] | None

    @property
    def total_s(self) -> float | None:
        """Seconds from nothing to the scored film."""
        return self.seconds.get("from_nothing")


def write_records(path: Path, table: str, records: Sequence[Record]) -> None:
    """Write all records of one sweep, completely or not at all."""
    head = {"format": FORMAT, "table": table, "records": len(records)}
    lines = [head, *(asdict(record) for record in records)]
    write_text(path, "".join(json.dumps(line, sort_keys=True, allow_nan=False) + "\n" for line in lines))


def read_records(path: Path) -> tuple[str, list[Record]]:
    """The table's name and the records of one sweep.

    UserError naming the file when it is missing, cut off, of another kind, or mixes scenes, machines, versions or ways
    of scoring.
    """
    if not path.is_file():
        raise UserError(f"{path} is missing; snakemake sweep makes it")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    entries = [_entry(path, number, line) for number, line in enumerate(lines, 1)]
    if not entries or entries[0].get("format") != FORMAT:
        raise UserError(f"{path} is not a sweep's records: its first line does not say {FORMAT!r}")
    head, bodies = entries[0], entries[1:]
    if len(bodies) != head.get("records"):
        raise UserError(
            f"{path} holds {len(bodies)} of {head.get('records')} records: it was "
            "cut off or edited; run the sweep again"
        )
    names = {field.name for field in fields(Record)}
    for number, body in enumerate(bodies, 2):
        if missing := sorted(names - set(body)):
            raise UserError(f"line {number} of {path} lacks {missing[0]}; run the sweep again")
    records = [Record(**{name: body[name] for name in names}) for body in bodies]
    _check_unmixed(path, records)
    return str(head.get("table", "")), records


def _entry(path: Path, number: int, line: str) -> dict[str, Any]:
    try:
        entry = json.loads(line)
    except json.JSONDecodeError as error:
        raise UserError(
            f"line {number} of {path} is not JSON ({error}): it was cut off or edited; run the sweep again"
        ) from None
    if not isinstance(entry, dict):
        raise UserError(f"line {number} of {path} is not a record; run the sweep again")
    return entry


def _check_unmixed(path: Path, records: Sequence[Record]) -> None:
    for record in records[1:]:
        for name in _MUST_AGREE:
            if getattr(record, name) != getattr(records[0], name):
                raise UserError(
                    f"{path} mixes runs of different {name} ({records[0].name} and "
                    f"{record.name}); run the sweep again in one go"
                )
    scored = [record for record in records if record.scored is not None]
    for record in scored[1:]:
        if record.scored != scored[0].scored:
            raise UserError(
                f"{path} mixes runs that were scored differently ({scored[0].name} and "
                f"{record.name}); run the sweep again"
            )
    names = [record.name for record in records]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UserError(f"{path} holds {twice[0]} twice: two sweeps were put together; give each its own file")
