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
        "Dataset folder, or the description of a synthetic studio (.yaml), which is made first.",
    )
    scene: str | int = setting("", "Name of the results folder; empty = the dataset's name.")
    capture_yaml: str = setting("", "A capture.yaml outside the dataset folder; empty = the one in it, if any.")
    body: str = setting(
        "resources/body.npz",
        "Body model: the bundled one, or an SMPL .npz or .pkl of your own.",
        paper="SMPL, behind a registration",
        paper_value="resources/weights/smpl/SMPL_NEUTRAL.pkl",
    )
    device: Literal["auto", "cpu", "cuda"] = setting(
        "auto", "Device that draws and trains Gaussians; auto = CUDA if gsplat is installed, else the CPU."
    )
    budget_min: float = setting(
        0.0,
        "Time limit: chooses the best preset that should finish in time; your own settings take "
        "precedence. 0 = no limit.",
        unit="min",
        minimum=0,
    )
    strict: bool = setting(False, "Fail at the end if any step warned; all results are made.")
    sweep: str = setting("config/sweeps/one_at_a_time.tsv", "Table of configurations for `snakemake sweep`.")
    sweep_minutes: float = setting(60.0, "Time limit of one configuration of a sweep.", unit="min", above=0)
    weights: str = setting("resources/weights", "Folder of the optional networks' weights.")
    licences: Literal["any", "commercial"] = setting(
        "any", "Licences that may be used; commercial refuses research-only networks and names a substitute."
    )
    images: str = setting("resources/images", "Folder of the container images of `snakemake images`.")


@dataclass(frozen=True)
class Detect:
    """The source of detections, and the path of a network's files."""

    detector: Literal["blazepose_heavy", "blazepose"] = setting(
        "blazepose_heavy",
        "Detector of people; blazepose is three times as fast, with landmark errors a quarter larger.",
    )
    network: str = setting(
        "",
        "Network for the keypoints of detected people: rtmpose, vitpose or rtmo (`snakemake "
        "weights`), or your own ONNX file.",
    )
    network_layout: NetworkLayout = setting("auto", "Layout of that network's keypoints; auto = by their number.")
    precomputed: str = setting(
        "",
        "Folder with CoMotion's <camera>.npz or .pt for capture/<camera>.mkv: id, frame_idx, pose, "
        "betas, trans, pred_2d, pred_3d.",
    )


@dataclass(frozen=True)
class People:
    """The user's own table of identities."""

    identities: str = setting(
        "", "Corrected copy of people/identities.tsv; empty = the dataset's identities.tsv, if any."
    )


@dataclass(frozen=True)
class Depth:
    """The path of a network's depth, and its input."""

    network: str = setting(
        "", "Your own depth network in ONNX, for source onnx: one RGB picture in, depth or inverse depth out."
    )
    precomputed: str = setting(
        "", "Folder with <camera>.exr, .npy, .npz or 16-bit .png (millimetres) for every camera."
    )


@dataclass(frozen=True)
class Masks:
    """The path of masks from other tools."""

    precomputed: str = setting(
        "", "Folder with <camera>.mkv, .mp4 or <camera>/ (pictures): 0 = background, else one number per person."
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

    precomputed: str = setting("", "Folder with <shot>.mkv or .mp4, made from render/<shot>.mkv picture by picture.")


@dataclass(frozen=True)
class Render:
    """Further outputs of a film."""

    exr: bool = setting(
        False,
        "Write OpenEXR layers too: render/<shot>.layers/000000.exr … with colour, depth, normals, truth and mattes.",
    )
