# SPDX-License-Identifier: Apache-2.0
"""``models.containers``: builds container images of envs/ with the installed engine. Run by ``snakemake images`` only.

Apptainer makes a file in which the workflow then runs its rules; podman and docker keep the image in their own store,
to be pushed from there. Apptainer reads no Containerfile, so ours use only ARG BASE, FROM, COPY, RUN and ENV, which a
definition file can express as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.signature import Place

# Command that shows that each engine works (docker's client answers without its daemon), in the order of preference.
_ENGINES = {
    "apptainer": ("--version",),
    "podman": ("info", "--format", "{{.Version.Version}}"),
    "docker": ("version", "--format", "{{.Server.Version}}"),
}


@dataclass(frozen=True)
class ContainerImage:
    """One image: its folder below envs/, its address without a registry, and its version."""

    name: str
    address: str
    version: str


def read_image(text: str) -> ContainerImage:
    """``core=studiorecon/core:0.1.0``; raises ValueError for anything else."""
    name, _, tag = text.partition("=")
    address, _, version = tag.rpartition(":")
    if not (name and address and version):
        raise ValueError(f"{text!r} is not NAME=ADDRESS:VERSION")
    return ContainerImage(name, address, version)


def find_engine() -> str:
    """The first container engine that answers; if none does, raises UserError with the message of each."""
    import shutil
    import subprocess

    reasons = []
    for name, question in _ENGINES.items():
        if shutil.which(name) is None:
            reasons.append(f"{name} is not installed")
            continue
        done = subprocess.run([name, *question], text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        if done.returncode == 0:
            return name
        reasons.append(f"{name} does not work here ({(done.stdout.strip().splitlines() or ['no message'])[-1]})")
    raise UserError(
        f"no image can be built on this machine: {'; '.join(reasons)}; install one of them, or run without "
        "--sdm apptainer"
    )


def instructions(containerfile: str) -> list[tuple[str, str]]:
    """(keyword, rest) of every line of a Containerfile; raises UserError for keywords that ours do not use."""
    found = []
    for line in containerfile.replace("\\\n", " ").splitlines():
        keyword, _, rest = line.strip().partition(" ")
        if not keyword or keyword.startswith("#"):
            continue
        if keyword not in ("ARG", "FROM", "COPY", "RUN", "ENV"):
            raise UserError(
                f"{keyword} has no counterpart in an apptainer definition; write it as "
                "RUN, COPY or ENV, or build with podman"
            )
        found.append((keyword, rest.strip()))
    return found


def definition(containerfile: str) -> str:
    """The apptainer definition of the same image: files first, then commands, with the variables set in both."""
    steps = instructions(containerfile)
    base = next(
        (rest.partition("=")[2] for keyword, rest in steps if keyword == "ARG" and rest.startswith("BASE=")), ""
    )
    start = next(rest for keyword, rest in steps if keyword == "FROM").replace("${BASE}", base)
    exports = [f"    export {rest}" for keyword, rest in steps if keyword == "ENV"]
    lines = ["Bootstrap: docker", f"From: {start}", "", "%files"]
    lines += [f"    {rest}" for keyword, rest in steps if keyword == "COPY"]
    lines += ["", "%environment", *exports, "", "%post", "    set -e"]
    lines += [
        f"    export {rest}" if keyword == "ENV" else f"    {rest}"
        for keyword, rest in steps
        if keyword in ("ENV", "RUN")
    ]
    return "\n".join(lines) + "\n"


def build_image(chosen: str, image: ContainerImage, root: Path, folder: Path) -> str:
    """Address or file of an image built from ``root``/envs/NAME with engine ``chosen``; raises UserError if it fails.

    Apptainer's file goes into ``folder``, completely or not at all.
    """
    containerfile = root / "envs" / image.name / "Containerfile"
    if not containerfile.is_file():
        raise UserError(f"{containerfile} is missing: envs/images.yaml names an image without a folder")
    if chosen != "apptainer":
        tag = f"{image.address}:{image.version}"
        _call([chosen, "build", "-f", str(containerfile), "-t", tag, str(root)], root, image)
        digest = _call([chosen, "image", "inspect", "--format", "{{.Id}}", tag], root, image).strip()
        return f"{tag} in {chosen}'s store ({digest}); push it where the machines that run the workflow can get it"
    folder.mkdir(parents=True, exist_ok=True)
    target = (folder / f"{image.name}-{image.version}.sif").resolve()
    recipe, partial = target.with_suffix(".def"), target.with_suffix(".partial.sif")
    recipe.write_text(definition(containerfile.read_text()))
    _call(["apptainer", "build", "--force", str(partial), str(recipe)], root, image)
    if not partial.is_file():
        raise UserError(f"apptainer left no {partial}; build {recipe} by hand to see why")
    partial.replace(target)
    return f"{target}, which --sdm apptainer uses from now on"


def _call(command: list[str], root: Path, image: ContainerImage) -> str:
    import subprocess

    done = subprocess.run(command, cwd=root, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode:
        tail = " / ".join(line.strip() for line in done.stdout.splitlines()[-4:] if line.strip())
        raise UserError(f"image {image.name} could not be built by {command[0]} ({tail[-600:] or 'no message'})")
    return done.stdout


def run(images: list[str], root: Place, folder: Place) -> None:
    """Build ``images`` (``NAME=ADDRESS:VERSION``) from their folders in ``root``/envs; apptainer's go into
    ``folder``."""
    chosen = find_engine()
    say(f"images are built by {chosen}")
    for image in map(read_image, images):
        say(f"building {image.name}")
        say(f"{image.name} is built: {build_image(chosen, image, root, folder)}")
