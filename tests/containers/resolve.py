# SPDX-License-Identifier: Apache-2.0
"""Does every image's list of packages resolve, all its pip steps together, for the Python it has? And does upstream's
module import in that resolution? ``python -m tests.containers.resolve [--imports] [IMAGE …]``, nightly.

Nothing is built: ``uv pip compile`` asks the registry for requirements, and git for those of pinned sources. What a
base image brings, and what is compiled against CUDA or installed without its own requirements, is left out and named. A
source that cannot be had from this machine is named as well: its image is then not looked at, which is no failure.

With ``--imports`` each resolution is installed into an environment of its own (gigabytes: torch and CUDA's libraries),
the modules that the image's adapters ask for are imported from checkouts at their pins, and upstream's code runs there
with random weights, where it can without a GPU (tests marked ``weights``).

Checkouts below STUDIORECON_UPSTREAM (``owner+name``) stand for github.com's, where that is out of reach.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from studiorecon.models.containers import instructions

ROOT = Path(__file__).resolve().parents[2]
IMAGES = tuple(yaml.safe_load((ROOT / "envs/images.yaml").read_text(encoding="utf-8")))
# What is in the name of a base image → its Python, and the glibc that wheels may ask for. Python's images are Debian's:
# the older glibc of those in use.
BASES = {
    "python:3.10-": ("3.10", "2_36"),
    "python:3.11-": ("3.11", "2_36"),
    "ubuntu22.04": ("3.10", "2_35"),
    "ubuntu24.04": ("3.12", "2_39"),
    "cosmos-": ("3.12", "2_39"),
}
# Not built here: parts compiled against CUDA, which want a compiler and torch before they say what they need.
COMPILED = ("transformer-engine", "pytorch3d", "apex", "simple-knn", "diff-gaussian-rasterization", "sam2", "BasicSR")
# What the adapters import of upstream.
MODULES = {
    "vision": ("torchvision.models.optical_flow", "lpips", "kornia", "huggingface_hub"),
    "pi3": ("pi3.models.pi3", "pi3.models.pi3x"),
    "moge": ("moge.model.v2",),
    "sam3": ("transformers.models.sam3_video.modeling_sam3_video",),
    # Its other modules want SMPL's file as soon as they are imported.
    "comotion": ("comotion_demo.utils.dataloading",),
    "difix": ("pipeline_difix", "torchvision.models.optical_flow"),
    # The cache of warped photos alone: the pipeline wants what is compiled in the image.
    "gen3c": ("cosmos_predict1.diffusion.inference.cache_3d",),
}
WITHOUT = {
    "fixer": "its modules ask for what NVIDIA's base image has compiled",
    "lhm": "its modules ask for pytorch3d and a rasteriser, compiled for a GPU in the image",
}
# Where upstream's code runs with random weights.
TESTS = {
    "pi3": "tests/models/test_pi3.py",
    "moge": "tests/models/test_moge.py",
    "sam3": "tests/models/test_sam3.py",
    "comotion": "tests/models/test_comotion.py",
    "difix": "tests/models/test_difix.py",
    "gen3c": "tests/models/test_gen3c.py",
}
_TOOLS = ("pytest", "pytest-xdist", "pytest-timeout", "hypothesis", "jsonschema", "jinja2", "scipy")


@dataclass
class Recipe:
    """What the RUN lines of one Containerfile install: requirements that are resolved together, checkouts as (address,
    commit), and what is left out, with the reason."""

    python: str
    glibc: str
    wanted: list[str] = field(default_factory=list)
    checkouts: list[tuple[str, str]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def recipe(name: str) -> Recipe:
    """What envs/``name`` installs; ValueError for a base whose Python is not known here."""
    folder = ROOT / "envs" / name
    steps = instructions((folder / "Containerfile").read_text(encoding="utf-8"))
    base = next(rest for keyword, rest in steps if keyword == "ARG")
    known = [about for part, about in BASES.items() if part in base]
    if len(known) != 1:
        raise ValueError(f"envs/{name}: which Python has {base}?")
    made = Recipe(*known[0])
    cloned: dict[str, str] = {}
    for command in (c for keyword, rest in steps if keyword == "RUN" for c in rest.split("&&")):
        words = shlex.split(command)
        if words[:2] == ["git", "clone"]:
            cloned[words[3]] = words[2]
        elif words[:2] == ["git", "-C"] and words[3] == "checkout":
            made.checkouts.append((cloned[words[2]], words[4]))
        elif words[:2] == ["pip", "install"]:
            _install(made, words[2:], folder / "requirements.txt", cloned)
    return made


def _install(made: Recipe, words: list[str], requirements: Path, cloned: dict[str, str]) -> None:
    options = {word for word in words if word.startswith("-")}
    skipped = {words[i + 1] for i, word in enumerate(words) if word in ("-r", "-c", "--config-settings")}
    if "-r" in options:
        lines = (line.partition("#")[0].strip() for line in requirements.read_text(encoding="utf-8").splitlines())
        made.wanted += [line for line in lines if line]
    for word in words:
        if word.startswith(("-", "pip==")) or word in skipped:
            continue
        commits = dict(made.checkouts)
        source = f"git+{cloned[word]}@{commits[cloned[word]]}" if word in cloned else word
        if "--no-deps" in options:
            made.left_out.append(f"{source} (without its own requirements)")
        elif any(part in source for part in COMPILED):
            made.left_out.append(f"{source} (compiled in the image)")
        else:
            made.wanted.append(source)


def as_seen_from_here() -> dict[str, str]:
    """The environment in which git takes checkouts below STUDIORECON_UPSTREAM for those of github.com."""
    given = os.environ.get("STUDIORECON_UPSTREAM", "")
    folders = sorted(Path(given).glob("*+*")) if given else []
    reported = {"GIT_CONFIG_COUNT": str(len(folders))}
    for k, folder in enumerate(folders):
        reported[f"GIT_CONFIG_KEY_{k}"] = f"url.file://{folder.resolve()}.insteadOf"
        reported[f"GIT_CONFIG_VALUE_{k}"] = f"https://github.com/{folder.name.replace('+', '/')}"
    return {**os.environ, **reported}


def resolved(made: Recipe) -> tuple[str, str]:
    """The resolution as a requirements file and "", or "" and what uv says."""
    done = subprocess.run(
        [
            *("uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate"),
            *("--python-version", made.python, "--python-platform", f"x86_64-manylinux_{made.glibc}", "-"),
        ],
        input="\n".join(made.wanted),
        text=True,
        capture_output=True,
        cwd=tempfile.gettempdir(),
        env=as_seen_from_here(),
    )
    return (done.stdout, "") if done.returncode == 0 else ("", done.stderr.strip())


def out_of_reach(messages: str) -> bool:
    """Whether uv stopped because git could not be asked, and not because versions contradict."""
    return bool(re.search(r"[Gg]it operation failed|failed to (clone|fetch)", messages))


def imported(name: str, made: Recipe, packages: str) -> str:
    """Install a resolution, import the image's modules and run upstream's code; what went wrong, or ""."""
    folder = Path(tempfile.mkdtemp(prefix=f"studiorecon-{name}-"))
    try:
        (folder / "packages.txt").write_text(packages, encoding="utf-8")
        python = str(folder / "environment/bin/python")
        for command in (
            ["uv", "venv", "--quiet", "--python", made.python, str(folder / "environment")],
            ["uv", "pip", "install", "--quiet", "--no-deps", "--python", python, "-r", str(folder / "packages.txt")],
        ):
            done = subprocess.run(command, text=True, capture_output=True, cwd=folder, env=as_seen_from_here())
            if done.returncode:
                return _last(done.stderr)
        roots = [str(ROOT / "workflow")]
        for address, commit in made.checkouts:
            # As tests look for them.
            name_there = "+".join(address.removesuffix(".git").split("/")[-2:])
            there = f"upstream/{name_there}"
            for command in (
                ["git", "clone", "-q", address, there],
                # A stored copy may lack films of its pages: what counts is which commit is there.
                [
                    "sh",
                    "-c",
                    f"git -C {there} checkout -q -f {commit}; git -C {there} rev-parse HEAD | grep -q ^{commit}",
                ],
            ):
                done = subprocess.run(command, text=True, capture_output=True, cwd=folder, env=as_seen_from_here())
                if done.returncode:
                    return f"{address} at {commit}: {_last(done.stderr)}"
            roots += [str(folder / "upstream" / name_there), str(folder / "upstream" / name_there / "src")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(roots), "HF_HUB_OFFLINE": "1"}
        environment["STUDIORECON_UPSTREAM"] = str(folder / "upstream")
        for module in MODULES[name]:
            done = subprocess.run([python, "-c", f"import {module}"], text=True, capture_output=True, env=environment)
            if done.returncode:
                return f"import {module}: {_last(done.stderr)}"
        if name not in TESTS:
            return ""
        for command in (
            ["uv", "pip", "install", "--quiet", "--python", python, *_TOOLS],
            [python, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", "-m", "weights", TESTS[name]],
        ):
            done = subprocess.run(command, text=True, capture_output=True, cwd=ROOT, env=environment)
            if done.returncode:
                return f"{TESTS[name]}: {_last(done.stdout + done.stderr)}"
        return ""
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _last(messages: str) -> str:
    return next((line.strip() for line in reversed(messages.splitlines()) if line.strip()), "nothing was said")


def main() -> int:
    """One line per image; 1 when a list of packages contradicts itself or a module does not import."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("images", nargs="*", default=IMAGES, metavar="IMAGE")
    parser.add_argument("--imports", action="store_true", help="install each resolution and import upstream's modules")
    given = parser.parse_args()
    failed = False
    for name in given.images:
        made = recipe(name)
        packages, messages = resolved(made)
        if messages and out_of_reach(messages):
            print(f"{name}: not looked at, a source cannot be had from here ({_last(messages)})", flush=True)
            continue
        if messages:
            failed = True
            print(f"{name}: Python {made.python}, CONTRADICTS ITSELF\n{messages}", flush=True)
            continue
        count = sum(1 for line in packages.splitlines() if line and not line.startswith("#"))
        line = f"{name}: Python {made.python}, {count} packages resolve"
        if made.left_out:
            line += f"; left out: {', '.join(made.left_out)}"
        if given.imports and name in MODULES:
            wrong = imported(name, made, packages)
            failed |= bool(wrong)
            line += f"; {wrong or 'imports ' + ', '.join(MODULES[name])}"
            line += "; upstream's code ran with random weights" if name in TESTS and not wrong else ""
        elif given.imports and name in WITHOUT:
            line += f"; not imported: {WITHOUT[name]}"
        print(line, flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
