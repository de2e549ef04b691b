# SPDX-License-Identifier: Apache-2.0
"""The paper's settings: every setting that it mentions, its value, and whether the presets use it.

``python -m studiorecon.configuration.paper_settings`` writes docs/paper.md from the settings' declarations and from
``config/presets/paper.yaml`` with ``networks.yaml`` over it; a test compares it with the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from studiorecon.configuration.generate import value_text
from studiorecon.configuration.sections import SECTIONS, _class, default_configuration, general_settings
from studiorecon.configuration.setting import Setting, plain_value
from studiorecon.home import CONFIGURATION

PRESETS = ("paper.yaml", "networks.yaml")
PAGE: Path = CONFIGURATION.parents[1] / "docs" / "paper.md"

REASONS: Mapping[str, str] = {
    "people.association.gate_m": "bounds rays; 0.3 m between pelvises is a constant",
    "depth.sweep_width": "only background.fill_unseen reads the planes then",
    "render.shots": "held_out in capture.yaml selects these cameras",
}
"""The reason why a setting that the paper mentions cannot have the paper's value."""

REMARKS: Mapping[str, str] = {
    "humans.gaussians": "with placement: evenly",
    "people.lift.surface_to_joint_m": "with position: scene",
    "people.triangulation.solver": "points with rays under 2° apart or within 0.1 m of a camera stay undetermined: "
    "noise moves the minimum of Eq. 2 by metres there",
    "people.association.affinity": "σ_p 0.3 m and σ_θ 0.5 rad a joint are ours",
}
"""Remarks on settings that do have the paper's value."""

CONSTANTS: tuple[tuple[str, str, Any, str], ...] = (
    ("people.association.affinity:AssociationLimits", "position_weight", 0.9, "w_p, appendix B"),
    ("people.association.affinity:AssociationLimits", "pose_weight", 0.1, "w_θ, appendix B"),
    ("people.association.affinity:AssociationLimits", "pelvis_gate_m", 0.3, "distance threshold, appendix B"),
    ("splatting.train.schedule:TrainingSettings", "l1", 0.7, "λ of L1, appendix C"),
    ("splatting.train.schedule:TrainingSettings", "ssim", 0.3, "λ of SSIM, appendix C"),
    ("splatting.train.schedule:TrainingSettings", "position_lr_start", 1.6e-4, "learning rate, appendix C"),
    ("splatting.train.schedule:TrainingSettings", "position_lr_end", 1.6e-6, "learning rate, appendix C"),
    ("splatting.train.schedule:TrainingSettings", "densify_every", 500, "densification, appendix C"),
    (
        "splatting.train.schedule:TrainingSettings",
        "densify_from",
        500,
        "the first of every 500 iterations, appendix C; U54",
    ),
    ("splatting.train.schedule:TrainingSettings", "densify_gradient", 2e-4, "gradient threshold, appendix C"),
    ("background.refinement:Refinement", "at", 0.5, "iteration 3,500 of 7,000, appendix C"),
    ("background.refinement:Refinement", "height", 0.15, "±15 % of the scene's radius, appendix C"),
    ("background.refinement:Refinement", "weight", 0.7, "reduced loss weight, appendix C"),
    ("humans.training:Losses", "l1", 0.8, "λ of L1, appendix D"),
    ("humans.training:Losses", "ssim", 0.2, "λ of SSIM, appendix D"),
    ("humans.training:Growing", "until", 1500, "last step that densifies, appendix D"),
    ("humans.training:Growing", "every", 500, "densification, appendix C"),
    ("humans.training:Growing", "gradient", 2e-4, "gradient threshold, appendix C"),
    ("humans.train_settings:Settings", "grid_resolution", 64, "64³ voxels, appendix D"),
    ("views.fitted:Settings", "dilation_px", 21, "people in synthesized views; U24"),
    ("recursive.injection:Injection", "decay", 0.5, "temporal decay; U03"),
    ("humans.appearance:OverTime", "layers", 8, "8 layers, appendix D"),
    ("report.evaluate:Settings", "seen_tolerance", 0.05, "Seen/Unseen Fidelity; U57"),
)
"""The paper's numbers that are constants in the code: place, name, the paper's value, source."""

_HEAD = """\
# The paper's settings

Written by `python -m studiorecon.configuration.paper_settings`; do not edit by hand.
The table has every setting with a value in the paper, and the value that `config/presets/paper.yaml` and
`networks.yaml` give it; empty = the [default](settings.md), which is the paper's.
U-numbers are [readings](readings.md), (A) to (D) appendices.

| setting | the paper | presets |
|---|---|---|
"""
_BETWEEN = """
Constants of the paper without a setting; a test compares them with the paper.

| constant | source | value |
|---|---|---|
"""


def paper_values() -> Iterator[tuple[str, Setting]]:
    """Every setting that the paper mentions, by its dotted name."""
    yield from ((setting.name, setting) for setting in general_settings() if setting.description.paper)
    for section in SECTIONS:
        yield from _inside(section.settings(), section.name)


def _inside(settings: Iterable[Setting], above: str) -> Iterator[tuple[str, Setting]]:
    for setting in settings:
        name = f"{above}.{setting.name}"
        if setting.is_section:
            yield from _inside(setting.inner(), name)
        elif setting.description.paper:
            yield name, setting


def merge_presets(names: Iterable[str] = PRESETS) -> Mapping[str, Any]:
    """The configuration with these presets laid over it in turn, as Snakemake does it."""
    whole: dict[str, Any] = dict(default_configuration())
    for name in names:
        preset = yaml.safe_load((CONFIGURATION.parent / "presets" / name).read_text(encoding="utf-8"))
        whole = _overlay(whole, preset)
    return whole


def _overlay(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    deeper = {k: _overlay(below.get(k, {}), v) if isinstance(v, Mapping) else v for k, v in above.items()}
    return {**below, **deeper}


def value_at(config: Mapping[str, Any], name: str) -> Any:
    """The value of a dotted name."""
    value: Any = config
    for key in name.split("."):
        value = value[key]
    return value


def presets_state(name: str, setting: Setting, config: Mapping[str, Any]) -> str:
    """ "literal" or the difference from the paper, for one setting in a configuration."""
    letter = setting.description.paper_value
    if letter is None:
        return f"no such setting: {REASONS[name]}"
    if value_at(config, name) != letter:
        return "not taken"
    found = "literal (default)" if plain_value(setting.default) == letter else "literal"
    return f"{found}; {REMARKS[name]}" if name in REMARKS else found


def stage_constant(place: str, name: str) -> Any:
    """The value of a constant in a dataclass of a stage."""
    return next(field.default for field in fields(_class(place)) if field.name == name)


def page_text() -> str:
    """The text of docs/paper.md."""
    config, rows = merge_presets(), []
    for name, setting in paper_values():
        default, letter = plain_value(setting.default), value_at(config, name)
        preset = "" if letter == default else _short(letter)
        remark = (
            presets_state(name, setting, config).removeprefix("literal").removeprefix(" (default)").removeprefix("; ")
        )
        last = "; ".join(filter(None, [preset, remark]))
        cells = [f"`{name}`", _source(setting.description.paper), last]
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    constants = [
        f"| `{place.partition(':')[0]}` `{name}` | {_source(where)} | `{value_text(stage_constant(place, name))}` |\n"
        for place, name, _, where in CONSTANTS
    ]
    return _HEAD + "".join(rows) + _BETWEEN + "".join(constants)


def _source(text: str) -> str:
    """The paper's value with its appendix as a letter in brackets."""
    return re.sub(r", appendix ([A-D])\b", r" (\1)", text)


def _short(value: Any) -> str:
    """A value as a cell of the table; a mapping is left to the preset's file."""
    return "in paper.yaml" if isinstance(value, Mapping) else f"`{value_text(value)}`"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page_text(), encoding="utf-8")


if __name__ == "__main__":
    main()
