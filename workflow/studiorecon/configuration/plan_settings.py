# SPDX-License-Identifier: Apache-2.0
"""Settings that only the plan of a run reads, and no step: paths, and the choice between sources of data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from studiorecon.configuration.setting import setting
from studiorecon.keypoints.layouts import LAYOUTS

if TYPE_CHECKING:
    NetworkLayout = str
else:
    NetworkLayout = Literal[("auto", *LAYOUTS)]


@dataclass(frozen=True)
class General:
    """Settings at the top of the configuration, outside any section."""

    dataset: str = setting(
        "resources/studio/demo.yaml",
        "A dataset directory, or the description of a synthetic studio (a .yaml file), which the workflow then makes "
        "first.",
    )
    scene: str | int = setting("", "Name of the results folder; empty = the name of the dataset.")
    capture_yaml: str = setting("", "A capture.yaml outside the dataset directory; empty = the one inside it, if any.")
    body: str = setting(
        "resources/body.npz",
        "The body model: the bundled one, or an SMPL .npz or .pkl of your own (same joints, its own shape space).",
        paper="SMPL, section on human pose estimation; its file is behind a registration",
        paper_value="resources/weights/smpl/SMPL_NEUTRAL.pkl",
    )
    device: Literal["auto", "cpu", "cuda"] = setting(
        "auto", "What draws and trains Gaussians; auto = a CUDA device where gsplat is installed, else the CPU."
    )
    budget_min: float = setting(
        0.0,
        "Time that a run may take: chooses the best-scoring preset that should finish in time; your own settings "
        "take precedence. 0 = no limit.",
        unit="min",
        minimum=0,
    )
    strict: bool = setting(
        False,
        "End with an error, after all results are made, if any step warned: for unattended runs.",
    )
    sweep: str = setting(
        "config/sweeps/one_at_a_time.tsv", "Table of the configurations that `snakemake sweep` runs and scores."
    )
    sweep_minutes: float = setting(60.0, "Longest that one configuration of a sweep may run.", unit="min", above=0)
    weights: str = setting("resources/weights", "Folder of the weights of upstream networks, of which none is default.")
    licences: Literal["any", "commercial"] = setting(
        "any",
        "Which licences may be used; commercial refuses networks that are for research only and names the one to take "
        "instead.",
    )
    images: str = setting(
        "resources/images",
        "Folder of the container images that `snakemake images` builds and --sdm apptainer takes first.",
    )


@dataclass(frozen=True)
class Detect:
    """The source of detections, and the path of a network's files."""

    detector: Literal["blazepose_heavy", "blazepose"] = setting(
        "blazepose_heavy",
        "Detector of people; blazepose is three times as fast, with landmark errors a quarter larger.",
    )
    network: str = setting(
        "",
        "Network that places the keypoints of detected people: rtmpose, vitpose or rtmo (fetched by snakemake "
        "weights), or your own ONNX file.",
    )
    network_layout: NetworkLayout = setting(
        "auto", "What the points of detect.network are; auto = as their number says."
    )
    precomputed: str = setting(
        "",
        "Folder with <camera>.npz or .pt of CoMotion's rows on our capture/<camera>.mkv: id, frame_idx, pose, betas, "
        "trans, pred_2d, pred_3d.",
    )


@dataclass(frozen=True)
class People:
    """The user's own table of identities."""

    identities: str = setting(
        "",
        "A corrected copy of people/identities.tsv, used unchanged; empty = the dataset's identities.tsv, if it has "
        "one.",
    )


@dataclass(frozen=True)
class Depth:
    """The path of a network's depth, and its input."""

    precomputed: str = setting("", "Folder with <camera>.exr, .npy, .npz or 16-bit .png (millimetres) of every camera.")


@dataclass(frozen=True)
class Masks:
    """The path of masks from other tools."""

    precomputed: str = setting(
        "",
        "Folder with <camera>.mkv, <camera>.mp4 or <camera>/ (pictures): 0 = background, else one number per person.",
    )


@dataclass(frozen=True)
class Views:
    """The path of a network's films."""

    precomputed: str = setting(
        "", "Folder with <segment>.mkv or .mp4 (00, 01, …) of 1280×704 or the working size, one picture per view."
    )


@dataclass(frozen=True)
class Enhance:
    """The path of an enhancer's films."""

    precomputed: str = setting(
        "", "Folder with <shot>.mkv or .mp4 of every shot, made from render/<shot>.mkv picture by picture."
    )


@dataclass(frozen=True)
class Render:
    """Further outputs of a film."""

    exr: bool = setting(
        False,
        "Take every film apart for compositing too: render/<shot>.layers/000000.exr … with colour, depth, normals, "
        "truth and mattes.",
    )
