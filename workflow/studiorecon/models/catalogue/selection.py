# SPDX-License-Identifier: Apache-2.0
"""The networks that a configuration selects, the steps that run them, and whether their licences are allowed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import Kind
from studiorecon.models.catalogue.registry import MODELS, adapter_module, cards_of_kind
from studiorecon.scene.replacement_photos import is_photo


@dataclass(frozen=True)
class Choice:
    """A setting whose value may name a network of ``kinds``, or a value in ``before`` and ``after``, for ``steps``."""

    kinds: tuple[Kind, ...]
    steps: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...] = ()

    @property
    def networks(self) -> tuple[str, ...]:
        """Names of the networks that can be chosen."""
        return tuple(card.name for card in cards_of_kind(*self.kinds))

    @property
    def values(self) -> tuple[str, ...]:
        """All values of the setting."""
        return (*self.before, *self.networks, *self.after)


CHOICES = {
    "calibration.source": Choice(("pose and depth",), ("calibration.network",), ("auto", "files", "people")),
    "detect.source": Choice(
        ("body estimator",), ("tracks.bodies",), ("auto", "detector", "keypoints"), ("precomputed",)
    ),
    "masks.source": Choice(("person segmenter",), ("masks.network",), ("embedded",), ("precomputed",)),
    "depth.source": Choice(
        ("monocular depth", "inverse depth", "pose and depth"),
        ("depth.network",),
        ("embedded",),
        ("onnx", "precomputed"),
    ),
    "views.synthesizer": Choice(
        ("view synthesizer",), ("views.request", "views.generate", "views.fitted"), ("warp",), ("precomputed",)
    ),
    "enhance.enhancer": Choice(("picture enhancer",), ("enhance.shot",), ("residual",), ("precomputed", "none")),
    "enhance.flow": Choice(("flow",), ("enhance.shot",), ("dis",)),
}
"""Settings that may name a network, in the order data flows."""
POINTS = "detect.network"
"""The setting for a user's own file, or for the name of a network whose file is fetched."""
CANONICAL = "lhm"
"""The network for canonical people: by setting, and for photos in films' ``replace``."""
_MEASURED, _NETS = "report.lpips", {"alex": "lpips_alex", "vgg": "lpips"}
_PERCEPTUAL = ("background.training.lpips.weight", "humans.losses.lpips.weight")


def select_networks(config: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(setting, model) for every setting that selects an upstream network, in the order data flows."""
    found = [(where, str(value)) for where in (POINTS, *CHOICES) if (value := setting_at(config, where)) in MODELS]
    found += [(where, "lpips") for where in _PERCEPTUAL if (setting_at(config, where) or 0) > 0]
    if (net := setting_at(config, _MEASURED)) in _NETS:
        found.append((_MEASURED, _NETS[net]))
    films = (setting_at(config, "render.shots") or {}).items()
    photos = [name for name, film in films if any(map(is_photo, (film or {}).get("replace", {}).values()))]
    found += [(f"render.shots.{name}.replace", CANONICAL) for name in photos]
    # Only the bundled body and SMPL's are supported, so any other file is SMPL's.
    body = str(config.get("body", ""))
    if body and not body.endswith("body.npz"):
        found.append(("body", "smpl"))
    return found


def networks_of_step(step: str, config: Mapping[str, Any]) -> list[str]:
    """Names of the networks that ``"stage.step"`` runs under this configuration, except LPIPS."""
    names = [str(setting_at(config, where)) for where, choice in CHOICES.items() if step in choice.steps]
    # Networks of another stage's setting, which the rule passes on.
    names += [str(setting_at(config, "depth.source"))] if step == "people.lift" else []
    names += [str(setting_at(config, f"enhance.{key}")) for key in ("enhancer", "flow") if step == "background.refined"]
    names += [str(setting_at(config, "masks.source"))] if step == "views.people" else []
    names += [CANONICAL] if step == "humans.canonical" else []
    return [name for name in names if name in MODELS]


def adapter_modules(step: str, config: Mapping[str, Any]) -> list[str]:
    """Modules of the adapters that ``"stage.step"`` runs under this configuration, by name and without import."""
    if step == "report.page":  # shows every card
        return sorted({adapter_module(name) for _, name in select_networks(config)})
    own_file = step == "depth.network" and setting_at(config, "depth.source") == "onnx"
    own = {"models.adapters.onnx_depth"} if own_file else set()
    return sorted({adapter_module(name) for name in networks_of_step(step, config)} | own)


def setting_at(config: Mapping[str, Any], where: str) -> Any:
    """The value of a setting with a dotted name; None for a missing one."""
    value: Any = config
    for key in where.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def check_licences(config: Mapping[str, Any]) -> None:
    """Raises UserError with an alternative when ``licences`` is "commercial" and a network forbids that use."""
    if config.get("licences") != "commercial":
        return
    for where, name in select_networks(config):
        terms = MODELS[name].terms
        if terms.commercial == "no":
            instead = terms.alternative or "the stage's own method"
            raise UserError(
                f"{where} is {name}, and {MODELS[name].title} may not be used commercially "
                f"({terms.condition}); set it to {instead}, or "
                "set licences to any"
            )


def licence_rows(config: Mapping[str, Any]) -> list[dict[str, str]]:
    """For every selected network: settings, title, licences of code and weights, commercial use, alternative."""
    rows = []
    for where, name in select_networks(config):
        entry = MODELS[name]
        rows.append(
            {
                "setting": where,
                "model": name,
                "title": entry.title,
                "code": entry.terms.code,
                "weights": entry.terms.weights,
                "commercial": entry.terms.commercial,
                "condition": entry.terms.condition,
                "alternative": entry.terms.alternative,
                "follows": entry.runtime.commit,
            }
        )
    return rows
