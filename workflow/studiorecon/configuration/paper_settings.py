# SPDX-License-Identifier: Apache-2.0
"""The paper's settings: every setting that it mentions, its value, and whether the presets use it.

``python -m studiorecon.configuration.paper_settings`` writes docs/paper.md from the settings' declarations and from
``config/presets/paper.yaml`` with ``networks.yaml`` over it; a test compares it with the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from studiorecon.configuration.generate import value_text
from studiorecon.configuration.sections import SECTIONS, _class, defaults, general
from studiorecon.configuration.setting import Setting, plain
from studiorecon.home import CONFIGURATION

PRESETS = ("paper.yaml", "networks.yaml")
PAGE: Path = CONFIGURATION.parents[1] / "docs" / "paper.md"

WITHOUT: Mapping[str, str] = {
    "people.association.gate_m": "bounds rays; the paper's gate of 0.3 m on pelvises is a constant in the code",
    "depth.sweep_width": "planes say where floor, walls and ceiling are, which nothing of the letter reads but "
    "background.fill_unseen",
    "render.shots": "which cameras are held out is the dataset's to say (held_out in capture.yaml)",
}
"""The reason why a setting that the paper mentions cannot have the paper's value."""

BUT: Mapping[str, str] = {
    "humans.gaussians": "read where humans.placed is evenly: SMPL has as many vertices",
    "people.lift.surface_to_joint_m": "read where the position is scene",
    "people.triangulation.solver": "points stay undetermined whose rays cross under 2° or that lie within 0.1 m of a "
    "camera: there noise moves the minimum of Eq. 2 by metres",
    "people.association.affinity": "σ_p 0.3 m and σ_θ 0.5 rad a joint are ours, the paper gives none",
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
    ("views.fitted:Settings", "dilation_px", 21, "of people in synthesized views, appendix on preprocessing; U24"),
    ("recursive.injection:Injection", "decay", 0.5, "temporal decay, appendix Recursive Enhancement Module; U03"),
    ("humans.appearance:OverTime", "layers", 8, "8 layers, appendix D"),
    ("report.evaluate:Settings", "seen_tolerance", 0.05, "Seen/Unseen Fidelity; U57"),
)
"""The paper's numbers that are constants in the code: place, name, the paper's value, source."""

_HEAD = """\
# The paper to the letter

Made by `python -m studiorecon.configuration.paper_settings`; do not edit by hand. Every setting of which the paper
speaks, from the setting's own declaration, and what `config/presets/paper.yaml` with `networks.yaml` over it makes of
it. U-numbers are readings of ambiguous passages ([readings.md](readings.md)). "default" means that nothing has to be
said.

| setting | the paper, and where | default | the letter | the presets | state |
|---|---|---|---|---|---|
"""
_BETWEEN = """
Numbers that no setting turns; a test holds them to the paper's.

| where | the paper's | value |
|---|---|---|
"""


def paper_values() -> Iterator[tuple[str, Setting]]:
    """Every setting that the paper mentions, by its dotted name."""
    yield from ((setting.name, setting) for setting in general() if setting.described.paper)
    for section in SECTIONS:
        yield from _inside(section.settings(), section.name)


def _inside(settings: Iterable[Setting], above: str) -> Iterator[tuple[str, Setting]]:
    for setting in settings:
        name = f"{above}.{setting.name}"
        if setting.is_section:
            yield from _inside(setting.inner(), name)
        elif setting.described.paper:
            yield name, setting


def merged(names: Iterable[str] = PRESETS) -> Mapping[str, Any]:
    """The configuration with these presets laid over it in turn, as Snakemake does it."""
    whole: dict[str, Any] = dict(defaults())
    for name in names:
        preset = yaml.safe_load((CONFIGURATION.parent / "presets" / name).read_text(encoding="utf-8"))
        whole = _over(whole, preset)
    return whole


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    deeper = {k: _over(below.get(k, {}), v) if isinstance(v, Mapping) else v for k, v in above.items()}
    return {**below, **deeper}


def value_at(config: Mapping[str, Any], name: str) -> Any:
    """The value of a dotted name."""
    value: Any = config
    for key in name.split("."):
        value = value[key]
    return value


def state(name: str, setting: Setting, config: Mapping[str, Any]) -> str:
    """ "literal" or the difference from the paper, for one setting in a configuration."""
    letter = setting.described.paper_value
    if letter is None:
        return f"no literal option: {WITHOUT[name]}"
    if value_at(config, name) != letter:
        return "not taken"
    found = "literal (default)" if plain(setting.default) == letter else "literal"
    return f"{found}; {BUT[name]}" if name in BUT else found


def constant(place: str, name: str) -> Any:
    """The value of a constant in a dataclass of a stage."""
    return next(field.default for field in fields(_class(place)) if field.name == name)


def page() -> str:
    """The text of docs/paper.md."""
    config, rows = merged(), []
    for name, setting in paper_values():
        about = setting.described
        letter = "" if about.paper_value is None else f"`{value_text(about.paper_value)}`"
        shown = "see config.yaml" if isinstance(setting.default, Mapping) else f"`{value_text(setting.default)}`"
        here = "" if isinstance(setting.default, Mapping) else f"`{value_text(value_at(config, name))}`"
        cells = [f"`{name}`", about.paper, shown, letter, here, state(name, setting, config)]
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    held = [
        f"| `{place.partition(':')[0]}` `{name}` | {where} | `{value_text(constant(place, name))}` |\n"
        for place, name, _, where in CONSTANTS
    ]
    return _HEAD + "".join(rows) + _BETWEEN + "".join(held)


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
