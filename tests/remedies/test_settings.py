# SPDX-License-Identifier: Apache-2.0
"""What a sentence about a setting advises is done here, and then the plan is made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from snakemake.utils import update_config
from studiorecon.configuration.schema import mistakes
from studiorecon.models.catalogue.selection import check_licences
from studiorecon.plan.make import make_plan

from tests.made.remedies import follow

ROOT = Path(__file__).resolve().parents[2]
CHECKS = "plan/plan_checks.py"
Settings = dict[str, Any]


@cache
def defaults() -> str:
    return (ROOT / "config/config.yaml").read_text(encoding="utf-8")


@cache
def schema() -> Settings:
    return yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Plan:
    """Settings over the defaults, and a capture of three cameras without the files in ``lacking``."""

    settings: Settings
    lacking: tuple[str, ...] = ()
    text: str = ""
    more: tuple[str, ...] = ()

    def made(self, folder: Path) -> None:
        files = [
            f"{place}/{c}{end}" for c in ("a", "b", "c") for place, end in (("videos", ".mp4"), ("keypoints", ".npz"))
        ]
        for number, name in enumerate([*files, "intri.yml", "extri.yml", *self.more]):
            if name not in self.lacking:
                (folder / "capture" / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / "capture" / name).write_bytes(bytes(number + 1))
        (folder / "capture/capture.yaml").write_text(self.text)
        config = yaml.safe_load(defaults())
        update_config(
            config, self.settings | {"dataset": str(folder / "capture"), "scene": self.settings.get("scene", "x")}
        )
        if mine := str(folder / "capture"):
            config = yaml.safe_load(yaml.safe_dump(config).replace("HERE", mine))
        assert mistakes(config, schema()) == []
        check_licences(config)
        make_plan(config, ROOT)


def settings(place: str, brought: Settings, *advised: Settings, **same: Any) -> list[tuple[str, Plan, Plan]]:
    return [(place, Plan(brought, **same), Plan(done, **same)) for done in advised]


def force(effect: str, **enhance: Any) -> Settings:
    return {"survey": {"force": {effect: "on"}}, "enhance": enhance}


def shot(**given: Any) -> Settings:
    return {"render": {"shots": {"mine": {"kind": "orbit", **given}}}}


CALIBRATION = ("intri.yml", "extri.yml")
POINTS = tuple(f"keypoints/{c}.npz" for c in "abc")
SCENE = {"association": {"position": "scene"}}
RAYS = {"association": {"position": "rays"}}
NETWORK: Settings = {"source": "pi3"}
BEHIND: Settings = {"people": SCENE, "calibration": NETWORK, "depth": {"source": "moge"}}
MAPPED = "pixel_maps: {a: {scale: 2.0, offset: [0, 0]}}"
PEOPLE_ONLY: Settings = {"detect": {"source": "keypoints"}, "calibration": {"source": "people"}}

# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
PLANS = [
    *settings(f"{CHECKS} find_precomputed", {"depth": {"source": "precomputed", "precomputed": "gone"}},
              {"depth": {"source": "precomputed", "precomputed": "HERE/depth"}},
              more=("depth/a.npy", "depth/b.png", "depth/c.npz")),
    *settings(f"{CHECKS} check_plan 1", {"detect": {"network": "gone.onnx"}}, {"detect": {"network": "HERE/x.onnx"}},
              {"detect": {"network": ""}}, {"detect": {"network": "rtmpose"}}, more=("x.onnx",)),
    *settings(f"{CHECKS} check_plan 2", {"depth": {"source": "onnx", "network": "gone"}},
              {"depth": {"source": "onnx", "network": "HERE/x.onnx"}}, {"depth": {"source": "moge_vits"}},
                  more=("x.onnx",)),
    *settings(f"{CHECKS} check_plan 3", {"depth": {"reference": "calibration"}},
              {"depth": {"reference": "calibration"}, "calibration": NETWORK}, {"depth": {"reference": "planes"}}),
    *settings(f"{CHECKS} check_plan 4", {"views": {"people": "network"}},
              {"views": {"people": "network"}, "masks": {"source": "sam3"}}, {"views": {"people": "bodies"}}),
    *settings(f"{CHECKS} _named_files", {"body": "gone.npz"}, {"body": "HERE/mine.npz"}, {"body": "resources/body.npz"},
              more=("mine.npz",)),
    *settings(f"{CHECKS} _named_files", shot(reference="gone.png"), shot(reference="HERE/mine.png"),
              more=("mine.png",)),
    *settings(f"{CHECKS} _named_files", shot(replace={"p0": "gone.ply"}), shot(replace={"p0": "HERE/mine.ply"}),
              shot(replace={"p0": "nobody"}), more=("mine.ply",)),
    *settings(f"{CHECKS} _calibration 1", {"calibration": NETWORK}, {"calibration": {"source": "files"}}, text=MAPPED),
    (f"{CHECKS} _calibration 1", Plan({"calibration": NETWORK}, text=MAPPED), Plan({"calibration": NETWORK})),
    (f"{CHECKS} _calibration 2", Plan({"calibration": {"source": "files"}}, CALIBRATION),
     Plan({"calibration": {"source": "files"}})),
    (f"{CHECKS} _calibration 2", Plan({"calibration": {"source": "files"}}, CALIBRATION, "", ("cal/mine.toml",)),
     Plan({"calibration": {"source": "files"}}, CALIBRATION, "calibration: cal/mine.toml", ("cal/mine.toml",))),
    *settings(f"{CHECKS} _enhancement 1", {"background": {"refinement": {"views": 3}}},
              {"background": {"refinement": {"views": 3}}, "enhance": {"enhancer": "difix"}},
              {"background": {"refinement": {"views": 3}}, "enhance": {"enhancer": "fixer"}},
              {"background": {"refinement": {"views": 0}}}),
    *settings(f"{CHECKS} _enhancement 2", force("enhancement", enhancer="none"), {"enhance": {"enhancer": "none"}},
              force("enhancement")),
    *settings(f"{CHECKS} _enhancement 2", force("enhancement", strength=0.0), {"enhance": {"strength": 0.0}},
              force("enhancement")),
    *settings(f"{CHECKS} _enhancement 3", force("injection", injection={"history": 0}),
              {"enhance": {"injection": {"history": 0}}}, force("injection")),
    *settings(f"{CHECKS} _lifting 1", {**BEHIND, "calibration": {"source": "files"}}, BEHIND, {"people": RAYS}),
    *settings(f"{CHECKS} _lifting 2", {"people": SCENE, "calibration": NETWORK}, BEHIND,
              {"people": RAYS, "calibration": NETWORK}),
    *settings(f"{CHECKS} _lifting 3", {**BEHIND, "detect": {"source": "detector"}},
              {**BEHIND, "detect": {"source": "comotion"}}, {**BEHIND, "detect": {"source": "keypoints"}},
              {**BEHIND, "people": RAYS, "detect": {"source": "detector"}}),
    (f"{CHECKS} _keypoints 1", Plan({"detect": {"source": "keypoints"}}, POINTS),
     Plan({"detect": {"source": "auto"}}, POINTS)),
    (f"{CHECKS} _keypoints 1", Plan({"detect": {"source": "keypoints"}}, POINTS),
     Plan({"detect": {"source": "keypoints"}})),
    (f"{CHECKS} _keypoints 1", Plan({"detect": {"source": "keypoints"}}, POINTS),
     Plan({"detect": {"source": "keypoints"}}, POINTS, "people: 0")),
    *settings(f"{CHECKS} _keypoints 2", {"detect": {"source": "keypoints"}}, {"detect": {"source": "auto"}},
              lacking=POINTS[:1]),
    (f"{CHECKS} _keypoints 2", Plan({"detect": {"source": "keypoints"}}, POINTS[:1]),
     Plan({"detect": {"source": "keypoints"}}, POINTS[:1], "train: [b, c]")),
    (f"{CHECKS} _keypoints 2", Plan({"detect": {"source": "keypoints"}}, POINTS[:1]),
     Plan({"detect": {"source": "keypoints"}}, POINTS[:1], "", ("keypoints/a/0.json",))),
    *[(f"{CHECKS} check_plan 5", Plan(PEOPLE_ONLY, (*CALIBRATION, POINTS[0]), "held_out: [a]"),
        advised) for advised in (
        Plan(PEOPLE_ONLY, CALIBRATION, "held_out: [a]"),
        Plan(PEOPLE_ONLY | {"detect": {"source": "auto"}}, (*CALIBRATION, POINTS[0]), "held_out: [a]"),
        Plan(PEOPLE_ONLY, (*CALIBRATION, POINTS[0]), "train: [b, c]"),
        Plan(PEOPLE_ONLY | {"calibration": {"source": "auto"}}, POINTS[:1], "held_out: [a]"),
    )],
    *settings(f"{CHECKS} _precomputed", {"masks": {"precomputed": "x"}}, {"masks": {"precomputed": ""}}),
    *settings("plan/make.py make_plan", {"scene": "studio"}, {"scene": "studio1"}),
    *settings("scene/names.py check_name 1", {"scene": "a/b"}, {"scene": "a b"}),
    *settings("models/catalogue/selection.py check_licences", {"calibration": NETWORK, "licences": "commercial"},
              {"calibration": NETWORK, "licences": "any"}),
]  # fmt: skip


def changed(before: Settings, after: Settings) -> list[tuple[str, Any]]:
    """Names and values of the settings in which the second differs, without those that it leaves at the default."""
    found = []
    for key, value in after.items():
        if isinstance(value, dict) and key != "replace":
            found += changed(before.get(key, {}) if isinstance(before.get(key, {}), dict) else {}, value)
        elif before.get(key) != value:
            found.append((key, value))
    return found


@pytest.mark.parametrize("row", range(len(PLANS)), ids=[f"{n} {place}" for n, (place, *_) in enumerate(PLANS)])
def test_a_plan_changed_as_advised_is_made(row: int, tmp_path: Path) -> None:
    place, brought, advised = PLANS[row]
    sentence = follow(place, lambda: brought.made(tmp_path / "brought"), lambda: advised.made(tmp_path / "advised"))
    for key, value in changed(brought.settings, advised.settings):
        assert key in sentence or key == "source"
        named = (
            isinstance(value, str)
            and value
            and "HERE" not in value
            and "/" not in value
            and key not in ("scene", "body")
        )
        assert not named or value in sentence, sentence
