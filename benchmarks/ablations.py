# SPDX-License-Identifier: Apache-2.0
"""The paper's ablations (section 4.3) on three made studios: what each of its ideas brings, without any network.

    python -m benchmarks.ablations [--work DIR] [--frames 40] [--size 320 180] [--cores 2]
    python -m benchmarks.ablations --paper    # paper.yaml + networks.yaml on the smallest studio, with planted networks

Films three studios that differ in room, people and stand of the cameras, runs ``config/sweeps/ablations.tsv`` on each
(the paper's ideas on the embedded back ends, then one of them taken away per row) and writes DIR/index.html, one page
about all three, and benchmarks/results/ablations.json: measures at the held-out cameras per studio and row, and the
mean change over the studios. An interrupted run goes on where it was when DIR is given again.

``--paper`` runs ``config/sweeps/paper.tsv`` into the same file: every idea of the presets themselves, where stand-ins
answer for the networks and steps are few. It shows that each of them acts, not what it is worth.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml
from studiorecon.scene.files import read_json
from studiorecon.sweep.page import MEASURES, mean_effects
from studiorecon.sweep.table import read_rows

ROOT = Path(__file__).resolve().parents[1]
RESULTS, TABLE = Path(__file__).parent / "results" / "ablations.json", ROOT / "config/sweeps/ablations.tsv"
PAPER = ROOT / "config/sweeps/paper.tsv"


def studios(frames: int, size: tuple[int, int]) -> dict[str, dict]:
    """Three captures that have little in common but four cameras, soft contact shading and a detector's noise."""
    common = {"frames": frames, "size": list(size), "effects": {"contact_shading": 0.5}, "detections": {"noise_px": 1}}
    ring = {"training": 4, "held_out": 4}
    return {
        "two_in_a_ring": common | {"seed": 3, "people": 2, "cameras": ring},
        "three_in_a_ring": common | {"seed": 11, "people": 3, "cameras": ring | {"radius_m": 3.3}},
        "two_before_an_arc": common
        | {"seed": 5, "people": 2, "cameras": ring | {"layout": "arc", "arc_deg": 120.0, "held_out": 3}},
    }


def sweep(folder: Path, table: Path, reported: list[str], cores: str) -> None:
    """Run a table in ``folder`` on what ``--config`` is ``told``."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", cores]
    command += ["--directory", str(folder), "sweep", "--config", f"sweep={table}", "sweep_minutes=60", *reported]
    environment = {**os.environ, "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])}
    environment["PYTHONPATH"] = str(ROOT / "workflow")
    subprocess.run(command, env=environment, check=True)


def ablated(work: Path, name: str, described: dict, cores: int) -> list[Path]:
    """Records of the ablations on one studio, which run in a folder of its own, in the table's order."""
    folder = work / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(described))
    sweep(folder, TABLE, [f"dataset={folder / name}.yaml"], str(cores))
    return [folder / "results" / name / "sweep" / TABLE.stem / f"{row.name}.json" for row in read_rows(TABLE)]


def on_the_papers_presets(work: Path, cores: int) -> dict[str, dict]:
    """Measures of every row of ``PAPER`` on the smallest studio, whose networks are planted."""
    from tests.workflow.test_paper_run import embedded_run, with_stand_ins

    house = embedded_run(work)
    options = with_stand_ins(house, work / "weights", sweep=str(PAPER), sweep_minutes=120)
    house.snakemake("sweep", "--cores", str(cores), *options)
    folder = house.folder / "results/tiny/sweep" / PAPER.stem
    return measured([read_json(folder / f"{row.name}.json") for row in read_rows(PAPER)])


def measured(records: list[dict]) -> dict[str, dict]:
    """Row → its measures, or why it has none."""
    return {r["name"]: {"failed": r["failed"]} if r["failed"] else r["metrics"] for r in records}


def main() -> None:
    """Print the table and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, help="where the runs are kept; a temporary folder otherwise")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--size", type=int, nargs=2, default=(320, 180))
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--paper", action="store_true", help="the paper's presets with planted networks")
    given = parser.parse_args()
    known = read_json(RESULTS)
    if given.paper:
        with tempfile.TemporaryDirectory() as temporary:
            rows = on_the_papers_presets((given.work or Path(temporary)).resolve(), given.cores)
        RESULTS.write_text(json.dumps(known | {"paper_presets": rows}, indent=1) + "\n")
        print(json.dumps(rows, indent=1))
        return
    with tempfile.TemporaryDirectory() as temporary:
        work = (given.work or Path(temporary)).resolve()
        made = studios(given.frames, tuple(given.size))
        records = {name: ablated(work, name, described, given.cores) for name, described in made.items()}
        paths = [str(path) for rows in records.values() for path in rows]
        page = [sys.executable, "-m", "studiorecon", "sweep.page", "--records", *paths]
        subprocess.run([*page, "--page", str(work / "index.html"), "--table", str(work / "runs.csv")], check=True)
        scenes = {name: [read_json(path) for path in paths] for name, paths in records.items()}
    changes = mean_effects(scenes)
    names = [name for name in MEASURES if any(name in change["changes"] for change in changes)]
    result = {
        "studios": made,
        "rows": {scene: measured(rows) for scene, rows in scenes.items()},
        "change_over_studios": changes,
        "machine": {"machine": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()},
    }
    RESULTS.write_text(json.dumps(known | result, indent=1) + "\n")
    print(f"| change | {' | '.join(names)} | PSNR in one studio |\n|---|{'---|' * (len(names) + 1)}")
    for c in changes:
        cells = " | ".join(f"{c['changes'][name]:+.3f}" if name in c["changes"] else "–" for name in names)
        low, high = c["psnr_span_db"]
        print(f"| {c['name']} | {cells} | {low:+.2f} … {high:+.2f} |")


if __name__ == "__main__":
    main()
