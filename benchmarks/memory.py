# SPDX-License-Identifier: Apache-2.0
"""The memory that each rule took in a finished run, for the test that compares it with the rule's request.

    python -m benchmarks.memory FOLDER SCENE NAME [PRESET …]

FOLDER is where snakemake ran. Writes the peak of every rule's largest job, megabytes, under NAME into
``benchmarks/results/memory.json``, with the names of the presets that it ran with.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from studiorecon.report.sections.cost import read_benchmark
from studiorecon.scene.files import read_json, write_json

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).parent / "results" / "memory.json"


def submitted() -> dict[str, str]:
    """Text of every rule that is a job of its own, by name; of a rule that uses another, both rules' texts."""
    found: dict[str, str] = {}
    for path in sorted((ROOT / "workflow/rules").glob("*.smk")):
        for block in re.split(r"\n(?= *(?:(?:use )?rule|checkpoint) )", path.read_text(encoding="utf-8")):
            again = re.match(r" *use rule (\w+) as (\w+) with:", block)
            if again:
                found[again.group(2)] = block + found[again.group(1)]
            named = re.match(r" *(?:rule|checkpoint) (\w+):", block)
            if named and "shell:" in block and "localrule: True" not in block:
                found[named.group(1)] = block
    return found


def peaks_mb(folder: Path, scene: str) -> dict[str, int]:
    """Rule → peak memory of its largest job in ``folder/timings``; rules that ran no job are left out."""
    timed = {path: str(path.relative_to(folder)) for path in (folder / "timings" / scene).rglob("*.tsv")}
    found = {}
    for rule, block in submitted().items():
        named = re.search(r'benchmark:\s+"(.+)"', block)
        if not named:
            continue
        # A segment is a number, so that views/00.tsv is not taken for views/path.tsv.
        pattern = re.escape(named.group(1)).replace(r"\{scene\}", re.escape(scene)).replace(r"\{segment\}", r"\d+")
        pattern = re.sub(r"\\{\w+\\}", "[^/]+", pattern)
        jobs = [read_benchmark(path)["peak_memory_mb"] for path, name in timed.items() if re.fullmatch(pattern, name)]
        if known := [peak for peak in jobs if peak is not None]:
            found[rule] = round(max(known))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("scene")
    parser.add_argument("name")
    parser.add_argument("presets", nargs="*")
    given = parser.parse_args()
    peaks = peaks_mb(given.folder, given.scene)
    known = read_json(RESULTS) if RESULTS.is_file() else {}
    write_json(RESULTS, known | {given.name: {"presets": given.presets, "peak_mb": peaks}})
    for rule, peak in sorted(peaks.items(), key=lambda pair: -pair[1]):
        print(f"{rule:28s} {peak:6d}")


if __name__ == "__main__":
    main()
