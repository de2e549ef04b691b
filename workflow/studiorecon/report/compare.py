# SPDX-License-Identifier: Apache-2.0
"""``report.compare``: compares two results: ``python -m studiorecon report.compare --first A.json --second B.json``.

Each side is one or several files that ``report.score`` or a run wrote: several seeds of a scene, several scenes, or
both. Prints the difference of every measure, second minus first, with its 95 % interval, paired per scene, camera and
frame. A difference whose interval contains 0 is not significant. Results of different photos, masks, libraries, code or
settings are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.progress import say
from studiorecon.report.metrics.bootstrap import Bootstrap, over_seeds, paired_difference
from studiorecon.scene.files import read_json, write_json

_MUST_AGREE = ("masks", "libraries", "code", "settings")
_PREFERRED = ("enhanced", "raw", "renders")


def read_result(path: Path) -> dict[str, Any]:
    """The contents of a result file.

    Raises UserError when it is cut off, of another kind, or has cameras with different numbers of frames.
    """
    result = read_json(path)
    if not isinstance(result, Mapping) or not {"pictures", "provenance", "definitions"} <= set(result):
        raise UserError(
            f"{path} is not a result of report.score or of a run: it lacks pictures, "
            "definitions or provenance; score it again"
        )
    if missing := [name for name in _MUST_AGREE if name not in result["provenance"]]:
        raise UserError(f"{path} does not say which {missing[0]} it was made with; score it again")
    for version, measures in result["pictures"].items():
        for name, entry in measures.items():
            for camera, values in entry["cameras"].items():
                if len(values["frames"]) != values["used"] + values["skipped"]:
                    raise UserError(
                        f"{path} counts other values of {version}.{name} of camera "
                        f"{camera} than it holds; score it again"
                    )
    return dict(result)


def check_comparable(results: Mapping[Path, Mapping[str, Any]]) -> None:
    """Raises UserError with two files and their difference unless all results were measured in the same way."""
    (first, reference), *others = results.items()
    for path, result in others:
        for name in _MUST_AGREE:
            mine, theirs = reference["provenance"][name], result["provenance"][name]
            if name == "settings":  # a run has settings that folders of pictures do not need
                mine, theirs = ({key: side[key] for key in mine if key in theirs} for side in (mine, theirs))
            if mine != theirs:
                raise UserError(
                    f"{first} and {path} were measured with different {name} ({_brief(mine, theirs)}); score both "
                    "again with the same settings"
                )
        mine, theirs = (r.get("inputs", {}).get("masks") or {} for r in (reference, result))
        if differing := [camera for camera in mine if camera in theirs and mine[camera] != theirs[camera]]:
            raise UserError(
                f"{first} and {path} were measured with different masks of camera {differing[0]}; score both again "
                "with the same settings"
            )


def choose_version(result: Mapping[str, Any], wanted: str | None, path: Path) -> str:
    """The version of the pictures to compare: the ``wanted`` one, else the first of enhanced, raw, renders."""
    measured = [
        name for name in _PREFERRED if result["pictures"].get(name, {}).get("psnr", {}).get("value") is not None
    ]
    if wanted is not None and wanted not in measured:
        raise UserError(f"{path} has no measured pictures called {wanted} (it has: {', '.join(measured) or 'none'})")
    if not measured:
        raise UserError(f"{path} holds no measured pictures: without a held-out camera there is nothing to compare")
    return wanted or measured[0]


def compare(
    first: Mapping[Path, Mapping[str, Any]], second: Mapping[Path, Mapping[str, Any]], version: str | None
) -> dict[str, Any]:
    """measure → both sides over seeds, and the paired difference, over what both sides measured."""
    sides = []
    for results in (first, second):
        scenes: dict[str, list[Mapping[str, Any]]] = {}
        for path, result in results.items():
            scenes.setdefault(scene_digests(result), []).append(
                result["pictures"][choose_version(result, version, path)]
            )
        sides.append(scenes)
    common = [scene for scene in sides[0] if scene in sides[1]]
    if not common:
        raise UserError(f"{next(iter(first))} and {next(iter(second))} have no scene in common: their photos differ")
    # A measure without values on both sides has no difference; it is listed with the values that exist.
    names = sorted(set.intersection(*(set(run) for scenes in sides for runs in scenes.values() for run in runs)))
    bootstrap, result = Bootstrap(2000, 0), {}
    for name in names:
        means = [{s: _seed_mean([run[name]["cameras"] for run in scenes[s]]) for s in common} for scenes in sides]
        paired = {s: (means[0][s], means[1][s]) for s in common}
        each = [
            over_seeds([_mean_value(scenes, common, name, seed) for seed in range(_seeds(scenes, common))])
            for scenes in sides
        ]
        result[name] = {"first": each[0], "second": each[1], **paired_difference(paired, bootstrap)}
    return result


def scene_digests(result: Mapping[str, Any]) -> str:
    """The digests that two results of one scene share: of the true pictures or, for a run, of its footage."""
    inputs = result.get("inputs", {})
    truth = inputs.get("truth") or {
        name: value for name, value in inputs.items() if "/" not in name and name.endswith(".mkv")
    }
    return " ".join(f"{camera}={value}" for camera, value in sorted(truth.items()))


def run(first: list[Path], second: list[Path], version: str | None = None, output: Path | None = None) -> None:
    """Compare two sides; ``version`` (raw, enhanced, renders) selects the pictures when a run has several."""
    if not first or not second:
        raise UserError("name the results to compare: --first A.json --second B.json")
    results = {path: read_result(path) for path in (*first, *second)}
    check_comparable(results)
    found = compare({path: results[path] for path in first}, {path: results[path] for path in second}, version)
    for name, entry in found.items():
        if entry["difference"] is not None:
            say(f"{name}: {_difference(entry)}")
    if output is not None:
        write_json(output, found)


def _difference(entry: Mapping[str, Any]) -> str:
    sides = " → ".join(
        "not measured" if s["mean"] is None else f"{s['mean']:.4f}" for s in (entry["first"], entry["second"])
    )
    if entry["interval"] is None:
        return f"{sides}, difference {entry['difference']:+.4f}, too few frames or scenes for an interval"
    low, high = entry["interval"]
    claim = "" if entry["significant"] else ": no claim"
    return f"{sides}, difference {entry['difference']:+.4f} [{low:+.4f}, {high:+.4f}] over {entry['drawn']}{claim}"


def _seeds(scenes: Mapping[str, Sequence], common: Sequence[str]) -> int:
    return min(len(scenes[scene]) for scene in common)


def _mean_value(
    scenes: Mapping[str, Sequence[Mapping[str, Any]]], common: Sequence[str], name: str, seed: int
) -> float | None:
    values = [scenes[scene][seed][name]["value"] for scene in common]
    return None if any(value is None for value in values) else float(np.mean(values))


def _seed_mean(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[float | None]]:
    """camera → value per frame, mean over the seeds of one scene; None where any seed has none."""
    cameras = [camera for camera in runs[0] if all(camera in run for run in runs)]
    frames = {camera: zip(*(run[camera]["frames"] for run in runs)) for camera in cameras}
    return {
        camera: [None if None in values else float(np.mean(values)) for values in each]
        for camera, each in frames.items()
    }


def _brief(mine: Any, theirs: Any) -> str:
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        keys = [key for key in sorted({*mine, *theirs}) if mine.get(key) != theirs.get(key)]
        return ", ".join(f"{key} {mine.get(key)} and {theirs.get(key)}" for key in keys)
    return f"{mine} and {theirs}"
