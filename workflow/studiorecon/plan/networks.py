# SPDX-License-Identifier: Apache-2.0
"""The upstream networks that a configuration selects, and the container images and GPUs of rules."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from studiorecon.models.catalogue.preflight import missing_weights
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.selection import check_licences, networks_of_step, select_networks

_LPIPS = ("lpips", "lpips_alex")


@dataclass(frozen=True)
class Networks:
    """The network that each stage uses; "" where the stage uses its own method.

    Attributes:
        selected: every selected network, sorted.
        weights: the folder of their weights.
        cameras, masks: calibrates the cameras; tracks people in pictures.
        depth, first_depth: a network, or "precomputed"; whether ``cameras`` gives the first moment's depth.
        views: a network, "warp" or "precomputed".
        people_in_views: detects people in those; "" where bodies do it.
        lpips_stages: the stages that compare pictures by LPIPS.
        enhance: the network in whose image the enhancer runs: enhancer and flow share a process.
        refiner: the enhancer that repairs views of the half-trained room; "" without one.
        rasteriser_image: container image of the rasteriser: its own for a GPU or LPIPS, because torch is large.
        rasteriser_gpus: GPUs that a job with the rasteriser holds.
    """

    selected: list[str]
    weights: str
    cameras: str
    masks: str
    depth: str
    first_depth: bool
    views: str
    people_in_views: str
    lpips_stages: list[str]
    enhance: str
    refiner: str
    rasteriser_image: str
    rasteriser_gpus: int

    def lpips(self, stage: str) -> str:
        """The folder of LPIPS' files for a stage; "none" where the stage does not use LPIPS."""
        return f"{self.weights}/lpips" if stage in self.lpips_stages else "none"

    @property
    def images(self) -> list[str]:
        """Names of all container images that a run uses, including the one that fetches its weights."""
        fetched_in = {"vision"} if self.selected else set()
        return sorted(
            {"core", self.rasteriser_image} | fetched_in | {MODELS[name].runtime.image for name in self.selected}
        )


def choose_networks(config: Mapping[str, Any], home: Path) -> Networks:
    """The networks that the configuration selects; raises UserError for a network whose licence it does not allow."""
    check_licences(config)
    wanted = sorted({model for _, model in select_networks(config)})
    weights = config["weights"] if Path(config["weights"]).is_dir() else str(home / config["weights"])
    compared = sorted({where.partition(".")[0] for where, model in select_networks(config) if model in _LPIPS})
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
        lpips_stages=compared,
        # The flow network runs in the enhancer's image, whose torchvision has RAFT.
        enhance=next((name for name in enhancers if name in MODELS), ""),
        refiner=_network(enhancers[0]) if config["background"]["refinement"]["views"] else "",
        rasteriser_image="vision" if on_gpu or compared else "core",
        rasteriser_gpus=int(on_gpu),
    )


def missing_files(networks: Networks, config: Mapping[str, Any], steps: Collection[str]) -> list[str]:
    """A sentence for each network that one of these ``steps`` ("stage.step") runs and whose files are not all there."""
    compare = any(step.partition(".")[0] in networks.lpips_stages for step in steps)
    names = {name for step in steps for name in networks_of_step(step, config)}
    names |= set(_LPIPS).intersection(networks.selected if compare else ())
    found = (missing_weights(MODELS[name], Path(networks.weights)) for name in sorted(names))
    return [sentence for sentence in found if sentence]


def _network(source: str) -> str:
    return source if source in MODELS else ""


@dataclass(frozen=True)
class Images:
    """Container images by name: ``entries`` (``envs/images.yaml``), those ``built`` locally with apptainer.

    ``on_cpu``: everything runs on the CPU.
    """

    entries: Mapping[str, Mapping[str, str]]
    built: Path
    on_cpu: bool

    def named(self, name: str) -> str:
        """The locally built image file if it exists, else the image's address."""
        entry = self.entries[name]
        built = self.built / f"{name}-{entry['version']}.sif"
        if built.is_file():
            return str(built)
        exactly = f"@{entry['digest']}" if entry["digest"] else f":{entry['version']}"
        return f"docker://{entry['image']}{exactly}"

    def of_network(self, name: str) -> str:
        """The image that a network runs in; the workflow's own for a name that is no network ("", "precomputed")."""
        return self.named(MODELS[name].runtime.image if name in MODELS else "core")

    def gpus(self, name: str) -> int:
        """GPUs that a job of a network holds: one, or none on the CPU and for networks that need none."""
        return int(name in MODELS and not self.on_cpu and MODELS[name].memory.gpu_gb is not None)

    def to_build(self, names: list[str]) -> list[str]:
        """``name=image:version`` of the named images."""
        return [f"{name}={self.entries[name]['image']}:{self.entries[name]['version']}" for name in names]


def read_images(config: Mapping[str, Any], home: Path) -> Images:
    """The images of ``envs/images.yaml`` in the workflow's folder."""
    entries = yaml.safe_load((home / "envs/images.yaml").read_text(encoding="utf-8"))
    return Images(entries, Path(config["images"]), config["device"] == "cpu")
