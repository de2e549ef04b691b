# SPDX-License-Identifier: Apache-2.0
"""Download size and install time of the README's two commands on a fresh machine: a clone and an empty cache.

    uv run --group test python -m benchmarks.install

Downloads are the sizes, as the registry states them, of the wheels that this machine's Python takes from the lock that
uv makes.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import tempfile
import time
from pathlib import Path

import tomllib
from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {"run": ["uv", "sync"], "test": ["uv", "sync", "--group", "test"]}


def downloaded_bytes(lock: Path, installed: list[dict]) -> dict[str, int]:
    """Bytes of the wheel of every installed package, by name; a package's own source counts where it has no wheel for
    this machine."""
    ranks = {tag: rank for rank, tag in enumerate(sys_tags())}
    wanted = {(entry["name"], entry["version"]) for entry in installed}
    found = {}
    for package in tomllib.loads(lock.read_text())["package"]:
        if (package["name"], package.get("version")) not in wanted:
            continue
        fitting = []
        for wheel in package.get("wheels", []):
            name = wheel["url"].rpartition("/")[2]
            rank = min((ranks[tag] for tag in parse_wheel_filename(name)[3] if tag in ranks), default=None)
            if rank is not None:
                fitting.append((rank, wheel["size"]))
        source = package.get("sdist", {}).get("size")
        found[package["name"]] = min(fitting)[1] if fitting else source or 0
    return found


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder / "clone")], check=True)
        kept = {k: v for k, v in os.environ.items() if k not in ("VIRTUAL_ENV", "UV_PROJECT_ENVIRONMENT", "PYTHONPATH")}
        environment = {**kept, "UV_CACHE_DIR": str(folder / "cache")}
        report = {"machine": f"{platform.machine()}, Python {platform.python_version()}, {os.cpu_count()} cores"}
        for group, command in COMMANDS.items():
            begin = time.perf_counter()
            subprocess.run(command, cwd=folder / "clone", env=environment, check=True, capture_output=True)
            seconds = time.perf_counter() - begin
            listed = ["uv", "pip", "list", "--format", "json"]
            listing = subprocess.run(listed, cwd=folder / "clone", env=environment, capture_output=True, check=True)
            sizes = downloaded_bytes(folder / "clone/uv.lock", json.loads(listing.stdout))
            largest = dict(
                sorted(((n, round(size / 1e6, 1)) for n, size in sizes.items()), key=lambda item: -item[1])[:12]
            )
            report[group] = {
                "command": " ".join(command),
                "packages": len(sizes),
                "downloads_mb": round(sum(sizes.values()) / 1e6, 1),
                "seconds": round(seconds, 1),
                "largest_mb": largest,
            }
            print(json.dumps(report[group], indent=1), flush=True)
    (ROOT / "benchmarks/results/install.json").write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
