# SPDX-License-Identifier: Apache-2.0
"""The upstream networks that a configuration asks for, and the container images and GPUs of rules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.selection import check_licences, selected

_LPIPS = ("lpips", "lpips_alex")


@dataclass(frozen=True)
class Networks:
    """What each stage calls for; "" where its own method is used.

    Attributes:
        selected: every network that is called for, sorted.
        weights: the folder of their weights.
        cameras: finds the cameras; masks: tracks people in pictures.
        depth: a network, or "precomputed"; first_depth: the room's is what ``cameras`` says of the first moment.
        views: a network, "warp" or "precomputed"; people_in_views: finds whom those show; "" where bodies say so.
        compared: the stages that compare pictures by LPIPS.
        enhance: the one whose image the enhancer runs in: enhancer and flow share a process.
        refiner: the enhancer that repairs views of the half-trained room; "" where none are asked for.
        drawn_by: image of what draws Gaussians: on a GPU, and for LPIPS, it is one of its own, because torch is large.
        drawing_gpus: GPUs that drawing holds.
    """

    selected: list[str]
    weights: str
    cameras: str
    masks: str
    depth: str
    first_depth: bool
    views: str
    people_in_views: str
    compared: list[str]
    enhance: str
    refiner: str
    drawn_by: str
    drawing_gpus: int

    def lpips(self, stage: str) -> str:
        """The folder of LPIPS' files for a stage; "none" where it compares nothing by it."""
        return f"{self.weights}/lpips" if stage in self.compared else "none"

    @property
    def images(self) -> list[str]:
        """Names of all container images that a run uses, and the fetching of its weights."""
        fetched_in = {"vision"} if self.selected else set()
        return sorted({"core", self.drawn_by} | fetched_in | {MODELS[name].runtime.image for name in self.selected})


def networks_of(config: Mapping[str, Any], home: Path) -> Networks:
    """What the configuration calls for; UserError when a licence is not allowed by it."""
    check_licences(config)
    wanted = sorted({model for _, model in selected(config)})
    weights = config["weights"] if Path(config["weights"]).is_dir() else str(home / config["weights"])
    compared = sorted({where.partition(".")[0] for where, model in selected(config) if model in _LPIPS})
    enhancers = config["enhance"]["enhancer"], config["enhance"]["flow"]
    on_gpu = config["device"] == "cuda"
    return Networks(
        selected=wanted,
        weights=weights,
        cameras=_network(config["calibration"]["source"]),
        masks=_network(config["masks"]["source"]),
        depth="" if config["depth"]["source"] == "embedded" else config["depth"]["source"],
        first_depth=config["depth"]["reference"] == "calibration",
        views=config["views"]["synthesizer"],
        people_in_views=_network(config["masks"]["source"]) if config["views"]["people"] == "network" else "",
        compared=compared,
        # In the enhancer's image, whose torchvision has RAFT.
        enhance=next((name for name in enhancers if name in MODELS), ""),
        refiner=_network(enhancers[0]) if config["background"]["refinement"]["views"] else "",
        drawn_by="vision" if on_gpu or compared else "core",
        drawing_gpus=int(on_gpu),
    )


def _network(source: str) -> str:
    return source if source in MODELS else ""


@dataclass(frozen=True)
class Images:
    """Container images by name.

    Attributes:
        entries: name → image, version and digest, as ``envs/images.yaml`` has them.
        built: the folder of those that ``snakemake images`` made with apptainer.
        on_cpu: everything is to run on the CPU.
    """

    entries: Mapping[str, Mapping[str, str]]
    built: Path
    on_cpu: bool

    def named(self, name: str) -> str:
        """The file that was built, else the image's address."""
        entry = self.entries[name]
        built = self.built / f"{name}-{entry['version']}.sif"
        if built.is_file():
            return str(built)
        exactly = f"@{entry['digest']}" if entry["digest"] else f":{entry['version']}"
        return f"docker://{entry['image']}{exactly}"

    def of_network(self, name: str) -> str:
        """The image that a network runs in; the workflow's own for what is no network ("", "precomputed")."""
        return self.named(MODELS[name].runtime.image if name in MODELS else "core")

    def gpus(self, name: str) -> int:
        """GPUs that a job of a network holds: one, unless everything runs on the CPU or it needs none."""
        return int(name in MODELS and not self.on_cpu and MODELS[name].memory.gpu_gb is not None)

    def to_build(self, names: list[str]) -> list[str]:
        """``name=image:version`` of those."""
        return [f"{name}={self.entries[name]['image']}:{self.entries[name]['version']}" for name in names]


def images_of(config: Mapping[str, Any], home: Path) -> Images:
    """The images of ``envs/images.yaml`` in the workflow's folder."""
    entries = yaml.safe_load((home / "envs/images.yaml").read_text(encoding="utf-8"))
    return Images(entries, Path(config["images"]), config["device"] == "cpu")
